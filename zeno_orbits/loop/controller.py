r"""The controller of a machine with held states as one C99 file: law, held states and events.

It uses only the memory of its caller, and every call takes the same instructions. Its formulas
are those of the machine, operation by operation, so that all digits are equal.

With a window, coordinates and rates at an event are those of a parabola through the readings of the
present contact or flight (theory (6.5)). It is the sum of the polynomials 1, :math:`d` and
:math:`d^2 - \beta d - \gamma` of the distance `d` from the mean time, which are orthogonal on the
readings. A contact ends in the middle between its last reading and the next one, and the clock of
a machine is turned back to this time.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.loop.export import c_array, c_number, c_text
from zeno_orbits.loop.formulas import straight_line
from zeno_orbits.loop.tape import tape_of
from zeno_orbits.model import ParameterValues, Problem, dense_function

_WORD = re.compile(r"\W")
_LEAST, _ROUNDED = 3, 1e-9
"""Periods of a window at least, and rounding of their number."""
KINDS = ("impact", "zeno", "release")
"""Events of a stop in the order of the flags of the C code."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportedController:
    """The controller of a machine.

    Attributes:
        name: Name of the machine.
        state_names: Names of its states.
        held: Indices of the held states.
        values: Gains and parameters, ``(n_p,)``.
        start: Held values before the first event.
        stop_names: Names of its stops.
        setters: ``(x, p) -> x`` after each event of a stop that sets states, by the event.
        guards: ``(x, p) -> (guards, formulas armed)`` of the switches at which states are set.
        resets: ``(x, p) -> x`` after each of these switches.
        voltage: ``(x, p) -> voltages`` of all motors.
        pace: ``(x, p) -> angular velocity`` of the clock, or the rate of a time. Zero without one.
        n_clock: Number of states of the clock, which are the last ones.
        persists: Duration from which a contact persists [s].
        n_q: Number of coordinates.
        window: Time of readings through which a parabola is fitted at an event [s]. Zero takes the
            reading itself.
        period: Time between two readings [s], with a window.
    """

    name: str
    state_names: Sequence[str]
    held: Sequence[int]
    values: Vector
    start: Vector
    stop_names: Sequence[str]
    setters: Mapping[str, ca.Function]
    guards: ca.Function
    resets: Sequence[ca.Function]
    voltage: ca.Function
    pace: ca.Function
    n_clock: int
    persists: float
    n_q: int
    window: float = 0.0
    period: float = 0.0

    @property
    def n_readings(self) -> int:
        """Number of readings that are kept."""
        return math.floor(self.window / self.period + _ROUNDED) + 2 if self.window else 0


def controller_of(
    problem: Problem,
    values: ParameterValues,
    state: Vector,
    *,
    persists: float = 0.01,
    window: float = 0.0,
    period: float = 0.0,
) -> ExportedController:
    """Return the controller of a machine with held states.

    Args:
        problem: The machine.
        values: Values of its gains and parameters.
        state: Start, with the values that are held until the first event, ``(n_x,)``.
        persists: Duration from which a contact persists [s].
        window: Time of readings through which a parabola is fitted at an event [s], or zero.
        period: Time between two readings [s], with a window.

    Raises:
        InputError: If no event sets a held state, or the window holds fewer than four readings.
    """
    if window and not (period > 0.0 and _LEAST * period <= window * (1 + _ROUNDED) < math.inf):
        raise InputError(
            f"Argument `window` must hold at least {_LEAST + 1} readings, which are {period:g} s "
            f"apart, but it is {window:g} s."
        )
    compiled = problem.compiled_graph()
    graph, x, p = compiled.graph, compiled.graph.state, compiled.parameters
    held = list(graph.held)
    setters = {event: compiled.resets[k] for k, event in enumerate(graph.causes) if event}
    own = [
        k
        for k, (cause, reset) in enumerate(zip(graph.causes, graph.resets, strict=True))
        if not cause and held and not ca.is_equal(reset[held], x[held], 1)
    ]
    if not setters and not own:
        raise InputError(
            f"Argument `problem`: no event sets a held state of `{problem.name}`. "
            "`feedback ORBIT --input NAME --machine FILE.py` writes a machine that has one."
        )
    turns = graph.mechanism.clock
    clock = (ca.SX(0, 1), ca.SX(0, 1)) if turns is None else (turns.state, turns.rate)
    guards = ca.vertcat(*(ca.SX(graph.switches[k].guard) for k in own))
    armed = ca.vertcat(*(ca.SX(graph.switches[k].armed) for k in own))
    return ExportedController(
        name=problem.name,
        state_names=problem.state_names,
        held=held,
        values=np.array(values.vector),
        start=np.asarray(state)[held],
        stop_names=tuple(stop.name for stop in graph.stops),
        setters=setters,
        guards=dense_function("guards", [x, p], [ca.vertcat(guards, armed)]),
        resets=[compiled.resets[k] for k in own],
        voltage=dense_function("voltage", [x, p], [graph.drive.motor_voltage]),
        pace=dense_function("pace", [x, p], [_pace(*clock)]),
        n_clock=clock[0].numel(),
        persists=persists,
        n_q=compiled.n_q,
        window=window,
        period=period,
    )


def _pace(state: ca.SX, rate: ca.SX) -> ca.SX:
    """Return the angular velocity of a clock, or the rate of a time."""
    if state.numel() < 2:
        return ca.sum1(rate)
    (cosine, sine), rates = ca.vertsplit(state), ca.vertsplit(rate)
    return (cosine * rates[1] - sine * rates[0]) / (cosine**2 + sine**2)


def controller_files(controller: ExportedController) -> dict[str, str]:
    """Return the C code of a controller and its header, by file name.

    Args:
        controller: The controller.

    Raises:
        UnknownOperationError: If a formula holds an operation that the code lacks.
    """
    stem = _WORD.sub("_", controller.name)
    return {
        f"{stem}_controller.c": "".join(_code(controller, stem)),
        f"{stem}_controller.h": _header(controller, stem),
    }


def _header(controller: ExportedController, stem: str) -> str:
    """Return the header of a controller."""
    sensors = [name for k, name in enumerate(controller.state_names) if k not in controller.held]
    held = [controller.state_names[k] for k in controller.held]
    n_switches = len(controller.resets)
    return f"""/* The controller of `{controller.name}`.

   Sensors: {", ".join(sensors)}.
   Held: {", ".join(held)}.
   Contacts of stops: {", ".join(controller.stop_names) or "none"}. */

#ifndef {stem}_CONTROLLER_H
#define {stem}_CONTROLLER_H

enum {{
    {stem}_SENSORS = {len(sensors)},
    {stem}_HELD = {len(held)},
    {stem}_STOPS = {len(controller.stop_names)},
    {stem}_SWITCHES = {n_switches},
    {stem}_VOLTAGES = {controller.voltage.numel_out(0)},
    {stem}_READINGS = {controller.n_readings}
}};

/* A contact that lasts longer than this is no bounce, and its end is a release [s]. */
#ifndef {stem}_PERSISTS
#define {stem}_PERSISTS {c_number(controller.persists)}
#endif

typedef struct {{
    double held[{max(1, len(held))}];
    double since[{max(1, len(controller.stop_names))}];    /* begin of each contact [s] */
    int touched[{max(1, len(controller.stop_names))}], rested[{max(1, len(controller.stop_names))}];
    int above[{max(1, n_switches)}], is_begun;
    int n_kept;    /* readings of the present contact or flight */
    double when[{max(1, controller.n_readings)}];
    double kept[{max(1, controller.n_readings)}][{max(1, controller.n_q)}];
}} {stem}_controller;

/* Take the held values of the start. */
void {stem}_begin({stem}_controller *c);

/* Take a reading: set held states if an event has occurred since the last one, and return the
   voltages [V]. `contacts` tells for every stop whether it is touched. */
void {stem}_step({stem}_controller *c, double time, const double *sensors, const int *contacts,
                 double *voltages);

#endif
"""


def _code(controller: ExportedController, stem: str) -> Iterator[str]:
    """Yield the parts of the C code of a controller."""
    n_x = len(controller.state_names)
    yield f'#include <math.h>\n#include <string.h>\n\n#include "{stem}_controller.h"\n\n'
    sizes = f"STATES = {n_x}, COORDINATES = {controller.n_q}, CLOCK = {controller.n_clock}"
    yield f"enum {{ {sizes} }};\n\n"
    yield f"static const double window = {c_number(controller.window)};    /* [s] */\n"
    yield c_array("static const double p[]", map(c_number, controller.values.tolist() or [0.0]))
    places = [str(k) for k in controller.held] or ["0"]
    yield c_array("static const int held_at[]", places)
    yield c_array("static const double first[]", map(c_number, controller.start.tolist() or [0.0]))
    yield "\n" + straight_line("voltage", tape_of(controller.voltage))
    yield straight_line("guards", tape_of(controller.guards))
    yield straight_line("pace", tape_of(controller.pace))
    for k, reset in enumerate((*controller.setters.values(), *controller.resets)):
        yield straight_line(f"set_{k}", tape_of(reset))
    events = list(controller.setters)
    yield _chosen(len(events) + len(controller.resets))
    rows = [
        [
            str(events.index(f"{kind} {stop}")) if f"{kind} {stop}" in events else "-1"
            for kind in KINDS
        ]
        for stop in controller.stop_names
    ]
    flat = [entry for row in rows for entry in row] or ["-1"]
    yield c_array("static const int at_event[]", flat)
    yield f"/* Events: {', '.join(map(c_text, events)) or 'none'}. */\n"
    yield _STEP.replace("NAME", stem).replace("FIRST_SWITCH", str(len(events)))


def _chosen(n: int) -> str:
    cases = "".join(f"    case {k}: set_{k}(x, z); break;\n" for k in range(n))
    return (
        "static void set_by(int event, const double *x, double *z) {\n    switch (event) {\n"
        f"{cases}    default: (void)x, (void)z;\n    }}\n}}\n\n"
    )


_STEP = """
/* The state of the machine, of what is measured and what is held. */
static void joined(const NAME_controller *c, const double *sensors, double *x) {
    int k, next = 0, seen = 0;
    for (k = 0; k < STATES; k++) {
        if (next < NAME_HELD && held_at[next] == k)
            x[k] = c->held[next++];
        else
            x[k] = sensors[seen++];
    }
}

/* Keep a reading, and drop those that are older than the window. */
static void keep(NAME_controller *c, double time, const double *sensors) {
    double x[STATES];
    int k, n = 0;
    if (!NAME_READINGS) return;
    for (k = 0; k < c->n_kept; k++)
        if (c->when[k] >= time - window && (k > 0 || c->n_kept < NAME_READINGS)) {
            c->when[n] = c->when[k];
            memmove(c->kept[n++], c->kept[k], sizeof c->kept[0]);
        }
    joined(c, sensors, x);
    c->when[n] = time;
    memcpy(c->kept[n], x, COORDINATES * sizeof(double));
    c->n_kept = n + 1;
}

/* Return whether more readings are kept than a parabola has coefficients, or none is used. */
static int fits(const NAME_controller *c) { return !NAME_READINGS || c->n_kept > 3; }

/* Coordinates and rates of the parabola of least squares at a time. */
static void estimate(const NAME_controller *c, double time, double *x) {
    double mean = 0.0, second = 0.0, third = 0.0, fourth = 0.0, skew, spread;
    const int n = c->n_kept;
    int k, j;
    if (!NAME_READINGS || !fits(c)) return;
    for (k = 0; k < n; k++) mean += (c->when[k] - time) / window / n;
    for (k = 0; k < n; k++) {
        const double d = (c->when[k] - time) / window - mean;
        second += d * d;
        third += d * d * d;
    }
    skew = third / second;
    spread = second / n;
    for (k = 0; k < n; k++) {
        const double d = (c->when[k] - time) / window - mean, p2 = d * d - skew * d - spread;
        fourth += p2 * p2;
    }
    for (j = 0; j < COORDINATES; j++) {
        double c0 = 0.0, c1 = 0.0, c2 = 0.0;
        for (k = 0; k < n; k++) {
            const double d = (c->when[k] - time) / window - mean, q = c->kept[k][j];
            c0 += q / n;
            c1 += d * q / second;
            c2 += (d * d - skew * d - spread) * q / fourth;
        }
        x[j] = c0 - c1 * mean + c2 * (mean * mean + skew * mean - spread);
        x[COORDINATES + j] = (c1 - c2 * (2 * mean + skew)) / window;
    }
}

/* Turn the clock from its reading to another time. */
static void turn(double ahead, double *x) {
    double rate[1], cosine, sine, *const clock = x + STATES - CLOCK;
    if (CLOCK == 0 || ahead == 0.0) return;
    pace(x, rate);
    if (CLOCK == 1) {
        clock[0] += ahead * rate[0];
        return;
    }
    cosine = clock[0], sine = clock[CLOCK - 1];
    clock[0] = cosine * cos(ahead * rate[0]) - sine * sin(ahead * rate[0]);
    clock[CLOCK - 1] = sine * cos(ahead * rate[0]) + cosine * sin(ahead * rate[0]);
}

/* Set states at an event, which may be before the time of the reading. */
static void set(NAME_controller *c, int event, double time, double ahead, const double *sensors) {
    double x[STATES], z[STATES];
    int k;
    if (event < 0) return;
    joined(c, sensors, x);
    turn(ahead, x);
    estimate(c, time + ahead, x);
    memcpy(z, x, sizeof z);
    set_by(event, x, z);
    for (k = 0; k < NAME_HELD; k++) c->held[k] = z[held_at[k]];
}

void NAME_begin(NAME_controller *c) {
    memset(c, 0, sizeof *c);
    memcpy(c->held, first, NAME_HELD * sizeof(double));
}

static void see_contacts(NAME_controller *c, double time, const double *sensors,
                         const int *contacts) {
    const double last = c->n_kept ? c->when[c->n_kept - 1] : time;
    int k, changes = 0;
    for (k = 0; k < NAME_STOPS; k++) changes |= !contacts[k] != !c->touched[k];
    if (!changes) keep(c, time, sensors);
    for (k = 0; k < NAME_STOPS; k++) {
        if (contacts[k] && !c->touched[k]) c->since[k] = time;
        if (contacts[k] && !c->rested[k] && time - c->since[k] >= NAME_PERSISTS) {
            c->rested[k] = 1;
            set(c, at_event[3 * k + 1], time, 0.0, sensors);
        }
        if (!contacts[k] && c->touched[k]) {
            const double ahead = NAME_READINGS ? (last - time) / 2 : 0.0;
            if (!c->rested[k] || fits(c))
                set(c, at_event[3 * k + (c->rested[k] ? 2 : 0)], time, ahead, sensors);
            c->rested[k] = 0;
        }
        c->touched[k] = contacts[k];
    }
    if (changes) {
        c->n_kept = 0;
        keep(c, time, sensors);
    }
}

static void see_switches(NAME_controller *c, double time, const double *sensors) {
    double x[STATES], z[2 * NAME_SWITCHES + 1];
    int k;
    joined(c, sensors, x);
    guards(x, z);
    for (k = 0; k < NAME_SWITCHES; k++) {
        const int above = z[k] > 0.0;
        if (c->is_begun && c->above[k] && !above && z[NAME_SWITCHES + k] > 0.0)
            set(c, FIRST_SWITCH + k, time, 0.0, sensors);
        c->above[k] = above;
    }
    c->is_begun = 1;
}

void NAME_step(NAME_controller *c, double time, const double *sensors, const int *contacts,
               double *voltages) {
    double x[STATES];
    see_contacts(c, time, sensors, contacts);
    see_switches(c, time, sensors);
    joined(c, sensors, x);
    voltage(x, voltages);
}
"""
