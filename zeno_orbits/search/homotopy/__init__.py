"""Homotopy: orbits along straight lines of values, from a known orbit to a loss (theory (5.4))."""
