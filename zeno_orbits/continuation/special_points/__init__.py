"""Special points of a family: test functions and their roots, counted by subdivided steps."""
