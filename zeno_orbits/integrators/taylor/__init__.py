"""The engine of Taylor series: `engine` follows arcs with the `modes` that heyoka compiles.

`casadi_to_heyoka` translates the formulas of a model. Needs the extra `taylor`.
"""
