"""Integration of a flow until its event function crosses zero downwards, explicit or implicit.

A flow is a vector field with an event function (its guard). The integrators do not depend on their
meaning. An engine follows a `Segment` of a flow and returns a `SegmentResult`. `events` finds the
zero of a guard inside a step. The formulas of single steps are in `dop853_step`, `radau_step` and
`collocation`. Everything is plain Python and serves as the reference of the compiled loop in the
room `loop`.

Offers: the engines `Automatic`, `RungeKutta`, `Radau`, `SciPy`, by name in `ENGINES`. An `Engine`
integrates a `Segment` and returns a `SegmentResult` with its `Termination` and its `Trajectory` of
`Step`s. A `FlowWithEvent` is the flow, a `PlainFlow` is a flow of plain functions, and a
`Tolerance` is the tolerance of a step.

Imports: work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
