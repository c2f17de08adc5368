"""Orbits of events: search for machines with several stops and switches.

A simulation settles, and Newton's method closes the return. Exact derivatives choose the gains.
"""
