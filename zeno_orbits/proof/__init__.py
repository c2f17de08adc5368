"""Proof that a periodic orbit exists: a theorem with a certificate that can be checked.

The motions from a box on the release section are followed once around in balls, numbers that are
rounded outward, through every impact, the Zeno point and the locked arc; Krawczyk's operator then
tells that one orbit passes through the box. In the order in which it runs: `expressions` and
`program` (equations in balls), `flow` (one step), `sets`, `section`, `crossing`, `impacts` (with
the Zeno tail), `walk` (once around), `fixed_point`, `claims`, `prover`. `checker` judges
certificates and shares no module with what makes them; `replay` follows one with the problem's
hand-written model.

Offers: `prove`, `Proof`, `ProofSettings`, `write_proof`; `check_proof`, `check_proof_of`,
`ProofVerdict`, `ClaimVerdict`; `replay_proof`, `Replay`.

Imports: orbits, model, work, arrays, errors. Balls are python-flint's (the extra `proof`). Never
search, continuation, maps, experiment or precision; `checker` imports model, work and errors alone.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
