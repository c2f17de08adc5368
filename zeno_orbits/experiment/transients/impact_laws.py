r"""Laws of impact compared on transients: which one do the recordings support?

With the impact speed `v` and a fixed speed `u`, the largest at the start values:

.. math:: e = e_0, \qquad e = e_0 - c\,v, \qquad e = \min(0.98,\ e_0\,(v/u)^{-n}).

The cap keeps the limit at speed zero below 1, so impacts accumulate. A law is supported if its
residuals show no structure, and the law with the fewest parameters counts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import casadi as ca

from zeno_orbits.errors import InputError, SimulationError, did_you_mean
from zeno_orbits.experiment.identification.identification import Identification
from zeno_orbits.model import (
    CompletedSystem,
    ParameterValues,
    Problem,
    Quantity,
    impact_speed,
)
from zeno_orbits.simulation import simulate
from zeno_orbits.work import ByValue, Columns, TableRepr

LAWS: Mapping[str, str] = {"constant": "", "linear": "fall", "power": "exponent"}
"""Name of a law to its further parameter."""
_CAP = 0.98
"""Largest restitution of a power law."""
_FIRST, _LEAST, _MOST = 0.1, 1e-3, 0.9
"""Start and ends of a further parameter, as the part of the restitution that it takes away at the
speed `u`, or as the exponent."""
_WAIT = 100.0
"""Times of the problem in which a first impact is looked for."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LawFit(ByValue):
    """Parameters under one law of impact.

    Attributes:
        law: Name of the law.
        found: The fit.
    """

    law: str
    found: Identification

    @property
    def is_supported(self) -> bool:
        """True if the residuals show no structure, and the law's own parameter is determined."""
        known = self.found.transient
        sound = all(one.low < one.high for one in self.found.fitted)
        return known is not None and not known.tests.has_structure and sound


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class LawComparison(TableRepr):
    """Laws of impact, each fitted to the same recordings.

    Attributes:
        problem: Name of the problem.
        fits: The fits, the law with the fewest parameters first.
    """

    problem: str
    fits: tuple[LawFit, ...]

    def __repr__(self) -> str:
        """Return one line: the verdict."""
        return f"<LawComparison of {self.problem}: {self.verdict}>"

    @property
    def supported(self) -> LawFit | None:
        """The simplest law that the recordings support, or ``None``."""
        return next((one for one in self.fits if one.is_supported), None)

    @property
    def best(self) -> LawFit:
        """The supported law, or else the law with the smallest deviations."""
        return self.supported or min(self.fits, key=lambda one: one.found.after)

    @property
    def verdict(self) -> str:
        """One sentence: the law that the recordings support."""
        one = self.supported
        if one is None:
            return f"no law is supported; `{self.best.law}` has the smallest deviations"
        if one is self.fits[0] and len(self.fits) > 1:
            return f"the recordings support the law `{one.law}` without a further parameter"
        return f"the recordings support the law `{one.law}`"

    def _columns(self) -> Columns:
        """Return a row for each law."""
        return {
            "law": [one.law for one in self.fits],
            "deviation": [one.found.after for one in self.fits],
            "supported": [one.is_supported for one in self.fits],
            "restitution": [_value(one.found, "restitution") for one in self.fits],
            "further": [_value(one.found, LAWS[one.law]) for one in self.fits],
        }

    def as_json(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {
            "problem": self.problem,
            "verdict": self.verdict,
            "best": self.best.law,
            "laws": {
                one.law: {"supported": one.is_supported, **one.found.as_json()} for one in self.fits
            },
        }


def _value(found: Identification, name: str) -> float:
    known = {one.unknown.label: one.value for one in found.fitted}
    return known.get(name, float("nan"))


def laws_of(
    problem: Problem,
    values: ParameterValues,
    laws: Sequence[str],
    fitted: Callable[[Problem, ParameterValues, Mapping[str, tuple[float, float]]], Identification],
) -> LawComparison:
    """Return the fits of laws of impact.

    Args:
        problem: The problem, with a parameter `restitution`.
        values: Its values at the start.
        laws: Names of the laws.
        fitted: Fits a problem from its values, with ranges of further parameters.

    Raises:
        InputError: If a law is unknown, or the problem lacks a parameter `restitution`, or has
            one with the name of a law's own.
    """
    if not laws:
        raise InputError(f"Argument `law` must name at least one of {', '.join(LAWS)}.")
    for law in laws:
        if law not in LAWS:
            hint = did_you_mean(law, LAWS)
            raise InputError(
                f"Argument `law` must name {', '.join(LAWS)}, but it names `{law}`.{hint}"
            )
    if "restitution" not in values.parameters:
        raise InputError(
            "Argument `law` needs a problem whose restitution is the parameter `restitution`, but "
            f"`{problem.name}` lacks it."
        )
    fits, speed = list[LawFit](), _largest_speed(problem, values)
    for law in (one for one in LAWS if one in laws):
        if law == "constant":
            fits.append(LawFit(law=law, found=fitted(problem, values, {})))
            continue
        other, box = _with_law(problem, values, law, speed)
        numbers = other.values(gains=values.gains, parameters=values.parameters)
        fits.append(LawFit(law=law, found=fitted(other, numbers, {LAWS[law]: box})))
    return LawComparison(problem=problem.name, fits=tuple(fits))


def _with_law(
    problem: Problem, values: ParameterValues, law: str, speed: float
) -> tuple[Problem, tuple[float, float]]:
    """Return a problem with another law of impact, and the range of its further parameter."""
    further = LAWS[law]
    if further in values.parameters:
        raise InputError(
            f"Argument `law`: the law `{law}` has the parameter `{further}`, and so has "
            f"`{problem.name}`. Write the law into the problem, and fit its parameters."
        )
    unit = values.number("restitution") / speed if law == "linear" else 1.0
    quantity = Quantity(
        name=further,
        unit="1",
        meaning=f"{further} of the law of impact with the speed",
        default=_FIRST * unit,
        lower=0.0,
    )

    def model(p: Mapping[str, Any]) -> CompletedSystem:
        e, c = p["restitution"], p[further]
        formula = ca.SX(e - c * impact_speed)
        if law == "power":
            formula = cast("ca.SX", ca.fmin(_CAP, e * ca.power(impact_speed / speed, -c)))
        known = {name: ca.SX(p[name]) for name in p if name != further}
        return problem.model({**known, "restitution": formula})

    other = replace(problem, model=model, parameters=(*problem.parameters, quantity))
    return other, (_LEAST * unit, _MOST * unit)


def _largest_speed(problem: Problem, values: ParameterValues) -> float:
    """Return the speed of the first impact at the start values, or the problem's own scale."""
    graph = problem.graph_dynamics(values)
    for start in problem.admissible_starts(values):
        try:
            motion = simulate(graph, start, until=_WAIT * graph.own.time, impacts=1)
        except (InputError, SimulationError):
            continue
        speeds = [abs(one.approach_rate) for one in motion.impacts]
        if speeds and max(speeds) > 0.0:
            return max(speeds)
    return graph.own.gap_rate
