"""Compare a real machine with an orbit: recordings, comparison, identification, and a virtual rig.

Offers: a `Recording` of `RecordedSignal`s from a `Source` by `read_recording`, `write_recording`,
or `sampled`; `compare`, which gives a `Comparison` of `Metric`s; `identify`, which gives an
`Identification` of `Unknown`s or an `UnfittableError`; `rig_cycles` and `simulate_rig`, a problem
as a machine without a Zeno point, with `RigSettings`.

Sub-folders: `recordings` (files, tables, how signals repeat), `comparison` (an orbit laid over a
recording), `identification` (parameters by least squares), `rig` (simulated machines). The module
`orbit_table` has an orbit at all phases at once, and the mask of samples beside jumps; `polyline`
measures the distance of points from a line.

Imports: search, orbits, simulation, model, integrators, work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
