"""The subject of a report: an orbit, its fresh certificate, and the motion to draw."""

from __future__ import annotations

from dataclasses import dataclass, replace

from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.experiment import Comparison
from zeno_orbits.maps import Pushes, Recovery
from zeno_orbits.model import GraphDynamics, HybridDynamics, Problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.precision import WorkPrecision
from zeno_orbits.report.motion import orbit_motion
from zeno_orbits.simulation import Execution
from zeno_orbits.verification import OrbitCertificate


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """The subject of a report.

    Attributes:
        orbit: The orbit, as stored in its file.
        problem: Its problem.
        dynamics: The problem at the orbit's parameter values, for an orbit of events the graph of
            modes.
        certificate: Verification report of the orbit, computed afresh.
        execution: One period, simulated from the orbit's start. It is ``None`` before the
            simulation and after a failed simulation.
        trouble: Reason of the failure, or an empty string.
        trade: The problem's work-precision measurements, if there are any.
        pushes: The orbit's largest pushes, if they are known.
        recovery: The orbit's recovery from disturbances, if it is known.
        comparison: A recording compared with the orbit, if there is one.
        recording: Name of its file.
        file: Name of the orbit's file.
        problem_file: Path of the problem's file, or an empty string for a bundled problem.
        content: The orbit's file itself.
        command: The words of the command that wrote the report, if a command wrote it.
        date: Day of the check as text, or an empty string to omit it.
        proof: The verdict of an accepted certificate, then the hypotheses and conclusions of its
            theorem, one per line. Empty without a certificate.
    """

    orbit: Orbit
    problem: Problem
    dynamics: HybridDynamics | GraphDynamics
    certificate: OrbitCertificate
    execution: Execution | None = None
    trouble: str = ""
    trade: WorkPrecision | None = None
    pushes: Pushes | None = None
    recovery: Recovery | None = None
    comparison: Comparison | None = None
    recording: str = ""
    file: str = "orbit.json"
    problem_file: str = ""
    content: str = ""
    command: tuple[str, ...] = ()
    date: str = ""
    proof: tuple[str, ...] = ()

    def followed(self) -> Subject:
        """Return the subject with one period simulated."""
        try:
            execution = orbit_motion(self.orbit, self.problem, self.dynamics)
        except ZenoOrbitsError as error:
            # The simulation of an invalid orbit may diverge. The page then reports this and omits
            # its plots.
            return replace(self, trouble=str(error))
        return replace(self, execution=execution)
