"""The subject of a report: an orbit, its fresh certificate, and the motion to draw."""

from __future__ import annotations

from dataclasses import dataclass, replace

from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model import HybridDynamics, Problem
from zeno_orbits.orbits import ZenoOrbit
from zeno_orbits.precision import WorkPrecision
from zeno_orbits.report.motion import motion_of
from zeno_orbits.simulation import Execution
from zeno_orbits.verification import OrbitCertificate


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """The subject of a report.

    Attributes:
        orbit: The orbit, as its file has it.
        problem: Its problem.
        dynamics: The problem at the orbit's numbers.
        certificate: Its certificate, computed afresh.
        execution: One period, simulated from the orbit's start; ``None`` before, or if that failed.
        trouble: The reason of the failure; empty if there was none.
        trade: The problem's work-precision measurements, if there are any.
        file: Name of the orbit's file.
        problem_file: Path of the problem's file; empty for a bundled problem.
        content: The orbit's file itself.
        command: The words of the command that wrote the report.
        date: The day of the check, as text; empty if it shall not be told.
        proof: What an accepted certificate proves; empty without one.
    """

    orbit: ZenoOrbit
    problem: Problem
    dynamics: HybridDynamics
    certificate: OrbitCertificate
    execution: Execution | None = None
    trouble: str = ""
    trade: WorkPrecision | None = None
    file: str = "orbit.json"
    problem_file: str = ""
    content: str = ""
    command: tuple[str, ...] = ()
    date: str = ""
    proof: str = ""

    def followed(self) -> Subject:
        """Return the subject with one period simulated."""
        try:
            execution = motion_of(self.orbit, self.problem, self.dynamics)
        except ZenoOrbitsError as error:
            # A false orbit may run anywhere; the page says so and does without its pictures.
            return replace(self, trouble=str(error))
        return replace(self, execution=execution)
