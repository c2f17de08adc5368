"""A completed system as fast numeric functions: flows, guards, resets, exact derivatives.

`compiled` turns expressions into CasADi functions, once for all parameter values of a problem.
`hybrid_dynamics` is the interface to simulators, for compiled and hand-written models.
"""
