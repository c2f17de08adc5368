"""Errors of results and their cost: error estimates, reduced models, work-precision studies.

An error is estimated with a second run at a looser tolerance. Trials of integrators are compared
with a run at the tightest tolerance, which is confirmed by another integrator.

Offers: `execution_to_accuracy` (an execution to a wanted accuracy), `execution_with_error`,
`settings_for`; `errors_of_reduced_models` (errors of
reduced models); `measure_work_precision`, `WorkPrecision`, `read_work_precision`.

Imports: search, verification, orbits, simulation, loop, model, integrators, work, arrays,
errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
