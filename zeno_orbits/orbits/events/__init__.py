"""Periodic orbits as sequences of events, for machines with several stops or switches."""
