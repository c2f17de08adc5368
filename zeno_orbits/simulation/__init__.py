"""Completed executions, one or many in step, through every impact and Zeno point; and attractors.

`simulate` follows one motion with dense output, `batch` many at once without; `sensitivity` has
exact derivatives of the former. `attractor` defines what a motion settles to.

Offers: `simulate` with `SimulationSettings`; an `Execution` of `Arc`s (of a `Mode`, with an
`Ending`) and events `Impact`, `ZenoPoint`, `Release`; how a Zeno point is reached: `ZenoPassage`,
`ZenoExtrapolation`, `Truncation`.

Imports: model, integrators, kernels, work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
