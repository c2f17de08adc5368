r"""Recovery of an orbit from a disturbance: its time, its norm, and a ball that maps into itself.

On the section of the orbit, in coordinates `y` around its state, the return map is
:math:`y^+ = P(y)` with :math:`A = P'(0)`. For :math:`\rho(A) < \gamma < 1`, the solution of

.. math:: \gamma^{-2} A^\top M A - M = -I

gives a norm :math:`|y|_M = \sqrt{y^\top M y}` in which :math:`A` contracts by less than
:math:`\gamma`. Here :math:`\gamma = (1 + \rho)/2`.

The ball :math:`|y|_M \le r` is tested by sampling. If `N` points, drawn uniformly and independently
of `r`, return into it with the phases of the orbit, then with confidence `c` the share of the ball
that leaves it is at most :math:`1 - (1 - c)^{1/N}`. A radius that fails is reduced, and the test is
repeated with new points. For the `k`-th test, :math:`1 - c` is divided by :math:`k (k + 1)`, so
that all tests together have the confidence `c`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector, eigenvalues, spectral_radius
from zeno_orbits.errors import InputError, SimulationError, positive_number, shown
from zeno_orbits.integrators import Tolerance
from zeno_orbits.model import Problem
from zeno_orbits.orbits import Orbit, event_chart
from zeno_orbits.simulation import SimulationSettings
from zeno_orbits.work import Columns, Progress, TableRepr, require_kinds, silent, versions

_ACCURATE = SimulationSettings(tolerance=Tolerance(relative=1e-10, absolute=1e-11))
_FIRST, _LEAST, _MOST = 1e-3, 1e-9, 1e9
"""First, smallest and largest radius of the search, in scaled states."""
_FINEST = 1e-12
"""Smallest relative step of the radius that doubles resolve."""
_SCOUTS = 64
"""Points of the search, which the test does not use."""
_TESTS = 60
"""Largest number of tests."""
_CLOSED = 1e-6
"""Relative distance between start and end of an orbit that is closed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoverySettings:
    """Extent and accuracy of the computation.

    Attributes:
        part: Part to which a disturbance has to decay.
        samples: Number of points of a test.
        confidence: Confidence of the statement.
        error: Relative step of the radius.
        seed: Seed of the points.
    """

    part: float = 0.01
    samples: int = 300
    confidence: float = 0.95
    error: float = 0.02
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse values without a meaning.

        Raises:
            InputError: If a field is invalid. The message names it.
        """
        require_kinds(self)
        for name in ("part", "confidence", "error"):
            value = positive_number(name, getattr(self, name))
            if value >= 1.0:
                raise InputError(f"Argument `{name}` must be below 1, but it is {shown(value)}.")
        if self.error < _FINEST:
            wanted = f"must be at least {_FINEST:g}, but it is {shown(self.error)}"
            raise InputError(f"Argument `error` {wanted}.")
        if self.seed < 0:
            raise InputError(f"Argument `seed` must not be negative, but it is {self.seed}.")
        if self.samples < 1:
            wanted = f"must be at least 1, but it is {shown(self.samples)}"
            raise InputError(f"Argument `samples` {wanted}.")


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Recovery(TableRepr):
    """Recovery of an orbit from a disturbance on its section.

    Attributes:
        problem: Name of the problem.
        gains: Gains of the orbit.
        parameters: Parameters of the orbit.
        period: Period of the orbit [s].
        spectral_radius: Spectral radius of the return map.
        contraction: Factor by which a return reduces the norm of a small disturbance.
        periods: Returns after which the norm of a small disturbance is at most ``settings.part`` of
            its initial value.
        norm: Matrix of the norm in section coordinates, ``(d, d)``. It is empty if the section is a
            single point.
        directions: Derivative of the state with respect to the section coordinates, ``(n_x, d)``.
        radius: Radius of the largest ball that passes the test. Infinite if the search ends without
            a loss, zero if the smallest ball fails.
        extents: State to the largest difference from the orbit inside the ball, to first order.
        units: State to its unit.
        tests: Number of tests until one passes.
        settings: Settings.
        versions: Program name to version, for the programs that computed the recovery.
    """

    problem: str
    gains: Mapping[str, float]
    parameters: Mapping[str, float]
    period: float
    spectral_radius: float
    contraction: float
    periods: int
    norm: Vector
    directions: Vector
    radius: float
    extents: Mapping[str, float]
    units: Mapping[str, str]
    tests: int
    settings: RecoverySettings
    versions: Mapping[str, str]

    def __repr__(self) -> str:
        """Return one line: the time of the recovery and the radius of the ball."""
        return (
            f"<Recovery of {self.problem}: periods={self.periods}, time={self.time:.6g} s, "
            f"contraction={self.contraction:.4g}, radius={self.radius:.4g}>"
        )

    @property
    def time(self) -> float:
        """Time until a small disturbance has decayed to the part [s]."""
        return self.periods * self.period

    @property
    def lost_share(self) -> float:
        """Bound of the share of the ball that leaves it, at the confidence of the settings."""
        if not 0.0 < self.radius < math.inf:
            return math.nan
        doubt = (1.0 - self.settings.confidence) / (self.tests * (self.tests + 1))
        return -math.expm1(math.log(doubt) / self.settings.samples)

    def _columns(self) -> Columns:
        """Return the extents of the ball."""
        return {
            "state": list(self.extents),
            "extent": list(self.extents.values()),
            "unit": [self.units[name] for name in self.extents],
        }

    def as_json(self) -> dict[str, Any]:
        """Return the recovery as plain data. An unbounded radius is null."""
        bounded = math.isfinite(self.radius)
        return {
            "problem": self.problem,
            "gains": dict(self.gains),
            "parameters": dict(self.parameters),
            "period": self.period,
            "spectral_radius": self.spectral_radius,
            "contraction": self.contraction,
            "part": self.settings.part,
            "periods": self.periods,
            "time": self.time,
            "norm": self.norm.tolist(),
            "directions": self.directions.tolist(),
            "radius": self.radius if bounded else None,
            "extents": dict(self.extents) if bounded else None,
            "units": dict(self.units),
            "tests": self.tests,
            "samples": self.settings.samples,
            "confidence": self.settings.confidence,
            "lost_share": None if math.isnan(self.lost_share) else self.lost_share,
            "error": self.settings.error,
            "seed": self.settings.seed,
            "versions": dict(self.versions),
        }


def recovery_of(
    problem: Problem,
    orbit: Orbit,
    *,
    settings: RecoverySettings | None = None,
    on_progress: Progress = silent,
) -> Recovery:
    """Compute the recovery of a stable orbit.

    Args:
        problem: The problem of the orbit.
        orbit: The orbit.
        settings: Settings.
        on_progress: Called with the stage and its finished part.

    Raises:
        InputError: If the orbit is unstable or not closed, also because the motion from its start
            does not have the events of the orbit.
    """
    settings = settings or RecoverySettings()
    graph = problem.graph_dynamics(orbit.values(problem))
    try:
        chart = event_chart(graph, orbit, problem.state_units, _ACCURATE)
    except SimulationError as error:
        reason = f"must be closed, but the motion from its start is another: {error}"
        raise InputError(f"Argument `orbit` {reason}") from error
    if not chart.drift < _CLOSED:
        wanted = f"must be closed, but a period ends {chart.drift:.1g} away from its start"
        raise InputError(f"Argument `orbit` {wanted}.")
    slope, directions = chart.slope, chart.section.lift
    rate = spectral_radius(eigenvalues(slope))
    if not rate < 1.0:
        reason = f"must be stable, but its spectral radius is {rate:.6g}"
        raise InputError(f"Argument `orbit` {reason}.")
    norm = _norm_of(slope, (1.0 + rate) / 2.0)
    root, back = _roots(norm)
    contraction = _factor(root, slope, back)
    if not contraction < 1.0:
        reason = f"must be stable by more than rounding, but its spectral radius is {rate!r}"
        raise InputError(f"Argument `orbit` {reason}.")
    ball = _Ball(returned=chart.returned, root=root, back=back)
    radius, tests = _radius(ball, settings, on_progress)
    widths = np.linalg.norm(directions @ back, axis=1)
    names = problem.state_names
    extents = {name: _extent(radius, width) for name, width in zip(names, widths, strict=True)}
    return Recovery(
        problem=problem.name,
        gains=dict(orbit.gains),
        parameters=dict(orbit.parameters),
        period=orbit.period,
        spectral_radius=rate,
        contraction=contraction,
        periods=_periods(root, slope, back, settings.part),
        norm=norm,
        directions=directions,
        radius=radius,
        extents=extents,
        units=dict(zip(names, problem.state_units, strict=True)),
        tests=tests,
        settings=settings,
        versions=versions(),
    )


def _norm_of(slope: Vector, rate: float) -> Vector:
    """Return the matrix of a norm in which a derivative contracts by less than a rate."""
    if not len(slope):
        return np.zeros((0, 0))
    # The import takes a fifth of a second.
    from scipy.linalg import solve_discrete_lyapunov

    found = solve_discrete_lyapunov(slope.T / rate, np.eye(len(slope)))
    return np.asarray((found + found.T) / 2.0, dtype=np.float64)


def _roots(norm: Vector) -> tuple[Vector, Vector]:
    """Return the matrix to coordinates in which the ball is round, and its inverse."""
    if not len(norm):
        return norm, norm
    root = np.asarray(np.linalg.cholesky(norm).T, dtype=np.float64)
    return root, np.asarray(np.linalg.inv(root), dtype=np.float64)


def _factor(root: Vector, slope: Vector, back: Vector) -> float:
    """Return the norm of a derivative."""
    return float(np.linalg.norm(root @ slope @ back, 2)) if len(slope) else 0.0


def _periods(root: Vector, slope: Vector, back: Vector, part: float) -> int:
    """Return the number of returns that reduce the norm of every disturbance to a part.

    The norm of a power falls with its exponent, so the exponent is found bit by bit.
    """
    powers = [slope]
    while _factor(root, powers[-1], back) > part:
        powers.append(powers[-1] @ powers[-1])
    count, product = 0, np.eye(len(slope))
    for bit in reversed(range(len(powers) - 1)):
        longer = product @ powers[bit]
        if _factor(root, longer, back) > part:
            count, product = count + 2**bit, longer
    return count + 1


def _extent(radius: float, width: float) -> float:
    return radius * float(width) if width > 0.0 else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Ball:
    """Balls around an orbit on its section.

    Attributes:
        returned: Coordinates of a state to those of its return, or an error.
        root: Matrix from section coordinates to coordinates in which the ball is round, ``(d, d)``.
        back: Its inverse.
    """

    returned: Callable[[Vector], Vector]
    root: Vector
    back: Vector

    def points(self, count: int, drawn: np.random.Generator) -> Vector:
        """Return points of the unit ball, drawn uniformly, ``(count, d)``."""
        d = len(self.root)
        points = drawn.standard_normal((count, d))
        points /= np.linalg.norm(points, axis=1)[:, None]
        return points * drawn.uniform(size=(count, 1)) ** (1.0 / d)

    def keeps(self, point: Vector, radius: float) -> bool:
        """Return True if the motion from a point of the ball returns into the ball."""
        try:
            returned = self.returned(self.back @ (radius * point))
        except (InputError, SimulationError):
            return False
        return float(np.linalg.norm(self.root @ returned)) <= radius


def _radius(ball: _Ball, settings: RecoverySettings, on_progress: Progress) -> tuple[float, int]:
    """Return the largest radius that passes the test, and the number of tests."""
    if not len(ball.root):
        return math.inf, 1
    drawn = np.random.default_rng(settings.seed)
    scouts = ball.points(_SCOUTS, drawn)
    # Points of the surface decide first.
    scouts[: _SCOUTS // 2] /= np.linalg.norm(scouts[: _SCOUTS // 2], axis=1)[:, None]

    def all_return(radius: float) -> bool:
        on_progress("searching for the ball", None)
        return all(ball.keeps(point, radius) for point in scouts)

    radius = _largest(all_return, settings.error)
    if radius == math.inf:
        return radius, 1
    for tests in range(1, _TESTS + 1):
        points = ball.points(settings.samples, drawn)
        kept = 0
        while kept < len(points) and ball.keeps(points[kept], radius):
            kept += 1
            on_progress(f"test {tests} of the ball", kept / len(points))
        if kept == len(points):
            return radius, tests
        radius *= 1.0 - settings.error
    return 0.0, _TESTS


def _largest(passes: Callable[[float], bool], error: float) -> float:
    """Return the largest radius that passes, to a relative error; infinite if all pass."""
    low = _FIRST
    while not passes(low):
        low /= 10.0
        if low < _LEAST:
            return 0.0
    high = 2.0 * low
    while passes(high):
        low, high = high, 2.0 * high
        if high > _MOST:
            return math.inf
    while high - low > error * low:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if passes(middle) else (low, middle)
    return low
