r"""Feedback once per period: inputs that are held from return to return and keep an orbit.

At each return the inputs become :math:`u_k = u^* - K (y_k - y^*)` and hold until the next one. With
the derivatives `A` and `B` of the return map,

.. math:: y_{k+1} - y^* = (A - B K)(y_k - y^*) + O(|y_k - y^*|^2).

A controller that computes while the machine moves applies the inputs one return later. Then the
state of the loop is :math:`(y_k, u_k)`, with the derivatives

.. math:: \begin{pmatrix} A & B \\ 0 & 0 \end{pmatrix}, \qquad \begin{pmatrix} 0 \\ I \end{pmatrix}.

A multiplier :math:`\mu` is controllable if :math:`(A - \mu I \;\; B)` has full rank (Hautus).
States are measured in their largest values, inputs in their own. `corners` has the loop where the
parameters are not those of the model.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector, eigenvalues, finite_vector, spectral_radius
from zeno_orbits.errors import (
    InputError,
    SimulationError,
    SwitchingTimesError,
    did_you_mean,
    finite_number,
    named_numbers,
    not_known,
    number_range,
    shown,
)
from zeno_orbits.maps.corners import (
    LoopCorner,
    UncertainLoop,
    input_sizes,
    loop_derivatives,
    require_orbit_inside,
    require_value_inside,
)
from zeno_orbits.model import (
    HeldLaw,
    Problem,
    check_uncertain,
    held_file,
    load_problem,
    with_held_inputs,
)
from zeno_orbits.orbits import ReturnMap
from zeno_orbits.work import (
    ByValue,
    Columns,
    Progress,
    TableRepr,
    checked,
    silent,
    versions,
    write_whole,
)

Inputs = Sequence[str] | Mapping[str, tuple[float, float] | None]
"""Gains and parameters that are held, with or without their ranges."""
METHODS = ("lqr", "place", "deadbeat", "robust")
_RANK = 1e-9
"""Relative singular value below which a multiplier does not depend on the inputs."""
_NONE = 1e-9
"""Modulus of a multiplier that is zero: its disturbances are gone after a period."""
_MISSED = 1e-2
"""Distance of a multiplier of the loop from the wished one. Rounding spreads one that repeats."""
_LOST = (SimulationError, SwitchingTimesError)
"""Ends of a motion: it does not return, or an input sets a switching time after the next one."""
_WEIGHT = 1e-3
"""Cost of a state per cost of an input."""
_BACK = 1e-6
"""Distance from the orbit of a motion that has returned, in sizes."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldMotion(ByValue):
    """Returns under a feedback.

    Attributes:
        points: Coordinates of the returns, the start first, ``(n + 1, d)``.
        inputs: Inputs between the returns, ``(n, m)``.
        times: Time of each return [s], ``(n + 1,)``.
        lost: Why the motion ended before the last return, or empty.
    """

    points: Vector
    inputs: Vector
    times: Vector
    lost: str = ""


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Feedback(TableRepr):
    """Inputs once per period that keep an orbit.

    Attributes:
        returns: The return map of the orbit.
        inputs: Names of the gains and parameters that are held, ``m`` names.
        method: Method of the design.
        gain: Matrix `K`, ``(m, d)``, or ``(m, d + m)`` with a delay: the inputs in use follow.
        limits: Range of each input, to which it is clipped.
        delay: True if inputs are applied one return after their measurement.
        controllability: Smallest singular value of each multiplier's matrix, relative to the
            largest one of the loop. It is zero if the inputs do not change the multiplier.
        corners: The loop at the corners of uncertain parameters.
    """

    returns: ReturnMap
    inputs: tuple[str, ...]
    method: str
    gain: Vector
    limits: tuple[tuple[float, float], ...]
    delay: bool
    controllability: Vector
    corners: tuple[LoopCorner, ...] = ()

    def __repr__(self) -> str:
        """Return one line: the inputs and the spectral radius without and with them."""
        before = spectral_radius(self.returns.multipliers)
        return (
            f"<Feedback of {self.returns.problem.name} by {', '.join(self.inputs)}: {self.method}, "
            f"spectral_radius={before:.6g} -> {spectral_radius(self.multipliers):.6g}>"
        )

    def _columns(self) -> Columns:
        """Return the rows of the gain matrix."""
        return {
            "input": list(self.inputs),
            **{f"by_{name}": self.gain[:, k].tolist() for k, name in enumerate(self.measured)},
        }

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the columns of the gain matrix: the coordinates, with a delay the inputs too."""
        return (*self.returns.coordinates, *(self.inputs if self.delay else ()))

    @property
    def centre(self) -> Vector:
        """Inputs of the orbit, ``(m,)``."""
        return np.array([self.returns.values.number(name) for name in self.inputs])

    @property
    def multipliers(self) -> tuple[complex, ...]:
        """Multipliers of the loop, the largest first."""
        return eigenvalues(self.scaled_loop[0])

    @property
    def scaled_loop(self) -> tuple[Vector, Vector]:
        """Derivative of the loop, ``(n, n)``, and its matrix `K`, ``(m, n)``, relative to sizes."""
        a, b = _loop(self.returns, self.inputs, self.delay)
        units = input_sizes(self.returns, self.inputs)
        sizes = np.concatenate([self.returns.sizes, units]) if self.delay else self.returns.sizes
        loop = (a - b @ self._acting) * sizes / sizes[:, None]
        return loop, self._acting * sizes / units[:, None]

    @property
    def _acting(self) -> Vector:
        """Matrix `K` without the rows of inputs whose range is one value."""
        low, high = np.array(self.limits).T
        return self.gain * (low < high)[:, None]

    @property
    def stable(self) -> bool:
        """True if all multipliers of the loop are inside the unit circle."""
        return spectral_radius(self.multipliers) < 1.0

    @property
    def worst(self) -> float:
        """Largest spectral radius of the loop in the orbit and at all corners.

        It is infinite if the loop lacks an orbit at a corner.
        """
        return max(
            spectral_radius(self.multipliers), *(one.spectral_radius for one in self.corners), 0.0
        )

    @property
    def worst_at(self) -> dict[str, float]:
        """Uncertain parameters of the worst corner, empty if the orbit itself is the worst."""
        for one in self.corners:
            if one.spectral_radius == self.worst > spectral_radius(self.multipliers):
                return dict(one.parameters)
        return {}

    @property
    def robust(self) -> bool:
        """True if all multipliers of the loop are inside the unit circle, also at each corner."""
        return self.worst < 1.0

    @property
    def law(self) -> HeldLaw:
        """The law of the inputs as a machine has it."""
        known = self.returns
        return HeldLaw(
            inputs=dict(zip(self.inputs, self.limits, strict=True)),
            at=known.event,
            gain={
                name: dict(zip(self.measured, row, strict=True))
                for name, row in zip(self.inputs, self.gain.tolist(), strict=True)
            },
            centre=dict(zip(known.coordinates, known.fixed_point.tolist(), strict=True)),
            delay=self.delay,
        )

    def machine(self, file: str | Path | None = None) -> Problem:
        """Return the machine with its feedback: a problem whose inputs are held states.

        Its first start is the orbit, and its defaults are the values of the orbit. The coefficients
        and the centres of the law are parameters.

        Args:
            file: A problem file to write, from which the problem is loaded. Results name it, and
                workers load it. By default the problem lacks a file.

        Raises:
            InputError: If the event occurs more than once in a period, an input may not depend on
                time, the file cannot be written, or the problem itself lacks a file.
        """
        known = self.returns
        if known.n_events != 1:
            raise InputError(
                f"Argument `section`: `{known.event}` occurs {known.n_events} times in a period, "
                "and the law applies to one of them. Take the section of another event "
                "(`section` (--section))."
            )
        if known.is_kink:
            raise InputError(
                f"Argument `section`: `{known.event}` is a kink, which sets no states. Take the "
                "section of another event (`section` (--section))."
            )
        values, start = known.values.numbers, known.start
        try:
            made = with_held_inputs(known.problem, self.law, values=values, start=start)
            made.checked()
        except InputError:
            raise
        except ValueError as error:
            names = ", ".join(f"`{name}`" for name in self.inputs)
            told = f"Argument `inputs`: {names} cannot be held states: {error}"
            raise InputError(told) from error
        if file is None:
            return made
        path, word = Path(file), known.problem.file
        if path.suffix != ".py":
            raise InputError(f"Argument `file` must name a Python file, such as {path.stem}.py.")
        if word is None:
            raise InputError(
                f"Argument `file`: `{known.problem.name}` lacks a file of its own to refer to."
            )
        changed = {
            one.name: values[one.name]
            for one in known.problem.quantities
            if one.default is not None and values[one.name] != one.default
        }
        write_whole(
            path, held_file(word.word, path.absolute().parent, self.law, changed, start), "file"
        )
        return load_problem(path)

    def inputs_at(self, x: Any, in_use: Any = None) -> Vector:
        """Return the inputs that follow a measurement, clipped to their ranges, ``(m,)``.

        Args:
            x: Coordinates of the return, ``(d,)``.
            in_use: With a delay, the inputs until the next return. The default is the orbit's.
        """
        away = self._point(x) - self.returns.fixed_point
        if self.delay:
            used = (
                self.centre if in_use is None else finite_vector("in_use", in_use, of=self.inputs)
            )
            away = np.concatenate([away, used - self.centre])
        low, high = np.array(self.limits).T
        return np.clip(self.centre - self.gain @ away, low, high)

    def _point(self, x: Any) -> Vector:
        return finite_vector("x", x, of=self.returns.coordinates)

    @checked
    def offset(self, errors: Mapping[str, float]) -> dict[str, float]:
        r"""Return by how much constant errors of the readings shift the orbit and the inputs.

        .. math:: \Delta y = -(I - A + B K)^{-1} B K\, b, \qquad \Delta u = -K(\Delta y + b)

        The law is linear there: it holds while inputs stay in their ranges.

        Args:
            errors: Coordinate to the error of its reading. Those left out are exact.

        Raises:
            InputError: If a name or an error is invalid, or the loop does not keep the orbit.
        """
        given, (loop, push) = self._errors(errors), self._noisy_loop()
        away = np.linalg.solve(np.eye(len(loop)) - loop, push @ given)
        d, direct = len(given), self._acting[:, : len(given)]
        acts = away[d:] if self.delay else -self._acting @ away - direct @ given
        return self._named([*away[:d].tolist(), *acts.tolist()])

    @checked
    def scatter(self, errors: Mapping[str, float]) -> dict[str, float]:
        r"""Return the standard deviations of returns and inputs due to random errors of readings.

        The errors of a return are independent of those of the others. The covariance `P` solves

        .. math:: P = (A - B K) P (A - B K)^\top + B K \Sigma K^\top B^\top

        Args:
            errors: Coordinate to the standard deviation of its reading. Those left out are exact.

        Raises:
            InputError: If a name or an error is invalid, or the loop does not keep the orbit.
        """
        # The import takes a fifth of a second.
        from scipy.linalg import solve_discrete_lyapunov

        given, (loop, push) = self._errors(errors), self._noisy_loop()
        for name, value in zip(self.returns.coordinates, given.tolist(), strict=True):
            if value < 0.0:
                wanted = f"must not be negative: the standard deviation of `{name}`"
                raise InputError(f"Argument `errors` {wanted} is {value:g}.")
        noise, d = np.diag(given**2), len(given)
        known = np.zeros(loop.shape)
        if d:
            known = np.asarray(solve_discrete_lyapunov(loop, push @ noise @ push.T))
        direct = self._acting[:, :d]
        acts = known[d:, d:] if self.delay else self._acting @ known @ self._acting.T
        acts = acts if self.delay else acts + direct @ noise @ direct.T
        squares = np.concatenate([np.diag(known)[:d], np.diag(acts)])
        return self._named(np.sqrt(np.maximum(squares, 0.0)).tolist())

    def _noisy_loop(self) -> tuple[Vector, Vector]:
        """Return the derivatives of the loop by its state and by the errors of its readings.

        Raises:
            InputError: If the loop does not keep the orbit.
        """
        if not self.stable:
            told = f"the loop does not keep the orbit (multiplier {_shown(self.multipliers[0])})"
            raise InputError(f"Argument `errors`: {told}.")
        a, b = _loop(self.returns, self.inputs, self.delay)
        return a - b @ self._acting, -b @ self._acting[:, : len(self.returns.coordinates)]

    def _errors(self, errors: Mapping[str, float]) -> Vector:
        known, given = self.returns.coordinates, named_numbers("errors", errors)
        for name in given:
            if name not in known:
                raise InputError(f"Argument `errors`: {not_known(name, known)}")
        return np.array([finite_number("errors", given.get(one, 0.0)) for one in known])

    def _named(self, values: Sequence[float]) -> dict[str, float]:
        """Return values of coordinates and inputs by name."""
        names = (*self.returns.coordinates, *self.inputs)
        return dict(zip(names, values, strict=True))

    @checked
    def run(self, x: Any, n: int) -> HeldMotion:
        """Return a motion over `n` returns, each by simulation.

        Args:
            x: Coordinates of the start, ``(d,)``.
            n: Number of returns.

        Raises:
            InputError: If the start or the number is invalid.
        """
        if n < 0:
            raise InputError(f"Argument `n` must not be negative, but it is {shown(n)}.")
        points, inputs, times = [self._point(x)], list[Vector](), [0.0]
        lost = ""
        try:
            for point, used, _, time in islice(self._loop_from(points[0]), n):
                points.append(point)
                inputs.append(used)
                times.append(times[-1] + time)
        except _LOST as error:
            lost = str(error)
        return HeldMotion(
            points=np.array(points),
            inputs=np.array(inputs).reshape(-1, len(self.inputs)),
            times=np.array(times),
            lost=lost,
        )

    def _loop_from(self, x: Vector) -> Iterator[tuple[Vector, Vector, Vector, float]]:
        """Yield each return: its point, the inputs until then and after it, and its time [s].

        Raises:
            SimulationError: If the motion does not return.
        """
        point, used = x, self.centre if self.delay else self.inputs_at(x)
        while True:
            new, time = self._returned(point, used)
            after = self.inputs_at(point, used) if self.delay else self.inputs_at(new)
            yield new, used, after, time
            point, used = new, after

    def _returned(self, x: Vector, used: Vector) -> tuple[Vector, float]:
        numbers = dict(zip(self.inputs, used.tolist(), strict=True))
        known = self.returns
        gains = {name: numbers[name] for name in self.inputs if name in known.gain_names}
        others = {name: numbers[name] for name in self.inputs if name not in known.gain_names}
        return known.returned(x, gains, others)

    @checked
    def extent(
        self,
        coordinate: str,
        *,
        step: float = 0.01,
        most: float = 0.5,
        n: int = 60,
        on_progress: Progress = silent,
    ) -> tuple[float, float]:
        """Return the disturbances of a coordinate from which the motion returns to the orbit.

        They grow in steps to both sides until one is lost. The last step is bisected to a
        hundredth. Larger disturbances may return again.

        Args:
            coordinate: Name of the coordinate.
            step: Step of the disturbance, relative to the coordinate's largest value.
            most: Largest one.
            n: Returns until which it must have decayed to 1e-6 of the largest value.
            on_progress: Called with the stage.

        Returns:
            The largest negative and the largest positive disturbance, relative.

        Raises:
            InputError: If an argument is invalid.
        """
        if coordinate not in self.returns.coordinates:
            hint = did_you_mean(coordinate, self.returns.coordinates)
            wanted = f"must be one of {', '.join(self.returns.coordinates)}"
            raise InputError(f"Argument `coordinate` {wanted}, but it is `{coordinate}`.{hint}")
        if not 0.0 < step <= most:
            raise InputError(f"Argument `step` must lie in (0, `most`], but it is {shown(step)}.")
        place = self.returns.coordinates.index(coordinate)
        unit = np.zeros(len(self.returns.coordinates))
        unit[place] = self.returns.sizes[place]
        ends: list[float] = []
        for sense, word in ((-1.0, "down"), (1.0, "up")):
            good = 0.0
            while good < most:
                on_progress(f"disturbing {coordinate} {word}", good / most)
                size = min(good + step, most)
                if not self._comes_back(sense * size * unit, n):
                    good = self._bisected(sense * unit, good, size, n)
                    break
                good = size
            ends.append(sense * good)
        return ends[0], ends[1]

    def _bisected(self, along: Vector, good: float, bad: float, n: int) -> float:
        first = bad - good
        while bad - good > 0.01 * first:
            middle = (good + bad) / 2
            if self._comes_back(middle * along, n):
                good = middle
            else:
                bad = middle
        return good

    def _comes_back(self, away: Vector, n: int) -> bool:
        """Return True if a disturbance decays."""
        centre, sizes = self.returns.fixed_point, self.returns.sizes
        units = input_sizes(self.returns, self.inputs)
        try:
            for point, _, after, _ in islice(self._loop_from(centre + away), n):
                off = float(np.max(np.abs(point - centre) / sizes))
                acts = np.max(np.abs(after - self.centre) / units)
                if max(off, float(acts)) < _BACK:
                    return True
        except _LOST:
            return False
        return False

    def as_json(self) -> dict[str, Any]:
        """Return the feedback as plain data. An infinite limit is null."""
        known = self.returns
        finite = [[x if np.isfinite(x) else None for x in pair] for pair in self.limits]
        return {
            "problem": known.problem.name,
            "gains": dict(known.values.gains),
            "parameters": dict(known.values.parameters),
            "period": known.period,
            "section": known.event,
            "coordinates": {name: known.units[name] for name in known.coordinates},
            "fixed_point": known.fixed_point.tolist(),
            "inputs": dict(zip(self.inputs, self.centre.tolist(), strict=True)),
            "method": self.method,
            "delay": self.delay,
            "measured": list(self.measured),
            "gain": self.gain.tolist(),
            "limits": dict(zip(self.inputs, finite, strict=True)),
            "open_loop": [[mu.real, mu.imag] for mu in known.multipliers],
            "closed_loop": [[mu.real, mu.imag] for mu in self.multipliers],
            "controllability": self.controllability.tolist(),
            "corners": [one.as_json() for one in self.corners],
            "versions": dict(versions()),
        }


def feedback_of(
    returns: ReturnMap,
    inputs: Inputs,
    *,
    method: str = "lqr",
    weight: float | None = None,
    multipliers: Sequence[float | complex] | None = None,
    delay: bool = False,
    uncertain: Mapping[str, tuple[float, float]] | None = None,
    on_progress: Progress = silent,
) -> Feedback:
    """Return a feedback that keeps an orbit.

    Args:
        returns: The return map of the orbit.
        inputs: Gains and parameters that are held from return to return, with their ranges. The
            default range is the declared one.
        method: ``lqr`` minimizes the sum of squares of inputs and states, ``place`` gives the loop
            `multipliers`, and ``deadbeat`` gives it multipliers zero. ``robust`` minimizes the
            largest spectral radius in the orbit and at all corners of `uncertain`, from the gain of
            ``lqr`` on.
        weight: Cost of a state of its largest value per cost of an input of its own size, of
            ``lqr`` and ``robust``. The default is 1e-3. Without a cost, multipliers outside of the
            unit circle become their inverses. An input that is zero in the orbit has the size that
            moves a return by the size of a coordinate.
        multipliers: Multipliers of the loop, of ``place``.
        delay: Apply the inputs one return after their measurement.
        uncertain: Name to range of uncertain parameters. Each method computes the loop at their
            corners, with parameters that are derived from them derived.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If an argument is invalid, an input moves the section, or the inputs do not
            change a multiplier that has to change.
    """
    names = _checked_inputs(returns, inputs)
    _require_method(method, weight, multipliers)
    box = _checked_ranges(returns, names, method, uncertain)
    a, b = _loop(returns, names, delay)
    centre = np.array([returns.values.number(name) for name in names])
    units = input_sizes(returns, names)
    sizes = np.concatenate([returns.sizes, units]) if delay else returns.sizes
    scaled_a, scaled_b = a * sizes / sizes[:, None], b * units / sizes[:, None]
    known = eigenvalues(scaled_a)
    grip = np.array([_grip(scaled_a, scaled_b, mu) for mu in known])
    if method in ("lqr", "robust"):
        _require_grip(names, known, grip, 1.0)
        scaled = _lqr(scaled_a, scaled_b, _WEIGHT if weight is None else weight)
    else:
        _require_grip(names, known, grip, _NONE)
        scaled = _placed(scaled_a, scaled_b, multipliers)
        _require_reached(eigenvalues(scaled_a - scaled_b @ scaled), multipliers or ())
    limits = tuple(_range_of(returns, inputs, name) for name in names)
    loop = UncertainLoop(
        returns=returns, inputs=names, centre=centre, limits=limits, delay=delay, uncertain=box
    )
    each = units[:, None] / sizes
    gain = loop.best(scaled * each, each, on_progress) if method == "robust" else scaled * each
    return Feedback(
        returns=returns,
        inputs=names,
        method=method,
        gain=gain,
        limits=limits,
        delay=delay,
        controllability=grip,
        corners=loop.corners(gain),
    )


def _loop(returns: ReturnMap, inputs: Sequence[str], delay: bool) -> tuple[Vector, Vector]:
    """Return the derivatives of a return by its state and by the inputs."""
    names = (*returns.gain_names, *returns.parameter_names)
    return loop_derivatives(returns, names, inputs, delay=delay)


def _checked_inputs(returns: ReturnMap, inputs: Inputs) -> tuple[str, ...]:
    known = (*returns.gain_names, *returns.parameter_names)
    names: tuple[Any, ...] = (inputs,) if isinstance(inputs, str) else tuple(inputs)
    if not names:
        raise InputError("Argument `inputs` must name at least one gain or parameter.")
    for k, name in enumerate(names):
        if not isinstance(name, str):
            raise InputError(f"Argument `inputs` must name parameters by texts, not {shown(name)}.")
        if name not in known:
            hint = did_you_mean(name, known)
            told = f"unknown gain or parameter `{name}`.{hint} Known: {', '.join(known)}"
            raise InputError(f"Argument `inputs`: {told}.")
        if name in names[:k]:
            raise InputError(f"Argument `inputs` names `{name}` twice.")
        if returns.moves_section(name):
            raise InputError(
                f"Argument `inputs`: `{name}` moves the section `{returns.event}`, so a motion "
                "leaves it when the value changes. Take the section of another event (`section` "
                "(--section))."
            )
    return names


def _checked_ranges(
    returns: ReturnMap,
    inputs: Sequence[str],
    method: str,
    uncertain: Mapping[str, tuple[float, float]] | None,
) -> dict[str, tuple[float, float]]:
    """Return uncertain ranges as floats.

    Raises:
        InputError: If one is invalid, lacks the value of the orbit, or is an input, or the method
            needs one.
    """
    box = {
        name: number_range("uncertain", ends, name)
        for name, ends in named_numbers("uncertain", uncertain).items()
    }
    if method == "robust" and not box:
        raise InputError("Argument `uncertain` is needed by the method `robust`.")
    check_uncertain(box, returns.problem, {}, gains=True)
    require_orbit_inside(box, returns, inputs)
    return box


def _require_method(
    method: str, weight: float | None, multipliers: Sequence[float | complex] | None
) -> None:
    if method not in METHODS:
        hint = did_you_mean(method, METHODS)
        raise InputError(
            f"Argument `method` must be one of {', '.join(METHODS)}, but it is `{method}`.{hint}"
        )
    if weight is not None and method not in ("lqr", "robust"):
        raise InputError("Argument `weight` belongs to the methods `lqr` and `robust`.")
    if weight is not None and not 0.0 <= weight < np.inf:
        wanted = "must be a finite number of at least 0"
        raise InputError(f"Argument `weight` {wanted}, but it is {shown(weight)}.")
    if (multipliers is not None) != (method == "place"):
        wanted = "is needed by" if method == "place" else "belongs to"
        raise InputError(f"Argument `multipliers` {wanted} the method `place`.")


def _range_of(returns: ReturnMap, inputs: Inputs, name: str) -> tuple[float, float]:
    """Return the range of an input, by default the declared one, which the orbit may exceed."""
    value = returns.values.number(name)
    given = inputs.get(name) if isinstance(inputs, Mapping) else None
    if given is not None:
        ends = number_range("inputs", given, name)
        if not ends[0] <= ends[1]:
            wanted = f"must have a range LOW:HIGH with LOW <= HIGH for `{name}`"
            raise InputError(f"Argument `inputs` {wanted}, but it is {ends[0]:g}:{ends[1]:g}.")
        require_value_inside("inputs", name, value, ends)
        return ends
    problem = returns.problem
    one = next(one for one in (*problem.gains, *problem.parameters) if one.name == name)
    low, high = one.closed_range()
    return min(low, value), max(high, value)


def _shown(mu: complex) -> str:
    return f"{mu:.6g}" if mu.imag else f"{mu.real:.6g}"


def _grip(a: Vector, b: Vector, mu: complex) -> float:
    """Return how far a multiplier is from being uncontrollable, relative to the loop."""
    both = np.concatenate([a - mu * np.eye(len(a)), b], axis=1)
    values = np.linalg.svd(both, compute_uv=False)
    return float(values[-1] / max(values[0], 1.0)) if len(values) else 0.0


def _require_grip(
    names: Sequence[str], known: Sequence[complex], grip: Vector, least: float
) -> None:
    """Refuse inputs that do not change a multiplier whose modulus is at least a number.

    Raises:
        InputError: If there is one.
    """
    fixed = [mu for mu, size in zip(known, grip, strict=True) if abs(mu) >= least and size < _RANK]
    if fixed:
        which = ", ".join(map(_shown, fixed))
        said = " or ".join(f"`{name}`" for name in names)
        raise InputError(
            f"Argument `inputs`: {said} does not change the multiplier {which} of the orbit. Take "
            "another input, or the section of another event (`section` (--section))."
        )


def _require_reached(found: Sequence[complex], wished: Sequence[float | complex]) -> None:
    """Refuse a loop whose multipliers are not the wished ones: each needs an input of its own.

    Raises:
        InputError: If they are not.
    """
    for mu in found:
        if min(abs(mu - complex(one)) for one in (*wished, 0.0)) > _MISSED:
            raise InputError(
                f"Argument `method`: no combination of the inputs changes the multiplier "
                f"{_shown(mu)} and all others. Take the method `lqr`."
            )


def _lqr(a: Vector, b: Vector, weight: float) -> Vector:
    """Return the matrix that minimizes a sum of squares over all returns."""
    # The import takes a fifth of a second.
    from scipy.linalg import solve_discrete_are

    d, m = b.shape
    if not d:
        return np.zeros((m, 0))
    try:
        cost = np.asarray(solve_discrete_are(a, b, weight * np.eye(d), np.eye(m)), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise InputError(
            "Argument `weight` is too small: a multiplier of the orbit is on the unit circle."
        ) from error
    gain = np.linalg.solve(np.eye(m) + b.T @ cost @ b, b.T @ cost @ a)
    return np.asarray(gain, dtype=np.float64)


def _placed(a: Vector, b: Vector, wished: Sequence[float | complex] | None) -> Vector:
    r"""Return the matrix that gives the loop its multipliers, by Ackermann's formula.

    Several inputs act together, in the combination that grips the loop best:
    :math:`K = w\, e_r^\top C^{-1} p(A)` with the controllability matrix `C` of :math:`B w` and the
    polynomial `p` of the multipliers. Multipliers that no input changes are zero and stay.
    """
    d, m = b.shape
    combinations = np.concatenate([np.eye(m), np.ones((1, m)) / np.sqrt(m)])
    best, weights, basis = -1.0, combinations[0], np.zeros((d, 0))
    for one in combinations:
        reached = _reached(a, b @ one)
        values = np.linalg.svd(reached, compute_uv=False)
        seen = values > _RANK * max(values, default=0.0)
        grip = float(np.sum(seen)) + float(values[seen][-1] / values[0]) if np.any(seen) else 0.0
        if grip > best:
            u = np.linalg.svd(reached)[0][:, : int(np.sum(seen))]
            best, weights, basis = grip, one, u
    rank = basis.shape[1]
    target = np.zeros(rank, dtype=np.complex128)
    if wished is not None:
        target = _checked_multipliers(wished, rank)
    inner, push = basis.T @ a @ basis, basis.T @ b @ weights
    polynomial = np.real(np.poly(target)) if rank else np.ones(1)
    value = np.zeros((rank, rank))
    for coefficient in polynomial:
        value = value @ inner + coefficient * np.eye(rank)
    last = np.zeros(rank)
    if rank:
        last[-1] = 1.0
        last = np.linalg.solve(_reached(inner, push).T, last)
    return np.asarray(np.outer(weights, last @ value @ basis.T), dtype=np.float64)


def _reached(a: Vector, push: Vector) -> Vector:
    """Return the controllability matrix of one input, ``(d, d)``."""
    columns = [push]
    for _ in range(len(a) - 1):
        columns.append(a @ columns[-1])
    return np.stack(columns, axis=1) if len(a) else np.zeros((0, 0))


def _checked_multipliers(wished: Sequence[float | complex], rank: int) -> Vector:
    target = np.array([complex(one) for one in wished])
    if len(target) != rank:
        raise InputError(
            f"Argument `multipliers` must hold {rank} numbers, the multipliers that the inputs "
            f"change, but it holds {len(target)}."
        )
    if np.any(~np.isfinite(target)) or np.any(np.abs(target) >= 1.0):
        raise InputError("Argument `multipliers` must hold numbers inside the unit circle.")
    if np.max(np.abs(np.poly(target).imag), initial=0.0) > 1e-12:
        raise InputError("Argument `multipliers` must hold complex numbers in conjugate pairs.")
    return target
