"""Proof that a periodic orbit exists: a theorem with a certificate that can be checked.

The motions from a box on the release section are enclosed over one period in balls (midpoint-radius
intervals with outward rounding), through every impact, the Zeno point and the contact phase.
Krawczyk's operator then shows that exactly one orbit passes through the box. The packages and
modules, in the order of the computation: `arithmetic` (equations in balls), `integration` (one
period, with impacts and the Zeno tail), `fixed_point`, `claims`, `prover`. `enclosure` encloses
one period without a fixed point. `basin` searches large sets of initial states. `branch` proves
orbits over an interval of one parameter, range by range.
`checker` checks certificates and shares no module with the prover. `replay` simulates a certificate
with the problem's hand-written model.

Offers: `prove_orbit`, `Proof`, `ProofSettings`; `enclose_one_period`, `EnclosureSettings`,
`PeriodEnclosure`; `check_proof`, `check_proof_of`, `ProofVerdict`; `prove_branch`, `BranchProof`,
`BranchEstimate`; `check_branch`, `is_branch`, `BranchVerdict`; `replay_proof`, `Replay`;
`equilibrium_report`, Theorem 1 at a state, with an `EquilibriumReport` and a `ZenoNeighbourhood`.

Imports: orbits, model, integrators, work, arrays, errors. Balls are python-flint's. Never
search, continuation, maps, experiment or precision; `checker` imports model, work and errors alone.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
