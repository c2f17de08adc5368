"""Arguments shared by the functions of the API: problems, orbits, ranges and counts."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping
from functools import wraps
from inspect import Parameter, Signature, signature
from operator import index
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from zeno_orbits.api.names import options_line
from zeno_orbits.errors import (
    EquationsWarning,
    InputError,
    did_you_mean,
    number_range,
    shortened,
    shown,
)
from zeno_orbits.model import (
    Problem,
    ProblemFile,
    locate_problem,
    recorded_problem,
    require_zeno_points,
)
from zeno_orbits.orbits import (
    ZENO_ORBIT,
    Orbit,
    other_equations,
    read_orbit,
)
from zeno_orbits.work import ExecutionPlan, Workers, checked

if TYPE_CHECKING:
    from zeno_orbits.maps import Axis as MapAxis

Named = str | Path | Problem
"""A problem, the name of a bundled problem, or the path of its file."""

Numbers = Mapping[str, float]
"""Name to value. Names that are missing keep the problem's default."""

Span = tuple[str, float, float]
"""Name of a gain or parameter, and its range."""

Axis = tuple[str, float, float, int]
"""Name of a gain or parameter, its range, and the number of points along it."""

_ALIASES = {
    "Named": "str | Path | Problem",
    "Numbers": "Mapping[str, float]",
    "Span": "tuple[str, float, float]",
    "Axis": "tuple[str, float, float, int]",
}
"""The aliases of this module as signatures show them."""

_P = ParamSpec("_P")
_R = TypeVar("_R")


def front_door(work: Callable[_P, _R]) -> Callable[_P, _R]:
    """Check the names and types of arguments, and show progress in a notebook or terminal.

    Progress is not shown if the caller passes an ``on_progress``.
    """
    work = checked(work)
    known = signature(work).parameters
    tells = "on_progress" in known

    @wraps(work)
    def shown(*given: _P.args, **named: _P.kwargs) -> _R:
        from zeno_orbits.report import line_for_watcher

        for name in named:
            if name not in known:
                wrong = f"{work.__name__}() got an unexpected keyword argument {name!r}"
                raise TypeError(f"{wrong}.{did_you_mean(name, known)}")
        if tells and "on_progress" in named:
            _require_progress(named["on_progress"])
        line = line_for_watcher() if tells and "on_progress" not in named else None
        if line is None:
            return work(*given, **named)
        with line:
            return untyped(*given, **{**named, "on_progress": line})

    untyped: Any = work
    opened: Any = shown
    opened.__signature__ = _as_shown(signature(work))
    options_of = options_line(known)
    if work.__doc__ and options_of:
        opened.__doc__ = f"{work.__doc__.rstrip()}\n\n    Command line: {options_of}.\n    "
    return shown


def _require_progress(told: Any) -> None:
    """Refuse a function that cannot be called with a text and a finished part.

    Raises:
        InputError: If its signature does not fit.
    """
    if isinstance(told, type):
        wanted = "must be a function or an object to be called"
        raise InputError(f"Argument `on_progress` {wanted}, but it is the class `{told.__name__}`.")
    try:
        known = signature(told)
    except (TypeError, ValueError):
        # It is no function, which the annotation excludes, or it hides its signature.
        return
    try:
        known.bind("", None)
    except TypeError:
        wanted = "must take a text and a part from 0 to 1"
        taken = shortened(str(known))
        raise InputError(f"Argument `on_progress` {wanted}, but it takes `{taken}`.") from None


def _as_shown(known: Signature) -> Signature:
    """Return a signature in the words of a user, with aliases written out."""

    def plain(one: Parameter) -> Parameter:
        kind = re.sub(r"\w+", lambda found: _ALIASES.get(found[0], found[0]), str(one.annotation))
        return one.replace(annotation=kind)

    return known.replace(parameters=[plain(one) for one in known.parameters.values()])


def plan_of(workers: int, plan: ExecutionPlan | None) -> ExecutionPlan | None:
    """Return the plan of parallel work, or None if this process does all the work.

    Args:
        workers: Number of processes.
        plan: A plan, which overrides ``workers``.

    Raises:
        InputError: If ``workers`` is not an integer of at least 0.
    """
    if plan is not None:
        return plan
    count = whole("workers", workers)
    return None if count == 1 else ExecutionPlan(place=Workers(count=count or None))


def split_numbers(problem: Problem, numbers: Numbers) -> tuple[dict[str, float], dict[str, float]]:
    """Split named values into gains and parameters.

    Args:
        problem: The problem that declares them.
        numbers: Name to value.

    Raises:
        InputError: If the problem does not declare a name as a gain or parameter.
    """
    gains = {name: x for name, x in numbers.items() if problem.quantity(name) in problem.gains}
    return gains, {name: x for name, x in numbers.items() if name not in gains}


def problem_of(orbit: Orbit, problem: Named | None = None) -> Problem:
    """Return the problem of an orbit: as given, by its name, or from the file that it records.

    A warning is issued if the equations of the problem differ from those of the orbit.

    Args:
        orbit: The orbit.
        problem: The orbit's problem, required if it is neither bundled nor found.

    Raises:
        InputError: If the given problem is not the orbit's, no problem is given and the orbit's is
            neither bundled nor found (`RecordedFile.trusted`), or impacts accumulate in the orbit
            at a stop that is elastic.
    """
    found = problem_to_check(orbit, problem)
    _require_zeno_points(orbit, found)
    if other := other_equations(orbit.problem_digest, found):
        warnings.warn(f"{other[0].upper()}{other[1:]}.", EquationsWarning, stacklevel=2)
    return found


def _require_zeno_points(orbit: Orbit, problem: Problem) -> None:
    """Refuse an orbit whose impacts accumulate at an elastic stop.

    Raises:
        InputError: If a restitution is 1 there.
    """
    values = orbit.values(problem)
    if orbit.kind == ZENO_ORBIT:
        graph = problem.graph_dynamics(values)
        for name, view in zip(graph.stop_names, graph.open_views, strict=False):
            if f"zeno {name}" in orbit.sequence:
                require_zeno_points(view.restitution, name)


def problem_to_check(orbit: Orbit, problem: Named | None = None) -> Problem:
    """Return the problem of an orbit like `problem_of`, for a check that compares the equations."""
    given = None if problem is None else known_problem(problem)
    return recorded_problem(orbit.problem, given, file=orbit.problem_file)


def as_span(argument: str, span: Any) -> tuple[str, tuple[float, float]]:
    """Return the name and the range of a gain or parameter.

    Args:
        argument: Name of the argument.
        span: ``(name, low, high)``.

    Raises:
        InputError: If the value has another form.
    """
    match span:
        case (str(name), low, high):
            return name, number_range(argument, (low, high))
        case _:
            wanted = f"must be (NAME, LOW, HIGH), but it is {shown(span)}"
            raise InputError(f"Argument `{argument}` {wanted}.")


def as_axis(argument: str, axis: Any) -> MapAxis:
    """Return an axis of a map.

    Raises:
        InputError: If the axis is not a name, two numbers and a count.
    """
    from zeno_orbits.maps import Axis as MapAxis

    try:
        name, low, high, count = axis
    except (TypeError, ValueError) as error:
        wanted = "must be (name, lower, upper, number of points)"
        raise InputError(f"Argument `{argument}` {wanted}, but it is {shown(axis)}.") from error
    low, high = number_range(argument, (low, high))
    if not isinstance(name, str):
        raise InputError(f"Argument `{argument}` must name a quantity, but it is {shown(name)}.")
    return MapAxis(name=name, lower=low, upper=high, count=whole(argument, count))


_LARGEST = 2**31
"""Bound of all counts, far above any useful number of workers or points."""


def whole(argument: str, value: Any) -> int:
    """Return a count.

    Raises:
        InputError: If the value is not an integer of at least 0.
    """
    try:
        number = index(value)
    except TypeError:
        number = -1
    if isinstance(value, bool) or not 0 <= number < _LARGEST:
        wanted = "must be a whole number of at least 0"
        raise InputError(f"Argument `{argument}` {wanted}, but it is {shown(value)}.")
    return number


def known_problem(problem: Named) -> Problem:
    """Return the problem given by a name, a file or the problem itself."""
    return problem if isinstance(problem, Problem) else locate_problem(problem).load()


def repeating_problem(problem: Named) -> Problem:
    """Return a problem whose motion may repeat, given as for `known_problem`.

    Raises:
        InputError: If the problem has a `zo.Time`.
    """
    known = known_problem(problem)
    if known.has_time:
        raise InputError(
            f"Argument `problem`: no motion of `{known.name}` repeats, because its clock is a "
            "`zo.Time`: simulate it, or give it a `zo.Clock`."
        )
    return known


def file_of(problem: Named) -> ProblemFile:
    """Return the problem's file, which workers load themselves.

    Raises:
        InputError: If the problem was not loaded from a file, or differs from the declarations in
            its file.
    """
    if not isinstance(problem, Problem):
        return locate_problem(problem)
    file = problem.file
    if file is None:
        reason = "made or changed in this program: save it to a file that defines `PROBLEM`"
        raise InputError(f"Argument `problem`: several workers need a file, but it is {reason}.")
    return file


def as_orbit(orbit: Orbit | str | Path, problem: Named | None = None) -> Orbit:
    """Return the orbit of one stop given by a file, or the orbit itself.

    Args:
        orbit: The orbit, or its file.
        problem: The problem that is given with it.

    Raises:
        InputError: If the orbit passes further modes. The message names the cause.
    """
    found = any_orbit(orbit)
    if found.phases_as is not None:
        return found
    try:
        reason = problem_to_check(found, problem).modes_reason
    except InputError:
        reason = ""
    name = f"Orbit file `{orbit}`" if isinstance(orbit, str | Path) else "Argument `orbit`"
    raise InputError(
        f"{name}: one flow off the stop and one on it are needed here, but `{found.problem}` has "
        f"{reason or 'further modes'}. `verify`, `stability`, `continue`, `push`, `recovery`, "
        "`plot` and `report` take this orbit."
    )


def problem_or_orbit(
    word: str, numbers: Numbers, file: str | None = None
) -> tuple[Problem, dict[str, float], dict[str, float]]:
    """Return a problem with gains and parameters, given by its name or by a file of its orbit.

    Args:
        word: A problem's name or file, or an orbit's file. An orbit gives its own values.
        numbers: Name to value, which override the values of the orbit.
        file: File of the orbit's problem.

    Returns:
        The problem, and the gains and parameters that differ from its defaults.
    """
    if Path(word).suffix != ".json":
        problem = known_problem(word)
        return problem, *split_numbers(problem, numbers)
    orbit = any_orbit(word)
    problem = problem_of(orbit, file)
    values = orbit.values(problem)
    # Other derived parameters follow from the ones that are given.
    own = {
        one.name: values.parameters[one.name]
        for one in problem.parameters
        if one.default is not None and values.parameters[one.name] != one.default
    }
    follows = problem.values(gains=values.gains, parameters=own).parameters
    own |= {k: value for k, value in values.parameters.items() if value != follows[k]}
    gains, parameters = split_numbers(problem, numbers)
    return problem, {**values.gains, **gains}, {**own, **parameters}


def any_orbit(orbit: Orbit | str | Path) -> Orbit:
    """Return the orbit given by a file of any format, or the orbit itself."""
    if isinstance(orbit, Orbit):
        return orbit
    return read_orbit(orbit)
