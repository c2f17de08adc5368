"""Follow a flow until its guard falls through zero: explicitly, implicitly, by Taylor series.

A flow is a vector field with a guard; what they stand for is not known here. An engine follows a
`Leg` of a flow and returns a `Passage`. `events` finds where a guard falls inside a step; the
formulas of single steps are in `dop853_step`, `radau_step`, `rosenbrock` and `collocation`. A
`CompilableFlow` may have a `LegCode`: the loop over the steps of a leg, `follow.c`, compiled.

Offers: the engines `Automatic`, `RungeKutta`, `Radau`, `Taylor`, `SciPy`, by name in `ENGINES`;
an `Engine` takes a `Leg` and gives a `Passage` with its `Outcome` and `Trajectory`, made of
`Step`s; a `GuardedFlow`, a `PlainFlow` of plain functions, and the `Tolerance` of a step.

Imports: kernels, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
