"""Models of machines: energies, drives, stop and named numbers; and the same as fast functions.

A problem file makes a `HybridLagrangian`, adds a drive and the stop (`complete`) and names its
numbers in a `Problem`. `problem.dynamics(values)` is the machine at given numbers, as numeric
functions with derivatives (`numeric`). `contact` states the law of an impact, `library` loads
files, `validation` refuses models that do not hold together.

Offers: `load_problem`, `locate_problem`, `bundled_problems`; a `Problem` of `Quantity`s, its
`ParameterValues`; the `HybridDynamics` and the `CompiledSystem` of one, the `OwnScale` of its
numbers and its `own_time`; `CompletedSystem`,
`complete`, `HybridLagrangian`, `Clock`, `MotorBank` and the drives; the parts of a `Rig`.

Imports: integrators, kernels, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
