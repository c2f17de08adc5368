"""Checks of an orbit: verification, proofs, enclosures and Floquet multipliers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits.api.inputs import (
    Named,
    Numbers,
    Span,
    any_orbit,
    as_orbit,
    as_span,
    front_door,
    known_problem,
    plan_of,
    problem_of,
    problem_to_check,
)
from zeno_orbits.errors import (
    InputError,
    ZenoOrbitsError,
    finite_number,
    named_numbers,
    positive_number,
)
from zeno_orbits.orbits import Orbit
from zeno_orbits.work import ExecutionPlan, Progress, read_json, silent

if TYPE_CHECKING:
    from zeno_orbits.model import GraphDynamics, HybridDynamics, Problem
    from zeno_orbits.orbits import ReturnMap, Stability
    from zeno_orbits.proof import (
        BranchEstimate,
        BranchProof,
        BranchVerdict,
        PeriodEnclosure,
        Proof,
        ProofVerdict,
        Replay,
    )
    from zeno_orbits.simulation import SimulationSettings
    from zeno_orbits.verification import OrbitCertificate, VerificationSettings


@front_door
def verify(
    orbit: Orbit | str | Path,
    *,
    problem: Named | None = None,
    settings: VerificationSettings | None = None,
    dynamics: HybridDynamics | GraphDynamics | None = None,
    on_progress: Progress = silent,
) -> OrbitCertificate:
    """Return the certificate of an orbit from an independent forward integration.

    Args:
        orbit: The orbit, or its file. Its own certificate and multipliers are ignored.
        problem: The orbit's problem. The default is the bundled problem of its name.
        settings: Tolerance, number of periods and accuracy.
        dynamics: Dynamics at the gains and parameters of the orbit, if they are already built.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If the orbit's problem is not known, or the orbit does not fit the problem.
        OrbitFileError: If the file is not an orbit file.
    """
    from zeno_orbits.verification import verifier

    orbit = any_orbit(orbit)
    known = problem_to_check(orbit, problem)
    return verifier.verify(
        orbit, known, settings=settings, dynamics=dynamics, on_progress=on_progress
    )


@front_door
def prove(
    orbit: Orbit | str | Path,
    *,
    problem: Named | None = None,
    interval: Numbers | None = None,
    radius: float | None = None,
    basin: bool = False,
    on_progress: Progress = silent,
) -> Proof:
    """Prove that an orbit exists and return the certificate, or the claim that cannot be proved.

    Args:
        orbit: The orbit, or its file. The certificate in it is ignored.
        problem: The orbit's problem. The default is the bundled problem of its name.
        interval: Gain or parameter to the radius of its interval. The proof covers all of it.
        radius: Radius of the box on the section, relative to the size of each coordinate. The
            default is chosen automatically.
        basin: True for a set of initial states that the return map maps into its interior, as
            large as the enclosures allow. The result also states whether every execution from it
            is proved to converge to the orbit.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If the orbit's problem is not known, or a value or name does not fit the
            problem.
        TranslationError: If the problem's equations are not analytic.
    """
    from zeno_orbits.proof import ProofSettings
    from zeno_orbits.proof import prove_orbit as proved

    orbit = any_orbit(orbit)
    known = problem_to_check(orbit, problem)
    if radius is not None:
        radius = positive_number("radius", radius)
        if basin:
            raise InputError("Argument `radius` sets the box, but `basin` chooses it. Remove one.")
    over = {
        name: finite_number(name, half)
        for name, half in named_numbers("interval", interval).items()
    }
    settings = ProofSettings(radius=radius, basin=basin)
    return proved(orbit, known, over=over, settings=settings, on_progress=on_progress)


@front_door
def prove_branch(
    orbit: Orbit | str | Path,
    branch: Span,
    *,
    problem: Named | None = None,
    workers: int = 1,
    plan: ExecutionPlan | None = None,
    on_progress: Progress = silent,
    on_estimate: Callable[[BranchEstimate], object] | None = None,
) -> BranchProof:
    """Prove a curve of orbits over an interval of one gain or parameter.

    Args:
        orbit: An orbit in the interval, or its file. The certificate in it is ignored.
        branch: Name of the gain or parameter, and its interval, ``("Kp", 6, 20)``. Parameters
            derived from it keep their values.
        problem: The orbit's problem. The default is the bundled problem of its name.
        workers: Number of processes. Several processes need the name or the file of the problem.
        plan: Executor of the work and folder of finished parts. It overrides ``workers``.
        on_progress: Called with the stage and the part of it that is done.
        on_estimate: Called with the expected number of ranges and time before most of the work.

    Returns:
        The theorem with its certificate, for the part of the interval that was proved, or the claim
        that could not be proved.

    Raises:
        InputError: If a name is unknown, or the interval does not contain the orbit.
        TranslationError: If the problem's equations are not analytic.
        WorkError: If the work cannot be finished.
    """
    from zeno_orbits.proof import prove_branch as proved

    name, box = as_span("branch", branch)
    orbit = any_orbit(orbit)
    known = problem_to_check(orbit, problem)
    found = proved(
        orbit,
        known,
        name,
        box,
        plan=plan_of(workers, plan),
        on_progress=on_progress,
        on_estimate=on_estimate,
    )
    if found.proved and not found.complete:
        on_progress("name the end of the branch", None)
        found = found.with_special_points(_special_points(orbit, known, name, box))
    return found


def _special_points(
    orbit: Orbit, problem: Problem, name: str, box: tuple[float, float]
) -> list[tuple[str, float]]:
    """Return kind and value of the special points and ends of the family of an orbit."""
    from zeno_orbits import continuation

    try:
        families = continuation.family_of_orbit(problem, orbit, name, box).families
    except ZenoOrbitsError:
        # The proof names its own reason.
        return []
    found = [one for family in families for one in (*family.special, family.first, family.last)]
    return [(one.kind.value, one.at.value) for one in found if one.kind.located]


@front_door
def check_branch(
    certificate: str | Path | Mapping[str, Any],
    *,
    problem: Named | None = None,
    workers: int = 1,
    plan: ExecutionPlan | None = None,
    on_progress: Progress = silent,
) -> BranchVerdict:
    """Check the certificate of a branch, range by range.

    Args:
        certificate: The file of a certificate, or its content. It is plain data without code.
        problem: The certificate's problem. The default is the bundled problem of its name.
        workers: Number of processes. Several processes need the name or the file of the problem.
        plan: Executor of the work. It overrides ``workers``.
        on_progress: Called with the finished part of the ranges.

    Raises:
        InputError: If the input is not the certificate of a branch, or its problem is not known.
    """
    from zeno_orbits.proof import check_branch as checked

    known = None if problem is None else known_problem(problem)
    shared = plan_of(workers, plan)
    return checked(certificate, known, plan=shared, on_progress=on_progress)


def is_branch_file(certificate: Path) -> bool:
    """Return True if a file is the certificate of a branch."""
    from zeno_orbits.proof import is_branch

    try:
        return is_branch(read_json(certificate))
    except ValueError:
        # The check of a proof names the fault of the file.
        return False


@front_door
def enclose_period(
    orbit: Orbit | str | Path,
    *,
    problem: Named | None = None,
    radius: float | None = None,
    tolerance: float = 1e-9,
    on_progress: Progress = silent,
) -> PeriodEnclosure:
    """Return an enclosure of one period: its events in order, without further contact in between.

    Args:
        orbit: The orbit, or its file. The certificate in it is ignored.
        problem: The orbit's problem. The default is the bundled problem of its name.
        radius: Radius of the box of initial states on the section, relative to the size of each
            coordinate. The default is 1e-11, then 1e-14.
        tolerance: Largest distance between the orbit and any execution of the box, for each event
            time and state. Times are relative to the period, states to their size.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If the orbit's problem is not known, or a value does not fit the problem.
    """
    from zeno_orbits.proof import EnclosureSettings
    from zeno_orbits.proof import enclose_one_period as enclosed

    orbit = as_orbit(orbit, problem)
    known = problem_to_check(orbit, problem)
    settings = EnclosureSettings(
        radius=None if radius is None else positive_number("radius", radius),
        tolerance=positive_number("tolerance", tolerance),
    )
    return enclosed(orbit, known, settings=settings, on_progress=on_progress)


@front_door
def check_certificate(
    certificate: str | Path, *, problem: Named | None = None
) -> tuple[ProofVerdict, Replay | None]:
    """Check a certificate in both ways: the inclusions, and the replay.

    Args:
        certificate: The file of a certificate.
        problem: The certificate's problem. The default is the bundled problem of its name.

    Returns:
        The check of the inclusions, and the replay with a hand-written model. The replay is None
        for a problem without a hand-written model.

    Raises:
        InputError: If the file is not a certificate, or its problem is not known.
    """
    from zeno_orbits.proof import check_proof, problem_of_certificate, replay_proof

    known = None if problem is None else known_problem(problem)
    verdict = check_proof(certificate, known)
    data = read_json(Path(certificate))
    return verdict, replay_proof(data, problem_of_certificate(data, known))


@front_door
def write_proof(certificate: Mapping[str, Any], path: str | Path) -> None:
    """Write the certificate of a proof.

    Args:
        certificate: The certificate of a `Proof`.
        path: The file.
    """
    from zeno_orbits.proof import proof_file

    proof_file.write_certificate(certificate, Path(path))


def check_certificate_of(
    orbit: Orbit, certificate: str | Path, *, problem: Named | None = None
) -> ProofVerdict:
    """Check a certificate that must belong to a given orbit.

    Args:
        orbit: The orbit.
        certificate: The file of a certificate.
        problem: The certificate's problem. The default is the bundled problem of its name.

    Raises:
        InputError: If the file is not a certificate, or belongs to another orbit.
    """
    from zeno_orbits.proof import check_proof_of

    return check_proof_of(orbit, problem_to_check(orbit, problem), Path(certificate))


@front_door
def floquet_multipliers(orbit: Orbit | str | Path, *, problem: Named | None = None) -> Stability:
    """Return the Floquet multipliers of an orbit with their errors, from exact derivatives.

    The result also has the return map in named coordinates, the slowest direction and the time in
    which a small disturbance decays or doubles.

    Args:
        orbit: The orbit, or its file.
        problem: The orbit's problem. The default is the bundled problem of its name.

    Raises:
        InputError: If the orbit's problem is not known, or the orbit does not fit the problem.
        SimulationError: If the simulation does not return to the orbit.
    """
    from zeno_orbits.orbits import stability_of
    from zeno_orbits.verification import multipliers_of

    orbit = any_orbit(orbit)
    used = problem_of(orbit, problem)
    return stability_of(used, orbit, multipliers_of(orbit, used))


@front_door
def return_map(
    orbit: Orbit | str | Path,
    section: str | None = None,
    *,
    problem: Named | None = None,
    simulation: SimulationSettings | None = None,
) -> ReturnMap:
    """Return the return map of an orbit in named coordinates, with its derivatives.

    Args:
        orbit: The orbit, or its file.
        section: Event on whose section the map is taken, such as ``release stop``. The default is
            the event at which the orbit starts.
        problem: The orbit's problem. The default is the bundled problem of its name.
        simulation: Accuracy.

    Raises:
        InputError: If the orbit's problem is not known, or the orbit lacks the event of the section
            or is not closed.
        SimulationError: If the simulation does not return to the orbit.
    """
    from zeno_orbits.orbits import return_map_of

    orbit = any_orbit(orbit)
    used = problem_of(orbit, problem)
    return return_map_of(used, orbit, section=section, simulation=simulation)
