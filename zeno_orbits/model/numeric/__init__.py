"""A completed system as fast functions of numbers: flows, guards, resets, exact derivatives.

`compiled` turns expressions into CasADi functions, once for all numbers of a problem;
`hybrid_dynamics` is what a simulator sees of them, or of a model written by hand.
"""
