"""That an orbit exists, as a theorem: validated numerics through the Zeno point.

`checker` judges certificates and shares no module with what makes them.

Offers: `check`, `ProofVerdict`, `ClaimVerdict`.

Imports: verification, orbits, simulation, model, integrators, work, arrays, errors. Never search,
continuation, maps, experiment or precision; `checker` imports model and errors alone.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
