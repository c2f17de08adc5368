"""Maps of attractors over a plane of gains, parameters or states, on all cores or a cluster.

Offers: `map_of_plane` of a `Plane` with its two `Axis`: a `ParameterMap` of `Attractor`s, each of
an `AttractorClass`; `attractors_at` for any list of numbers; `read_map`, `write_map`,
`read_boundaries`; `largest_pushes` of an orbit: the `Pushes`, each a `Push`, by `PushSettings`; the
`least_push` of them, in the `push_units` of a direction; `recovery_of` an orbit: a `Recovery`, by
`RecoverySettings`; `read_pushes` and `read_recovery`; `feedback_of` a return map: a `Feedback`
once per period, with the `LoopCorner`s of uncertain parameters; `scatter_of`
an orbit: a `Scatter` of `ScatterRow`s, by `ScatterSettings`.

Imports: orbits, simulation, loop, model, integrators, work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
