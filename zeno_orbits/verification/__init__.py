"""Verification of an orbit from its data alone.

The problem is rebuilt from the orbit's gains and parameters and integrated forward. The result is
compared with the data of the orbit. The verification is independent of the method that found the
orbit. The modules in the order of execution are `claim` (the orbit as vectors), `integration`,
`residuals`, `second_net` (sampled guards), `energies`, `cross_checks` (truncations, a second
model), `margins`, `multipliers` and `certificate`. `verifier` combines them.

Offers: `verify`, `multipliers_of`, `VerificationSettings`, `OrbitCertificate`, `CHECKS`,
`RESIDUALS`, `with_certificate`; `claimed_start`; `EVENT_MARGINS`, `measured_margin`.

Imports: orbits, simulation, model, integrators, work, arrays, errors. Never search,
continuation, maps, experiment or precision.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
