"""Follow families of periodic orbits in a parameter, with special points, ends and boundaries.

A family is followed in both directions from one orbit. Its orbits may be stable or unstable. Folds,
period doublings (flips), Neimark-Sacker points, branch points and ends are located. They can be
followed in a second parameter (`two_parameters`).

Offers: `family_of_orbit` and `family_of_impacts`, which return a `Continuation` of `Family`; how to
follow: `SecondParameter`, `ContinuationSettings`, `FamilySteps`, `CurveSteps`, `WorkerPool`
(workers); `start_orbit` and `clip_to_box`; `orbit_amplitude` of a point of a family;
`held_families`, the `HeldFamilies` of `HeldPoint`s that a feedback of least effort keeps.

Imports: search, maps, orbits, simulation, model, work, arrays, errors.

To find a fault in a family, read in this order: `continuation` (the arguments), `setup` (the start
of the family), `branch` (steps and ends), `corrector` (one point), `return_maps` (one return, for
every machine).
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
