"""Find orbits and gains: guess by simulation, transcribe, solve, confirm by simulation, rank.

A nonlinear program is solved from a sequence of starts. Each solution is simulated and passed to a
check. `orbit_by_shooting` closes an orbit of any machine by simulation alone.

Offers: `orbit_at_gains` and `search_orbits` (with `SearchSettings`, a `SearchResult` of `Candidate`
orbits, `Verdict` for checks, `StartWorkers`), `orbit_by_shooting` and `settled_return`,
`SearchMethod`, `orbit_by_program` (a `ProgramTask` to a `ProgramOrbit`), and the `Objective`.

Imports: maps, verification, orbits, simulation, model, integrators, work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
