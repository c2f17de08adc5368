"""Checker for certificates of Zeno periodic orbits, independent of the prover and its arithmetic.

A certificate is proved in exact integers: one inclusion per record, in any order. The checker
imports nothing from the prover. Both share only the problem, whose CasADi instructions are
translated here again.
Format: `docs/proof_file.md`. Offers: `check_proof`. May import: `model`, `work`, `errors`.
"""
