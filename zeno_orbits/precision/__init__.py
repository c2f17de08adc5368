"""Errors of results and their price: error estimates, reduced models, work and precision.

An error estimate comes from a second run at a looser tolerance; the truth that engines are compared
with, from numbers of many digits: `gauss` follows flows in them, `extended_run` executions.

Offers: `simulate_to` (an execution to a wanted accuracy), `simulate_with_error`, `settings_for`,
`difference` (of two executions); `reduction_costs` (errors of reduced models);
`trade`, `WorkPrecision`, `read_work_precision`; `extended_execution`, `extended_orbit` (in many
digits).

Many digits are python-flint's (the extra `proof`); `proof` evaluates functions in them.

Imports: search, proof, verification, orbits, simulation, model, integrators, work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
