"""Periodic orbits: their shape, section, return map, data and files.

A period is an `EventReturn`: the events and arcs of a motion between two passages of its section,
with exact derivatives through every impact and the Zeno point. The section has one chart,
`Section`.

Offers: `event_return` (simulate one return), `closed_return` (solve for the orbit),
`multipliers_of_return`; `Section`, `section_around`; `EventSequence` and its phases; `Orbit`,
`read_orbit`; `Bound`; `follow_path` (predictor-corrector steps);
`relaxed_tolerance` (error estimates by a second run).

Imports: simulation, model, integrators, work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
