r"""Parameters of a machine from a recording of it, through the closed orbit and its derivatives.

A machine that has settled shows the periodic orbit of its parameters, whatever it started from. So
the prediction is the orbit itself, :math:`Y(\varphi; p)`, and its period: no initial state has to
be fitted, a recording of hours is folded into one cycle before the first iteration, and
derivatives come from the implicit function theorem on the return map (theory (58)). Fitting the
recorded time instead would need the state at its beginning, and would carry every impact of it.

The residuals are the samples in units of their noise, and the period in units of its own error.
What remains after the fit is correlated, by noise of the machine and by what the model does not
know, and intervals take that into account (theory (59)).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from zeno_orbits.closing import close_cycle, close_orbit, orbit_of
from zeno_orbits.comparison import Comparison, compare
from zeno_orbits.compiled import bind
from zeno_orbits.cycle import Cycle
from zeno_orbits.cycle_tables import Measurement, OrbitTable, measurement, tabulated
from zeno_orbits.cycle_variations import OrbitSlope, orbit_slope
from zeno_orbits.dynamics import Vector
from zeno_orbits.errors import InputError, SimulationError, ZenoOrbitsError
from zeno_orbits.folding import Fold, Folded, folded
from zeno_orbits.intervals import Spread, Unseen, spread_of, unseen_combinations
from zeno_orbits.models import compiled_model
from zeno_orbits.orbit import ZenoOrbit
from zeno_orbits.problem import Problem, Setting
from zeno_orbits.recordings import Recording
from zeno_orbits.simulate import SimulationSettings

_LEAST_CYCLES = 2.0
_ROUNDS = 3
"""Times that the fit is made: each time the weights are those of the residuals before it."""
_FAR = 1e3
"""Residuals of parameters that have no orbit: a trust region turns back from them."""
_MISFIT = 2.0
"""What repeats of the residuals, over what noise makes repeat, where the model falls short."""
_EDGE = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class Sought:
    """A number to be found.

    Attributes:
        names: The parameters that it is the value of; more than one if they are tied together.
        lower: Smallest value.
        upper: Largest value.
    """

    names: tuple[str, ...]
    lower: float
    upper: float

    @property
    def label(self) -> str:
        """Its name: those of its parameters."""
        return "+".join(self.names)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fitted:
    """A number that was found.

    Attributes:
        sought: What it is.
        start: Where the fit began.
        value: The number.
        error: Its standard error; infinite if the recording does not tell it.
        low: Lower end of its 95 % interval.
        high: Upper end.
    """

    sought: Sought
    start: float
    value: float
    error: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Identification:
    """Parameters from a recording.

    Attributes:
        problem: Name of the scene.
        setting: All numbers, the fitted ones among them.
        fitted: The fitted ones.
        correlation: Between them, ``(k, k)``.
        unseen: Combinations of them that the recording does not tell.
        orbit: The orbit at these numbers.
        before: Root mean square of the residuals at the start, in units of the noise.
        after: The same after the fit.
        misfit: What repeats of the residuals, over what noise alone makes repeat; about 1 for a
            model that is right.
        remarks: What else is to be said.
    """

    problem: str
    setting: Setting
    fitted: tuple[Fitted, ...]
    correlation: Vector
    unseen: tuple[Unseen, ...]
    orbit: ZenoOrbit
    before: float
    after: float
    misfit: float
    remarks: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {
            "format": 1,
            "problem": self.problem,
            "gains": dict(self.setting.gains),
            "parameters": dict(self.setting.parameters),
            "fitted": {
                one.sought.label: {
                    "value": one.value,
                    "standard_error": one.error if math.isfinite(one.error) else None,
                    "interval": [one.low, one.high] if math.isfinite(one.error) else None,
                    "start": one.start,
                }
                for one in self.fitted
            },
            "correlation": self.correlation.tolist(),
            "unseen": [{"direction": dict(one.direction), "text": one.text} for one in self.unseen],
            "period": self.orbit.period,
            "residual_before": self.before,
            "residual_after": self.after,
            "misfit": self.misfit,
            "remarks": list(self.remarks),
        }


class UnfittableError(ZenoOrbitsError):
    """A recording gives no parameters: it shows no such orbit, or none comes near it."""


def identify(
    problem: Problem,
    setting: Setting,
    recording: Recording,
    sought: Sequence[Sought],
    *,
    on_progress: Callable[[str, float | None], None] | None = None,
) -> Identification:
    """Return the parameters at which a scene's orbit is nearest to a recording.

    Args:
        problem: The scene.
        setting: Its numbers: gains and what is not fitted as known, the others roughly.
        recording: Of a machine that has settled, over two periods at least.
        sought: What to fit.
        on_progress: Called with a few words, and how much is done if that is known.

    Raises:
        InputError: If a name or a range cannot be.
        UnfittableError: If there is no orbit at the start, or the recording shows none like it.
    """

    def tell(what: str, part: float | None = None) -> None:
        if on_progress is not None:
            on_progress(what, part)

    begin = _begin(problem, setting, sought)
    tell("looking for the orbit at the start")
    closing = close_orbit(problem, begin)
    if closing.orbit is None:
        reason = f"at the start there is no orbit to fit: {closing.detail.rstrip('.')}"
        raise UnfittableError(f"No parameters were found: {reason}.")
    tell("laying the recording over it")
    first = compare(closing.orbit, problem, recording)
    where, found = first.where, first.period
    if not first.agrees or where is None or found is None:
        raise UnfittableError(f"No parameters were found: {'; '.join(first.reasons)}.")
    if found.n_cycles < _LEAST_CYCLES:
        few = f"{found.n_cycles:.2g} periods were recorded, and two are needed"
        raise UnfittableError(f"No parameters were found: {few}.")
    fit = _Fit(problem, begin, tuple(sought), first)
    return fit.result(tell)


def _begin(problem: Problem, setting: Setting, sought: Sequence[Sought]) -> Setting:
    """Return the numbers to start from: every sought one inside its range, tied ones equal."""
    if not sought:
        raise InputError("Argument `fit` must name a parameter, but it names none.")
    taken: list[str] = []
    parameters = dict(setting.parameters)
    for one in sought:
        for name in one.names:
            if name not in parameters:
                known = ", ".join(parameters)
                hint = "; gains are known" if name in setting.gains else ""
                message = f"must name parameters ({known}), but it names `{name}`{hint}"
                raise InputError(f"Argument `fit` {message}.")
            if name in taken:
                raise InputError(f"Argument `fit` must name `{name}` once, but it does so twice.")
            taken.append(name)
        if not one.lower < one.upper:
            bounds = f"[{one.lower:g}, {one.upper:g}]"
            wanted = f"must have a range LOW:HIGH for `{one.label}`"
            raise InputError(f"Argument `fit` {wanted}, but it is {bounds}.")
        value = parameters[one.names[0]]
        if not one.lower < value < one.upper:
            value = (one.lower + one.upper) / 2
        parameters |= dict.fromkeys(one.names, value)
    return problem.setting(gains=setting.gains, parameters=parameters)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Point:
    """The orbit at some numbers.

    Attributes:
        cycle: A period of it.
        table: Its signals.
    """

    cycle: Cycle
    table: OrbitTable


class _Fit:
    """A fit in the making: the last orbits are remembered, for the next is near."""

    def __init__(
        self,
        problem: Problem,
        begin: Setting,
        sought: tuple[Sought, ...],
        first: Comparison,
    ) -> None:
        self.problem, self.begin, self.sought, self.first = problem, begin, sought, first
        self.measured: Measurement = measurement(problem, first.signals)
        names = problem.names
        self.places = tuple(names.index(name) for one in sought for name in one.names)
        # A tied number moves all of its parameters.
        self.ties = np.zeros((len(self.places), len(sought)))
        row = 0
        for k, one in enumerate(sought):
            self.ties[row : row + len(one.names), k] = 1.0
            row += len(one.names)
        if first.where is None or first.period is None:
            raise UnfittableError("No parameters were found: the recording shows no orbit.")
        self.where, self.found = first.where, first.period
        recording = first.recording
        values = np.stack([recording.signal(name).values for name in first.signals])
        self.data: Folded = folded(recording.time, values, self.where)
        self.settings = SimulationSettings()
        self.start = np.array([begin.parameters[one.names[0]] for one in sought])
        self.scale = np.where(self.start != 0.0, np.abs(self.start), 1.0)
        self.near: Cycle | None = None
        self.known: dict[bytes, _Point] = {}
        self.noise = np.ones(len(first.signals))
        self.weights = np.ones_like(self.data.values)

    def p_at(self, numbers: Vector) -> Vector:
        """Return gains and parameters with the sought numbers in their places."""
        p = np.array(self.begin.values(), dtype=np.float64)
        p[list(self.places)] = self.ties @ numbers
        return p

    def point(self, numbers: Vector) -> _Point:
        """Return the orbit at some numbers.

        Raises:
            SimulationError: If none is found near the last one.
        """
        key = numbers.tobytes()
        if key not in self.known:
            p = self.p_at(numbers)
            dynamics = bind(compiled_model(self.problem), tuple(p.tolist()))
            if self.near is None and self.first.deviations is not None:
                self.near = self.first.deviations.table.cycle
            if self.near is None:
                raise SimulationError("There is no orbit to start from", time=0.0, state=())
            closed = close_cycle(
                dynamics,
                self.near.start.state,
                scale=self.near.scale_at_events(),
                period=self.near.period,
                settings=self.settings,
            )
            table = tabulated(dynamics, closed.cycle, self.measured, p)
            self.known[key] = _Point(cycle=closed.cycle, table=table)
        return self.known[key]

    def slope(self, numbers: Vector) -> OrbitSlope:
        """Return the derivatives of the orbit by its parameters."""
        cycle = self.point(numbers).cycle
        dynamics = bind(compiled_model(self.problem), tuple(self.p_at(numbers).tolist()))
        return orbit_slope(
            dynamics,
            cycle.start.state,
            scale=cycle.scale_at_events(),
            period=cycle.period,
            chosen=self.places,
            settings=self.settings,
        )

    def residuals(self, x: Vector) -> Vector:
        """Return the residuals at scaled numbers and a shift in phase."""
        try:
            fold = self.fold(x)
        except (SimulationError, InputError):
            return np.full(self.data.values.size + 1, _FAR)
        # What is accepted is where the next orbits are looked for.
        rest = np.where(self.data.seen, (self.data.values - fold.values) * self.weights, 0.0)
        return np.append(rest.ravel(), self.late(x))

    def late(self, x: Vector) -> float:
        """Return the residual of the period."""
        period = self.point(x[:-1] * self.scale).table.period
        return (self.found.period - period) / self.found.error

    def fold(self, x: Vector) -> Fold:
        """Return the orbit at the phases of the samples."""
        table = self.point(x[:-1] * self.scale).table
        times = np.mod(self.data.phases - x[-1], 1.0) * table.period
        values, slopes = table.nodes.with_slopes(times)
        return Fold(times=times, values=values, slopes=slopes)

    def jacobian(self, x: Vector) -> Vector:
        """Return the exact derivative of the residuals by what is sought, then by the shift."""
        numbers = x[:-1] * self.scale
        point = self.point(numbers)
        self.near = point.cycle
        slope, fold = self.slope(numbers), self.fold(x)
        states = slope.at(fold.times)
        p = self.p_at(numbers)
        by = self.measured.derivatives(point.table.states.at(fold.times), p)
        n_x = states.shape[1]
        direct = by[:, :, n_x:][:, :, list(self.places)]
        moved = np.einsum("nsx,nxk->nsk", by[:, :, :n_x], states) + direct
        # At a fixed phase a longer period means a later time.
        share = fold.times / point.table.period
        moved += fold.slopes[:, :, None] * share[:, None, None] * slope.period
        columns = moved @ self.ties * self.scale
        late = -fold.slopes[:, :, None] * point.table.period
        whole = -np.concatenate([columns, late], axis=2) * self.weights[:, :, None]
        whole = np.where(self.data.seen[:, :, None], whole, 0.0)
        last = np.append(-(slope.period @ self.ties) * self.scale / self.found.error, 0.0)
        return np.concatenate([whole.reshape(-1, len(x)), last[None, :]])

    def weigh(self, x: Vector) -> None:
        """Set the weights from the residuals at some numbers."""
        fold = self.fold(x)
        for k in range(len(self.noise)):
            seen = self.data.seen[:, k]
            rest = (self.data.values[:, k] - fold.values[:, k])[seen]
            count = self.data.counts[seen, k]
            size = float(np.sqrt(np.sum(count * rest**2) / max(float(count.sum()), 1.0)))
            extent = float(np.ptp(fold.values[:, k]))
            self.noise[k] = max(size, 1e-9 * extent, np.finfo(float).tiny)
            self.weights[:, k] = np.sqrt(self.data.counts[:, k]) / self.noise[k]

    def result(self, tell: Callable[[str, float | None], None]) -> Identification:
        """Return the fit."""
        from scipy.optimize import least_squares

        x = np.append(self.start / self.scale, 0.0)
        low = np.array([one.lower for one in self.sought]) / self.scale
        high = np.array([one.upper for one in self.sought]) / self.scale
        bounds = (np.append(low, -0.5), np.append(high, 0.5))
        self.mask(x)
        self.weigh(x)
        sizes: list[float] = []
        for number in range(_ROUNDS):
            tell("fitting", number / _ROUNDS)
            self.weigh(x)
            found = least_squares(
                self.residuals,
                x,
                jac=self.jacobian,
                bounds=bounds,
                method="trf",
                x_scale="jac",
                xtol=1e-10,
                ftol=1e-10,
                gtol=1e-12,
                max_nfev=40,
            )
            if not sizes:
                sizes.append(self.size(x))
            x = np.asarray(found.x, dtype=np.float64)
            self.known = {key: self.known[key] for key in list(self.known)[-4:]}
        tell("how sure it is", 0.95)
        sizes.append(self.size(x))
        return self.described(x, sizes, (low, high))

    def mask(self, x: Vector) -> None:
        """Leave out samples of signals that jump, where an impact makes them jump."""
        table = self.point(x[:-1] * self.scale).table
        self.data = self.data.without_jumps(table)

    def size(self, x: Vector) -> float:
        """Return the root mean square deviation of all signals, in parts of their ranges."""
        fold = self.fold(x)
        extent = np.ptp(fold.values, axis=0)
        rest = (self.data.values - fold.values) / np.where(extent > 0.0, extent, 1.0)
        counts = np.where(self.data.seen, self.data.counts, 0.0)
        square = float(np.sum(counts * np.where(self.data.seen, rest, 0.0) ** 2))
        return math.sqrt(square / max(float(counts.sum()), 1.0))

    def described(
        self, x: Vector, sizes: list[float], bounds: tuple[Vector, Vector]
    ) -> Identification:
        """Return what was found, and how sure it is."""
        jacobian, residuals = self.jacobian(x), self.residuals(x)
        spread: Spread = spread_of(jacobian, residuals, self.data)
        unseen = unseen_combinations(
            [one.label for one in self.sought], spread.information, spread.inflation
        )
        hidden = {name for one in unseen for name, part in one.direction.items() if abs(part) > 0.1}
        fitted: list[Fitted] = []
        remarks = list(self.first.remarks)
        for k, one in enumerate(self.sought):
            value, half = float(x[k] * self.scale[k]), float(spread.half[k] * self.scale[k])
            error = float(spread.errors[k] * self.scale[k])
            known = one.label not in hidden
            fitted.append(
                Fitted(
                    sought=one,
                    start=float(self.start[k]),
                    value=value,
                    error=error if known else math.inf,
                    low=value - half if known else -math.inf,
                    high=value + half if known else math.inf,
                )
            )
            width = bounds[1][k] - bounds[0][k]
            if min(x[k] - bounds[0][k], bounds[1][k] - x[k]) < _EDGE * width:
                remarks.append(f"`{one.label}` ended at an end of its range")
        if spread.misfit > _MISFIT:
            remarks.append(
                f"the model does not follow the recording: what repeats of the deviations is "
                f"{math.sqrt(spread.misfit):.2g} times noise, and the numbers may be biased "
                f"by more than their intervals say"
            )
        point = self.point(x[:-1] * self.scale)
        parameters = dict(self.begin.parameters)
        for one, number in zip(self.sought, fitted, strict=True):
            parameters |= dict.fromkeys(one.names, number.value)
        setting = self.problem.setting(gains=self.begin.gains, parameters=parameters)
        return Identification(
            problem=self.problem.name,
            setting=setting,
            fitted=tuple(fitted),
            correlation=spread.correlation,
            unseen=unseen,
            orbit=orbit_of(point.cycle, self.problem, setting),
            before=sizes[0],
            after=sizes[-1],
            misfit=spread.misfit,
            remarks=tuple(remarks),
        )
