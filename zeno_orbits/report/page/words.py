"""Sentences of a report, for a reader without knowledge of hybrid systems."""

from __future__ import annotations

import math
from collections.abc import Mapping

from zeno_orbits.model import Problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.simulation import Execution
from zeno_orbits.verification import OrbitCertificate

MARGINS: Mapping[str, tuple[str, str]] = {
    "gap_acceleration": (
        "how hard the moving part is drawn to the stop where the impacts accumulate. At zero it "
        "would lift off there",
        "{acceleration}",
    ),
    "first_impact_speed": (
        "how fast the first impact is. At zero the part would only graze the stop",
        "{speed}",
    ),
    "later_impact_speed": (
        "how much of the speed after an impact the next impact has. At zero it would only graze "
        "the stop",
        "1",
    ),
    "release_transversality": (
        "how fast the contact force falls at the release. At zero the release is not transversal",
        "{force_rate}",
    ),
    "switch_transversality": (
        "how fast the guard of a switch falls at the switch. At zero the switch is only touched",
        "of the guard, per s",
    ),
    "lets_go": ("how fast the part leaves a stop that does not hold it", "{acceleration}"),
    "phases_apart": ("how much the flights of a period differ. At zero the period is shorter", "1"),
    "events_apart": ("the shortest time between two events. At zero their order changes", "s"),
    "locked_time": ("how long the part rests on its stop. At zero it would never rest", "s"),
}
"""Meaning and unit of each margin by name. In the unit, ``{speed}`` and ``{acceleration}`` stand
for the units of the gap's derivatives, and ``{force_rate}`` for that of its force's derivative."""

ENERGIES: Mapping[str, str] = {
    "input_work": "put in by the source",
    "copper_loss": "lost as heat in the windings",
    "other_loss": "lost to friction and the like",
    "impact_loss": "lost in the impacts",
    "energy_gain": "left over after the period",
}
"""Name of an energy to its meaning."""

MODES: Mapping[str, str] = {"free": "off the stop", "locked": "on the stop"}
"""Mode of the orbit in plain words."""

LAWS: tuple[tuple[str, str, str], ...] = (
    (
        "1.7",
        "<i>ḣ</i><sup>+</sup> = −<i>e</i> <i>ḣ</i><sup>−</sup>",
        "Newton's law of an impact: the part leaves the stop with the restitution e times the "
        "speed at which it came.",
    ),
    (
        "2.1",
        "<i>h</i> = <i>ḣ</i> = 0, <i>ḧ</i> &lt; 0",
        "The Zeno point (Theorem 1): near a state at rest on a stop that holds it, infinitely many "
        "impacts accumulate in finite time if the restitution is between 0 and 1.",
    ),
    (
        "2.4",
        "<i>λ</i> = 0, d<i>λ</i>/d<i>t</i> &lt; 0",
        "The release: the stop would have to pull, and contact ends.",
    ),
    (
        "2.5",
        "<i>E</i>(<i>T</i>) = <i>E</i>(0)",
        "The energy balance: over one period the losses equal the input work, and the energy "
        "returns to its value.",
    ),
    (
        "2.7",
        "<i>t</i><sub>∞</sub> − <i>t</i> ≈ 2<i>w</i> / (|<i>ḧ</i>| (1 − <i>e</i>))",
        "The time that all later flights take together, after an impact that the part leaves with "
        "the speed w: a geometric series, drawn dashed.",
    ),
    (
        "3.3",
        "<i>P</i>(<i>x</i>*) = <i>x</i>*, <i>μ</i> = eigenvalues of d<i>P</i>/d<i>x</i>",
        "The return map P leads from one start of a period to the next. Its multipliers are the "
        "factors by which small disturbances of the start change per period, to first order.",
    ),
    (
        "3.4",
        "|simulated − stated| / size",
        "A residual: zero for a true orbit, relative to the size of the compared values.",
    ),
)
"""Number of a law in the theory, the law as HTML, and its statement."""


def headline(certificate: OrbitCertificate) -> str:
    """Return the answer in a few words."""
    if not certificate.passed:
        return "Not verified: do not rely on these values."
    has = f"the model has this orbit within the tolerance {certificate.tolerance:.0e}"
    if certificate.stable:
        return f"Verified: {has}, and small disturbances of it decay."
    if certificate.unstable:
        return f"Verified, but unstable: {has}, and small disturbances of it grow."
    return f"Verified: {has}. Whether small disturbances decay is undecided."


def cautions(problem: Problem, execution: Execution | None) -> list[str]:
    """Return cautions about the values, for example angles that exceed half a turn.

    Args:
        problem: The problem.
        execution: One period, if it could be simulated.
    """
    if execution is None:
        return []
    states = execution.sampled(20)[1]
    found: list[str] = []
    for k, (name, unit) in enumerate(zip(problem.state_names, problem.state_units, strict=True)):
        low, high = float(states[:, k].min()), float(states[:, k].max())
        if unit == "rad" and max(-low, high) > math.pi:
            found.append(
                f"{name} runs from {low:.4g} to {high:.4g} rad, beyond half a turn. Angles are "
                "not wrapped to one turn. Check that the mechanism can turn so far."
            )
    return found


def story(
    orbit: Orbit,
    certificate: OrbitCertificate,
    execution: Execution | None,
) -> str:
    """Return one period in words.

    Args:
        orbit: The orbit.
        certificate: Its certificate.
        execution: One period, if it could be simulated.
    """
    said = (
        ""
        if certificate.passed
        else "The file states this, and the check below does not confirm it. "
    )
    repeats = f"In the model the motion repeats every {orbit.period:.4g} s."
    if execution is None:
        return f"{said}{repeats}"
    begins = orbit.section.partition(" ")[0]
    if len({event.name.partition(" ")[2] for event in orbit.events}) > 1 or begins == "zeno":
        return f"{said}{repeats} {_events(orbit)}"
    if len(execution.zeno_points) == 1 and begins == "release":
        return f"{said}{repeats} {_one_zeno_point(orbit, execution)}"
    count, points = len(execution.impacts), len(execution.zeno_points)
    if not points:
        return (
            f"{said}{repeats} The moving part strikes its stop and rebounds {count} times per "
            "period."
        )
    if _slow_restitution(orbit, execution) == 0.0:
        return (
            f"{said}{repeats} The moving part strikes its stop {count} times. Each impact stops "
            f"the part, and {points} times the contact lasts for a while."
        )
    return (
        f"{said}{repeats} The simulation resolves {count} impacts of the moving part on its stop. "
        f"{points} times infinitely many impacts accumulate, and the contact lasts for a while."
    )


_PHRASES: Mapping[str, str] = {
    "zeno": "the impacts on the stop {} end in contact (Zeno point)",
    "impact": "an impact on the stop {}",
    "release": "the stop {} releases",
    "switch": "the switch {}",
}
"""Kind of an event to its phrase. The braces stand for the name of the stop or switch."""


def _events(orbit: Orbit) -> str:
    """Return the event sequence in words."""
    phrases: list[str] = []
    for name in orbit.sequence:
        kind, _, what = name.partition(" ")
        phrases.append(_PHRASES[kind].format(f"“{what}”"))
    return f"In each period, in this order: {'; '.join(phrases)}."


def _slow_restitution(orbit: Orbit, execution: Execution) -> float:
    """Return the restitution of the slowest impacts, from their speeds if no parameter is that."""
    if "restitution" in orbit.parameters:
        return orbit.parameters["restitution"]
    if all(zeno.tail == 0.0 for zeno in execution.zeno_points):
        return 0.0
    before, last = (impact.approach_rate for impact in execution.impacts[-2:])
    return last / before


def _one_zeno_point(orbit: Orbit, execution: Execution) -> str:
    e, first = _slow_restitution(orbit, execution), orbit.impacts[0].time
    zeno = execution.zeno_points[0].time
    flight = f"The moving part leaves its stop and strikes it again after {first:.4g} s."
    if e > 0.0:
        hits = (
            f"It bounces. In the end each impact is {1 / e:.3g} times slower than the one before, "
            f"and infinitely many impacts occur within {zeno - first:.4g} s. They accumulate "
            "at the Zeno point."
        )
    else:
        hits = "This one impact stops the part: it is the Zeno point."
    rest = (
        f"Then the part stays in contact for {orbit.period - zeno:.4g} s. After the release, the "
        "cycle repeats."
    )
    return f"{flight} {hits} {rest}"


def stability(certificate: OrbitCertificate) -> str:
    """Return the effect of a small disturbance in words: the derivative of the return map."""
    radius = certificate.spectral_radius
    if certificate.stable and not certificate.multipliers:
        return (
            "The conditions of the event at which the period starts determine its state: after a "
            "sufficiently small disturbance, the next such event has the same state."
        )
    if certificate.stable:
        return (
            "A sufficiently small disturbance decays. To first order it is multiplied by about "
            f"{radius:.3g} per period in the long run. All multipliers lie inside the unit circle."
        )
    if certificate.unstable:
        return (
            "Small disturbances grow, except along some directions. To first order the factor is "
            f"about {radius:.3g} per period in the long run. A multiplier lies outside the unit "
            "circle."
        )
    return "The multipliers are not accurate enough to decide whether a small disturbance decays."
