"""Validated integration: the enclosure of one period, step by step and event by event.

`flow` encloses one step of a flow, `sets` and `section` represent sets of states, `events` encloses
impacts and the Zeno tail, and `walk` encloses one period. `polynomial_walk` encloses the period of
a large set in polynomials of the start coordinates, `orbit_walk` starts from an orbit file.
"""
