"""Feedback once per period, and machines whose inputs are held from event to event."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from zeno_orbits.api.inputs import Named, Numbers, any_orbit, front_door, known_problem, problem_of
from zeno_orbits.errors import named_numbers, number_range
from zeno_orbits.model import HeldLaw, Problem, recorded_problem, with_held_inputs
from zeno_orbits.orbits import Orbit
from zeno_orbits.work import Progress, silent

if TYPE_CHECKING:
    from zeno_orbits.continuation import Continuation, HeldFamilies
    from zeno_orbits.maps import Feedback


@front_door
def design_feedback(
    orbit: Orbit | str | Path,
    inputs: Sequence[str] | Mapping[str, tuple[float, float] | None],
    *,
    problem: Named | None = None,
    section: str | None = None,
    method: str = "lqr",
    weight: float | None = None,
    multipliers: Sequence[float | complex] | None = None,
    delay: bool = False,
    uncertain: Mapping[str, tuple[float, float]] | None = None,
    on_progress: Progress = silent,
) -> Feedback:
    """Return inputs once per period that keep an orbit, also one that repels.

    Args:
        orbit: The orbit, or its file.
        inputs: Gains and parameters that are held from return to return, with their ranges. The
            default range is the declared one.
        problem: The orbit's problem. The default is the bundled problem of its name.
        section: Event at which the inputs are set. The default is the event at which the orbit
            starts.
        method: ``lqr`` minimizes the sum of squares of inputs and states, ``place`` gives the loop
            `multipliers`, and ``deadbeat`` gives it multipliers zero. ``robust`` minimizes the
            largest spectral radius in the orbit and at all corners of `uncertain`.
        weight: Cost of a state of its largest value per cost of an input of its own size, of
            ``lqr`` and ``robust``. The default is 1e-3. An input that is zero in the orbit has the
            size that moves a return by the size of a coordinate.
        multipliers: Multipliers of the loop, of ``place``.
        delay: Apply the inputs one return after their measurement.
        uncertain: Name to range of uncertain parameters. The result has the loop at the corners of
            these ranges, with parameters that are derived from them derived.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If an argument is invalid, an input moves the section, or the inputs do not
            change a multiplier that has to change.
        SimulationError: If the simulation does not return to the orbit.
    """
    from zeno_orbits.maps import feedback_of
    from zeno_orbits.orbits import return_map_of

    orbit = any_orbit(orbit)
    known = problem_of(orbit, problem)
    returns = return_map_of(known, orbit, section=section)
    return feedback_of(
        returns,
        inputs,
        method=method,
        weight=weight,
        multipliers=multipliers,
        delay=delay,
        uncertain=uncertain,
        on_progress=on_progress,
    )


@front_door
def stabilize(
    found: Continuation,
    inputs: Sequence[str],
    *,
    problem: Named | None = None,
    on_progress: Progress = silent,
) -> HeldFamilies:
    """Return the least feedback that keeps each repelling orbit of families.

    Args:
        found: The families.
        inputs: Gains and parameters that are set at each return.
        problem: The problem of the families. The default is the problem that they record.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If an input is unknown, or is the parameter of the families.
    """
    from zeno_orbits.continuation import held_families

    given = None if problem is None else known_problem(problem)
    word = found.families[0].problem
    known = recorded_problem(word, given, result="family", file=found.problem_file)
    return held_families(known, found, inputs, on_progress=on_progress)


@front_door
def hold_inputs(
    problem: Named,
    *,
    inputs: Mapping[str, tuple[float, float] | None],
    at: str,
    gain: Mapping[str, Mapping[str, float]],
    centre: Numbers,
    delay: bool = False,
    name: str | None = None,
    values: Numbers | None = None,
    start: Numbers | None = None,
) -> Problem:
    r"""Return a problem some of whose gains or parameters are held states, set anew at an event.

    .. math:: u^+ = \mathrm{clip}\bigl(u^* - K\,(y - y^*)\bigr)

    The state ``held_NAME`` takes the place of the input, whose own value is the centre
    :math:`u^*`. With a delay ``next_NAME`` waits for the next event. The coefficients `K` and the
    centres :math:`y^*` are parameters, ``K_NAME_STATE`` and ``centre_NAME_STATE``.

    Args:
        problem: The problem, its name or its file.
        inputs: Name of each gain or parameter that is held, to its range or ``None`` for any value.
        at: The event at which they are set, such as ``release stop``.
        gain: Name of each input to the coefficients of the measured states, and with a delay of
            the inputs in use, by name.
        centre: Value of every measured state at which the inputs have their own values. The states
            are those just after the event, or just before it if it is a switch.
        delay: Apply the inputs one event after their measurement.
        name: Name of the new problem. The default is ``PROBLEM_held``.
        values: Gains and parameters that become defaults.
        start: State from which the machine starts. Inputs that it lacks have their own values.

    Raises:
        InputError: If a name is unknown or taken, a range is empty, or a coefficient is missing.
    """
    law = HeldLaw(
        inputs={
            one: number_range("inputs", ends or (-math.inf, math.inf), one)
            for one, ends in named_numbers("inputs", inputs).items()
        },
        at=at,
        gain=gain,
        centre=centre,
        delay=delay,
    )
    return with_held_inputs(known_problem(problem), law, name=name, values=values, start=start)
