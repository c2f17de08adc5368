"""The best orbit in given ranges of gains and parameters, from one start.

`gains` chooses between the program and shooting. `points` are orbits over the free values with
their derivatives, `least_worst` minimizes the largest of several numbers over them, `paths` follows
orbits along lines, and `persistence` and `strength` look for the widest margin and largest push.
"""
