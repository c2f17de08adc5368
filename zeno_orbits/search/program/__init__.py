"""One nonlinear program for every event sequence.

`legs` cuts a period into flows of one mode up to one event. `formulas` has their elements,
`elements` the program of elements for Ipopt, `writer` the rows of a periodic orbit, `terms` the
objectives and bounds, and `rounds` the search: solve, simulate, and once more.
"""
