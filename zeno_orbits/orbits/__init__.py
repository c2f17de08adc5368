"""Periodic orbits: their shape, section, return map, numbers and files.

A period is cut out of an execution where its section is passed: a `Cycle`, whoever needs it. The
section has one chart, `Section`; the return map has exact derivatives, through every impact and the
Zeno point.

Offers: `OrbitShape` and its phases; `Cycle`, `cycle_of` (simulate one period), `cycles` (all that
an execution has); `Section`, `section_around`; `poincare_map`, `return_derivative`,
`floquet_multipliers`; `ZenoOrbit`, `new_orbit`, `read_orbit`, `write_orbit`; `Bound`; `follow_path`
(predictor-corrector steps); `at_looser_tolerance` (error estimates by a second run).

Imports: simulation, model, integrators, work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
