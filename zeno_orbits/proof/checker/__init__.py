"""Check certificates of Zeno periodic orbits, without the prover and in another arithmetic.

A certificate is proved in exact integers: one inclusion a record, in any order. Nothing of the
prover is imported; what both share is the problem, whose CasADi instructions are walked here anew.
Format: `docs/proof_file.md`. Offers: `check_proof`. May import: `model`, `work`, `errors`.
"""
