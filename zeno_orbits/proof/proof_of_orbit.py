"""Whether a certificate proves the orbit of a file: it is accepted, and about that orbit."""

from __future__ import annotations

import json
from pathlib import Path

from zeno_orbits.errors import InputError
from zeno_orbits.model import Problem
from zeno_orbits.orbits import ZenoOrbit
from zeno_orbits.proof.checker.certificate import ProofVerdict, check_proof
from zeno_orbits.proof.replay import doubles

_CLOSE = 1e-8
"""How far an orbit's numbers may be from those that are proved, per size."""


def check_proof_of(orbit: ZenoOrbit, problem: Problem, path: Path) -> ProofVerdict:
    """Check a certificate, and that it is about an orbit.

    Args:
        orbit: The orbit.
        problem: Its problem.
        path: The certificate.

    Raises:
        InputError: If it is no certificate, or one of another orbit.
    """
    verdict = check_proof(path, problem)
    data = json.loads(path.read_text(encoding="utf-8"))
    bits = data["bits"]
    proved = dict(zip(data["parameters"], doubles(data["parameters"].values(), bits), strict=True))
    own = orbit.values(problem).vector
    for name, known in zip(problem.names, own, strict=True):
        if proved[name] != known:
            wanted = f"must be about `{name}` = {known!r}, but it is about {proved[name]!r}"
            raise InputError(f"Argument `proof` {wanted}.")
    for claim in data["claims"]:
        if claim["name"] == "start_state":
            state = problem.state_vector(dict(orbit.start_state))
            sizes = problem.dynamics(own).own.states(len(state))
            found = zip(problem.state_names, doubles(claim["low"], bits), state, sizes, strict=True)
            for name, x, y, size in found:
                if abs(x - y) > _CLOSE * max(size, abs(y)):
                    wanted = f"must be about an orbit with `{name}` = {y!r} at its start"
                    raise InputError(f"Argument `proof` {wanted}, but it is about {x!r}.")
            return verdict
    raise InputError("Argument `proof` must claim a `start_state`, but it does not.")
