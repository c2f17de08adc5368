"""Verification of an orbit from its numbers alone.

The problem is rebuilt from the orbit's gains and parameters, integrated forward, and compared with
what the orbit claims; nothing here knows how the orbit was found. In the order in which it runs:
`claim` (the orbit as vectors), `integration`, `residuals`, `cross_checks` (cuts, energies, a second
model), `certificate`; `verifier` puts these together. `measurement` answers another question:
how large a quantity is on an orbit.

Offers: `verify`, `multipliers_of`, `VerificationSettings`, `OrbitCertificate`, `RESIDUALS`,
`certified`, `problem_dynamics`; `measure`, `require_quantities`.

Imports: orbits, simulation, model, integrators, work, arrays, errors. Never search, continuation,
maps, experiment or precision.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
