"""Errors of results and their cost: error estimates, reduced models, work-precision studies.

An error is estimated with a second run at a looser tolerance. Trials of integrators are compared
with a run at the tightest tolerance, which is confirmed by another integrator.

Offers: `execution_to_accuracy` (an execution to a wanted accuracy), `execution_with_error`,
`settings_for`, `execution_distance` (of two executions); `errors_of_reduced_models` (errors of
reduced models); `measure_work_precision`, `WorkPrecision`, `read_work_precision`.

Imports: search, verification, orbits, simulation, loop, model, integrators, work, arrays,
errors.
"""

from typing import Any

import lazy_loader as lazy

_ORBIT = "use `zeno_orbits.prove(orbit)`, which encloses the same quantities"
_EXECUTION = "use `zeno_orbits.enclose_period(orbit)`, which encloses every event of a period"
_REMOVED = {
    "ExtendedOrbit": _ORBIT,
    "extended_orbit": _ORBIT,
    "ExtendedExecution": _EXECUTION,
    "extended_execution": _EXECUTION,
}
"""Removed names of version 0.2, and their replacements."""

_attribute, __dir__, __all__ = lazy.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """Import a name when it is first used.

    Raises:
        AttributeError: If the name is unknown.
        InputError: If the name was removed.
    """
    if name in _REMOVED:
        from zeno_orbits.errors import InputError

        raise InputError(f"`zeno_orbits.precision.{name}` is removed: {_REMOVED[name]}.")
    return _attribute(name)
