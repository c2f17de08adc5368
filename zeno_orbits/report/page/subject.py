"""What a report is about: an orbit, what a check said of it, and the motion to draw."""

from __future__ import annotations

from dataclasses import dataclass

from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.problem import Problem
from zeno_orbits.orbits.orbit import ZenoOrbit
from zeno_orbits.precision.work_precision import Trade
from zeno_orbits.report.orbit_motion import motion_of
from zeno_orbits.simulation.execution import Execution
from zeno_orbits.verification.certificate import OrbitCertificate


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """What a report is about.

    Attributes:
        orbit: The orbit, as its file has it.
        problem: Its problem.
        dynamics: The problem at the orbit's numbers.
        certificate: What a forward integration said of it, just now.
        execution: One period, simulated from the orbit's release; none if that failed.
        trouble: Why it failed; empty if it did not.
        trade: What accuracy costs in this problem, if that was measured.
        file: Name of the orbit's file.
        scene_file: Path of the problem's file; empty for a bundled problem.
        content: The orbit's file itself.
        command: The words of the command that made the report.
    """

    orbit: ZenoOrbit
    problem: Problem
    dynamics: HybridDynamics
    certificate: OrbitCertificate
    execution: Execution | None
    trouble: str
    trade: Trade | None
    file: str
    problem_file: str
    content: str
    command: tuple[str, ...]


def subject_of(
    orbit: ZenoOrbit,
    problem: Problem,
    dynamics: HybridDynamics,
    certificate: OrbitCertificate,
    *,
    trade: Trade | None = None,
    file: str = "orbit.json",
    problem_file: str = "",
    content: str = "",
    command: tuple[str, ...] = (),
) -> Subject:
    """Return what a report is about, one period simulated; see `Subject` for the arguments."""
    execution, trouble = None, ""
    try:
        execution = motion_of(orbit, problem, dynamics)
    except ZenoOrbitsError as error:
        # A false orbit may run anywhere; the page says so and does without its pictures.
        trouble = str(error)
    return Subject(
        orbit=orbit,
        problem=problem,
        dynamics=dynamics,
        certificate=certificate,
        execution=execution,
        trouble=trouble,
        trade=trade,
        file=file,
        problem_file=problem_file,
        content=content,
        command=command,
    )
