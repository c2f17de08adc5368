"""Completed executions through impacts and Zeno points, single or in parallel, and attractors.

`simulate` computes a motion with dense output. `watched_motion` follows a motion until it settles.
`EventDerivatives` has the exact derivatives of events. `attractor` defines the attractors of
motions.

Offers: `simulate` with `SimulationSettings`. An `Execution` consists of `Arc`s (with a `Mode` and
an `Ending`) and events `Impact`, `ZenoPoint`, `Release`, `SwitchEvent`, each of an `EventKind`,
which is the table of events. Methods to reach a Zeno point:
`ZenoPassage`, `ZenoExtrapolation`, `Truncation`.

Imports: loop, model, integrators, work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
