"""Compare a real machine with an orbit: recordings, comparison, identification, and a virtual rig.

Offers: for recordings `Recording` of `RecordedSignal`s with a `Source`, `read_recording`,
`sampled`. `compare_recording` and `compare_two_files` return a `Comparison` of `Metric`s.
`fit_parameters` returns an `Identification` of `FitParameter`s or raises `UnfittableError`.
`fit_transient_parameters` does the same for transients, `transient_reason` decides between the two,
`compare_transients` returns a `TransientComparison`, and `laws_of` compares laws of impact on
transients: a `LawComparison`, a `LawFit` each.
`run_rig` and `settle_rig` simulate a problem as a machine without a Zeno point, with `RigSettings`.

Sub-folders: `recordings` (files, tables, periodicity of signals), `comparison` (an orbit compared
with a recording), `identification` (parameters by least squares), `transients` (drops, steps and
event times by single shooting), `rig` (simulated machines). The
module `orbit_table` evaluates an orbit at all phases at once and masks the samples near jumps.
`polyline` measures the distance of points from a line.

Imports: search, orbits, simulation, model, integrators, work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
