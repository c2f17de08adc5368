"""Orbits at given values: by a motion that settles, or from a known orbit.

`settling` follows a motion until it repeats, `closing` closes the orbit by Newton's method, `line`
follows an orbit to other values, and `limits` refuses orbits beyond the limits of the problem.
"""
