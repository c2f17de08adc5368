"""Outcomes of starts as plain data, every bit kept, so that they can cross processes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zeno_orbits.orbits.orbit_file import orbit_from_json
from zeno_orbits.search.outcome import Candidate, StartOutcome
from zeno_orbits.search.settings import SearchStatus
from zeno_orbits.simulation.signals import Extent
from zeno_orbits.verification.certificate import DeltaCut, OrbitCertificate
from zeno_orbits.work.serialization import plain


def outcome_to_json(outcome: StartOutcome) -> dict[str, Any]:
    """Return the outcome of a start as plain data."""
    data: dict[str, Any] = plain(outcome)
    if outcome.candidate is not None:
        # The form of its file.
        data["candidate"]["orbit"] = outcome.candidate.orbit.as_json()
    return data


def outcome_from_json(data: Mapping[str, Any]) -> StartOutcome:
    """Return the outcome of a start from what `outcome_to_json` gave."""
    candidate = data["candidate"]
    return StartOutcome(
        status=SearchStatus[data["status"]],
        detail=data["detail"],
        residuals=_numbers(data["residuals"]),
        agreement=float(data["agreement"]),
        closure_error=float(data["closure_error"]),
        n_unknowns=data["n_unknowns"],
        iterations=data["iterations"],
        solve_time=float(data["solve_time"]),
        shortfall=float(data["shortfall"]),
        candidate=None if candidate is None else _candidate(candidate),
    )


def _candidate(data: Mapping[str, Any]) -> Candidate:
    certificate = data["certificate"]
    return Candidate(
        orbit=orbit_from_json(data["orbit"], Path("candidate")),
        score=float(data["score"]),
        extents={
            name: Extent(
                lowest=float(extent["lowest"]),
                highest=float(extent["highest"]),
                error=float(extent["error"]),
            )
            for name, extent in data["extents"].items()
        },
        certificate=None if certificate is None else _certificate(certificate),
    )


def _certificate(data: Mapping[str, Any]) -> OrbitCertificate:
    return OrbitCertificate(
        tolerance=float(data["tolerance"]),
        residuals=_numbers(data["residuals"]),
        margins=_numbers(data["margins"]),
        energies=_numbers(data["energies"]),
        multipliers=tuple(complex(float(re), float(im)) for re, im in data["multipliers"]),
        multiplier_error=float(data["multiplier_error"]),
        delta_sweep=tuple(_cut(cut) for cut in data["delta_sweep"]),
        delta_order=float(data["delta_order"]),
        integration_error=float(data["integration_error"]),
        zeno_error=float(data["zeno_error"]),
        period=float(data["period"]),
        n_periods=data["n_periods"],
        model=data["model"],
        trouble=data["trouble"],
        shape=data["shape"],
        asked=tuple(data["asked"]),
    )


def _cut(data: Mapping[str, Any]) -> DeltaCut:
    return DeltaCut(
        delta=float(data["delta"]), speed=float(data["speed"]), error=float(data["error"])
    )


def _numbers(data: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in data.items()}
