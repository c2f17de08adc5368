"""Starts of a search: where they are, what each leads to, and how their orbits are ranked.

`scan` orders the points of the box, `strategy` leads from a start to an orbit, `start` checks it,
`multistart` spreads the starts over workers. `candidates` ranks orbits of events, `coexisting` adds
other attractors at the best values, and `ranking` tells when two orbits are one.
"""
