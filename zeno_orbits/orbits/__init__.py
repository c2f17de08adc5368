"""Periodic orbits: their shape, section, return map, data and files.

A period is the part of an execution between two crossings of the section. Every user of a period
gets it as a `Cycle`. The section has one chart, `Section`. The derivatives of the return map are
exact, through every impact and the Zeno point.

Offers: `EventSequence` and its phases; `Cycle`, `cycle_of` (simulate one period), `cycles` (all
that an execution has); `Section`, `section_around`; `poincare_map`, `return_derivative`,
`orbit_multipliers`; `Orbit`, `new_orbit`, `read_orbit`, `write_orbit`; `Bound`; `follow_path`
(predictor-corrector steps); `relaxed_tolerance` (error estimates by a second run).

Imports: simulation, model, integrators, work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
