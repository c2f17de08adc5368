"""Executions and orbits in many digits: the truth that results in doubles are compared with."""
