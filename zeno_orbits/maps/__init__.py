"""Maps of what motions settle to over a plane of two numbers, on all cores or a cluster.

Offers: `parameter_map` of a `Plane` with its two `Axis`: a `ParameterMap` of `Attractor`s, each of
a `Fate`; `attractors_at` for any list of numbers; `read_map`, `write_map`, `read_boundaries`.

Imports: orbits, simulation, model, work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
