"""Proof of a branch: an orbit for every value of one gain or parameter in an interval.

The branch is traced to both ends of the interval, which divides it into parts. Workers cover the
parts by ranges (`branch_ranges`). Neighbouring ranges share a value of the parameter, at which the
fixed point of one range lies in the box of the other, so it is the fixed point of both. The ranges
that are connected with the orbit of the file make up the proved branch.
"""

from __future__ import annotations

import itertools
import math
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from typing import Any

from flint import ctx

from zeno_orbits.errors import InputError, ProofError
from zeno_orbits.model import Problem, ProblemFile
from zeno_orbits.orbits import Orbit
from zeno_orbits.proof.branch_ranges import (
    BranchSettings,
    BranchTask,
    ProofRange,
    RangePoint,
    plain_range,
    read_proof_range,
)
from zeno_orbits.proof.branch_theorem import BranchEnd, BranchEstimate, BranchProof, ProvedRange
from zeno_orbits.proof.integration.orbit_walk import ProofStart, proof_start, require_fit
from zeno_orbits.proof.proof_file import proof_versions, require_hypotheses
from zeno_orbits.proof.prover import ProofSettings, prove_orbit
from zeno_orbits.work import (
    ExecutionPlan,
    FailedPoint,
    Progress,
    parallel_map,
    portion,
    report_part,
    silent,
)

KIND = "zeno_orbits branch proof"
_GROWTHS = (1.5, 1.1)
"""Factors from a range to the next range: before the first failure, and after it."""
_SHORTER = (0.25, 0.7)
"""Factors after a failure: before the first proved range, and after it."""
_FIRST = 2.0**-4
"""First trial length of a range, relative to the interval."""
_TRIALS = 4
"""Number of ranges from which the length of ranges and the time are estimated."""
_LEAST_RANGES = 8
"""Smallest expected number of ranges in a part."""
_TRACED = 0.25
"""Part of the progress that belongs to the trace."""
_CLOSE = 1e-6
"""Largest distance of the traced start from the orbit of the file, relative to its size."""


def prove_branch(
    orbit: Orbit,
    problem: Problem,
    name: str,
    box: tuple[float, float],
    *,
    settings: BranchSettings | None = None,
    plan: ExecutionPlan | None = None,
    on_progress: Progress = silent,
    on_estimate: Callable[[BranchEstimate], object] | None = None,
) -> BranchProof:
    """Prove that an orbit exists for every value of one gain or parameter in an interval.

    Args:
        orbit: An orbit in the interval.
        problem: Its problem.
        name: The gain or parameter.
        box: Ends of the interval.
        settings: Settings of the proof.
        plan: Executor of the work and folder of finished parts. None works in this process.
        on_progress: Called with the stage and the part of it that is done.
        on_estimate: Called with a `BranchEstimate` before most of the work is done.

    Returns:
        The theorem with its certificate, for the part of the interval that was proved, or the claim
        that could not be proved at the orbit itself.

    Raises:
        InputError: If the interval does not contain the value of the orbit, or a name is unknown.
        TranslationError: If the problem is not analytic.
    """
    started = clock.perf_counter()
    settings = settings or BranchSettings()
    problem.require_range(name, box, argument="branch")
    own = {**orbit.gains, **orbit.parameters}[name]
    if not box[0] <= own <= box[1]:
        wanted = f"must contain the orbit's own `{name}`, {own!r}"
        given = f"but it is {box[0]!r}:{box[1]!r}"
        remedy = f"Widen the interval, or search an orbit in it, as with --set {name}={box[0]!r}"
        raise InputError(f"Argument `branch` {wanted}, {given}. {remedy}.")
    here = prove_orbit(
        orbit,
        problem,
        settings=ProofSettings(bits=settings.bits),
        # Its part of the time of all ranges is not known yet.
        on_progress=lambda stage, _=None: on_progress(f"the orbit itself: {stage}", None),
    )
    if not here.proved:
        return _failed(problem, name, box, here.claim, here.reason)
    try:
        with ctx.workprec(settings.bits):
            task = _task(orbit, problem, name, box, settings)
            work = _Branch(task=task, own=own, box=box, plan=plan, on_progress=on_progress)
            ranges, ends = work.proved(on_estimate)
            written = _certificate(name, ranges)
            if "machine" in written:
                parts: dict[str, Any] = {
                    "passes": [one["pass"] for one in written["ranges"]],
                    "over": {},
                }
                require_hypotheses({**written, **parts}, problem)
    except ProofError as error:
        return _failed(problem, name, box, error.claim, error.reason)
    return BranchProof(
        problem=problem.name,
        name=name,
        asked=box,
        here=here,
        ranges=tuple(_told(one) for one in ranges),
        ends=ends,
        held=tuple(problem.derived_from([name], orbit.values(problem).parameters)),
        certificate=written,
        wall_time=clock.perf_counter() - started,
        versions=proof_versions(),
    )


def _failed(
    problem: Problem, name: str, box: tuple[float, float], claim: str, reason: str
) -> BranchProof:
    """Return the result of a proof that fails at the orbit itself."""
    return BranchProof(
        problem=problem.name,
        name=name,
        asked=box,
        claim=claim,
        reason=reason,
        certificate={},
        versions=proof_versions(),
    )


def _task(
    orbit: Orbit,
    problem: Problem,
    name: str,
    box: tuple[float, float],
    settings: BranchSettings,
) -> BranchTask:
    """Return the branch of an orbit that fits its problem."""
    require_fit(orbit, problem, orbit.values(problem))
    return BranchTask(
        problem=problem,
        given=proof_start(orbit),
        name=name,
        settings=settings,
        smallest=settings.least * (box[1] - box[0]),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Branch:
    """A branch that is proved."""

    task: BranchTask
    own: float
    box: tuple[float, float]
    plan: ExecutionPlan | None
    on_progress: Progress

    def proved(
        self, on_estimate: Callable[[BranchEstimate], object] | None
    ) -> tuple[list[ProofRange], tuple[BranchEnd, BranchEnd]]:
        """Return the connected ranges around the orbit, and why they end."""
        self.on_progress("proving a first range", None)
        start = self._start()
        length, seconds = self._first_ranges(start)
        count = (self.box[1] - self.box[0]) / length
        if on_estimate is not None:
            on_estimate(BranchEstimate(ranges=max(1, round(count)), seconds=seconds * count))
        traces, reasons = list[list[RangePoint]](), list[str]()
        tell = portion(self.on_progress, 0.0, _TRACED)
        longest = (self.box[1] - self.box[0]) / min(
            self.task.settings.parts, max(1, count / _LEAST_RANGES)
        )
        for k, end in enumerate(self.box):
            points, reason = self._traced(start, end, longest, portion(tell, k / 2, (k + 1) / 2))
            traces.append(points)
            reasons.append(reason)
        pairs = [pair for points in traces for pair in itertools.pairwise(points)]
        if not pairs:
            raise ProofError("exists", f"the branch is not traced: {reasons[0] or reasons[1]}")
        parts = [{"from": asdict(a), "to": b.value, "length": length} for a, b in pairs]
        found, n_low = self._covered(parts), len(traces[0]) - 1
        down, low_end = _chained(found[:n_low], start, self.box[0], reasons[0])
        up, high_end = _chained(found[n_low:], start, self.box[1], reasons[1])
        return _connected([*reversed(down), *up], len(down), (low_end, high_end))

    def _start(self) -> RangePoint:
        """Return the branch at the orbit of the file."""
        orbit, problem = self.task.given.orbit, self.task.problem
        state = tuple(orbit.start_state[name] for name in problem.state_names)
        known = RangePoint(
            value=self.own, state=state, slope=(0.0,) * len(state), period=orbit.period
        )
        found = self.task.point(self.own, known)
        sizes = problem.system(orbit.values(problem)).own.states(len(state))
        for a, b, size in zip(found.state, state, sizes, strict=True):
            if abs(a - b) > _CLOSE * max(size, abs(b)):
                raise ProofError("closure", "the motion from the orbit's start does not return")
        return found

    def _traced(
        self, start: RangePoint, end: float, longest: float, tell: Progress
    ) -> tuple[list[RangePoint], str]:
        """Return points of the branch up to an end of the interval, or to the last point."""
        step = math.copysign(longest, end - start.value)
        points, reason, name = [start], "", self.task.name
        while points[-1].value != end:
            last = points[-1]
            near = abs(end - last.value) <= 1.25 * abs(step)
            value = end if near else last.value + step
            tell(f"trace {name} to {value:.6g}", (last.value - start.value) / (end - start.value))
            try:
                points.append(self.task.point(value, last))
                reason = ""
                step = math.copysign(min(longest, 2 * abs(step)), step)
            except ProofError as error:
                step, reason = step / 2, _because(error)
                if abs(step) < self.task.smallest:
                    break
        return points, reason

    def _first_ranges(self, start: RangePoint) -> tuple[float, float]:
        """Return the length of ranges near the orbit, and the time of one [s]."""
        end = self.box[1] if self.own < self.box[1] else self.box[0]
        began, length, count = clock.process_time(), 0.0, 0
        first = _FIRST * (self.box[1] - self.box[0])
        for one in _ranges(self.task, start, end, first):
            if isinstance(one, str):
                raise ProofError("exists", f"no range is proved at the orbit: {one}")
            length, count = max(length, float(one.high - one.low)), count + 1
            if count == _TRIALS:
                break
        return length, (clock.process_time() - began) / count

    def _covered(self, parts: Sequence[Mapping[str, Any]]) -> list[tuple[list[ProofRange], str]]:
        """Return the ranges of each part, and why they end before the part."""
        tell, task = portion(self.on_progress, _TRACED, 1.0), self.task
        file = task.problem.file
        job = _Part(
            problem=task.problem if self.plan is None or file is None else None,
            file=file,
            given=task.given,
            name=task.name,
            settings=task.settings,
            smallest=task.smallest,
        )
        if job.problem is not None:
            found = list[Any]()
            for k, part in enumerate(parts):
                tell(f"{k} of {len(parts)} parts", k / len(parts))
                found += job([part])
        else:
            identity = {"work": "branch", "problem": task.problem.name, "name": task.name}
            identity |= {"box": list(self.box), "digest": file.digest if file else ""}
            numbers = task.given.orbit.values(task.problem).vector
            identity |= {"values": [float(x).hex() for x in numbers]}
            identity |= {"settings": asdict(task.settings)}
            plan = replace(self.plan or ExecutionPlan(), chunk=1, noun="parts", identity=identity)
            found = list(parallel_map(job, parts, plan, on_progress=tell))
        return [
            ([], "each worker of the part was terminated")
            if isinstance(one, FailedPoint)
            else ([read_proof_range(range_) for range_ in one[0]], one[1])
            for one in found
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Part:
    """Proof of parts of a branch. A worker loads the problem itself."""

    problem: Problem | None
    file: ProblemFile | None
    given: ProofStart
    name: str
    settings: BranchSettings
    smallest: float

    def __call__(self, parts: Sequence[Mapping[str, Any]]) -> list[Any]:
        """Return the ranges of each part as plain data, and why they end early."""
        problem = self.file.load() if self.problem is None and self.file else self.problem
        if problem is None:
            raise InputError("Argument `problem` must have a file, but it is missing.")
        task = BranchTask(
            problem=problem,
            given=self.given,
            name=self.name,
            settings=self.settings,
            smallest=self.smallest,
        )
        found = list[Any]()
        for part in parts:
            start, end, ranges, reason = RangePoint(**part["from"]), part["to"], list[Any](), ""
            with ctx.workprec(task.settings.bits):
                for one in _ranges(task, start, end, part["length"]):
                    if isinstance(one, str):
                        reason = one
                        continue
                    ranges.append(plain_range(one))
                    done = (one.middle.value - start.value) / (end - start.value)
                    report_part(min(max(done, 0.0), 1.0))
            found.append([ranges, reason])
        return found


def _ranges(
    task: BranchTask, start: RangePoint, end: float, length: float
) -> Iterator[ProofRange | str]:
    """Yield ranges from a point of a branch to a value, then the reason if they end early."""
    sign, edge, known = math.copysign(1.0, end - start.value), start.value, start
    growth = _GROWTHS[0]
    while edge != end:
        left = abs(end - edge)
        # Two equal ranges are better than a long one and a rest.
        length = left if left <= length else min(length, max(left / 2, task.smallest))
        to = end if length == left else edge + sign * length
        try:
            one = task.proved(min(edge, to), max(edge, to), known)
        except ProofError as error:
            length, growth = _SHORTER[known is not start] * length, _GROWTHS[1]
            if length < task.smallest:
                yield _because(error)
                return
            continue
        yield one
        edge, known, length = to, one.middle, growth * length


def _because(error: ProofError) -> str:
    return f"`{error.claim}`: {error.reason}"


def _chained(
    parts: Sequence[tuple[list[ProofRange], str]], start: RangePoint, end: float, reason: str
) -> tuple[list[ProofRange], BranchEnd]:
    """Return the ranges from an orbit outwards up to the first failure, and where they end."""
    ranges = list[ProofRange]()
    for found, stopped in parts:
        ranges += found
        if stopped:
            reason = stopped
            break
    upward = end >= start.value
    reached = [one.high if upward else one.low for one in ranges]
    last = Fraction(start.value) if not reached else (max if upward else min)(reached)
    return ranges, BranchEnd(value=last, reason=reason)


def _connected(
    ranges: list[ProofRange], junction: int, ends: tuple[BranchEnd, BranchEnd]
) -> tuple[list[ProofRange], tuple[BranchEnd, BranchEnd]]:
    """Return the ranges that are connected with the orbit, which lies between two of them.

    Args:
        ranges: The ranges, in order.
        junction: Index of the first range above the orbit.
        ends: The ends of the ranges.
    """
    if not ranges:
        raise ProofError("exists", f"no range is proved: {ends[0].reason or ends[1].reason}")
    at = min(junction, len(ranges) - 1)
    first = last = at
    low_end, high_end = ends
    while last + 1 < len(ranges):
        reason = ranges[last].meets(ranges[last + 1])
        if reason:
            high_end = BranchEnd(value=ranges[last].high, reason=reason)
            break
        last += 1
    while first > 0:
        reason = ranges[first - 1].meets(ranges[first])
        if reason:
            low_end = BranchEnd(value=ranges[first].low, reason=reason)
            break
        first -= 1
    return ranges[first : last + 1], (low_end, high_end)


def _certificate(name: str, ranges: Sequence[ProofRange]) -> dict[str, Any]:
    """Return the certificate of a branch. All ranges share its first entries."""
    common = dict(ranges[0].common)
    bits = max(one.common["bits"] for one in ranges)
    return common | {
        "kind": KIND,
        "bits": bits,
        "branch": name,
        "ranges": [one.data for one in ranges],
    }


def _told(one: ProofRange) -> ProvedRange:
    return ProvedRange(
        low=one.low,
        high=one.high,
        stability=one.stability,
        n_records=len(one.data["pass"]["records"]),
    )
