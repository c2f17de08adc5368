"""Shooting: a simulation settles, and Newton's method on the return map closes the orbit."""
