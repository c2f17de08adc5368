"""Models of mechanisms: energies, drives, stop and named parameters, also as fast functions.

A problem file creates a `HybridLagrangian`, adds a drive and the stop (`hybrid_system`) and names
its parameters in a `Problem`. `problem.dynamics(values)` is the system at given parameter values,
as numeric functions with derivatives (`numeric`). `contact` defines the impact law, `library` loads
files, and `validation` rejects inconsistent models.

Offers: `load_problem`, `locate_problem`, `bundled_problems`, and a `Problem` of `Quantity`s with
its `ParameterValues`. Functions: the `HybridDynamics` and the `CompiledSystem` of a problem, the
`CharacteristicScales` of its quantities and its `own_time`. Parts of a model: `CompletedSystem`
and the parts of a `Rig`.

Imports: integrators, work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
