"""The types of `loop.h`, and its functions with their arguments."""

from __future__ import annotations

import ctypes
from typing import Any

MOST, LANES, STAGES = 32, 8, 7
FREE, LOCKED, FLIGHT = range(3)
RATE, GUARD, JACOBIAN, WATCHED = 0, 3, 6, 9
GAP, LIFT, PULL, INERTIA, REBOUND, RESTING, LANDING, LONGEST = range(12, 20)
TAPES = LONGEST + 3
SLOPES = 7
EXTRAPOLATION, PASSAGE, TRUNCATION, FIXED_IMPACTS, PLASTIC_AFTER = range(5)
STEP_WIDTH, ARC_WIDTH, EVENT_WIDTH, ESTIMATE_WIDTH = 2, 14, 6, 4
IMPACT, ZENO, RELEASE, HORIZON, SWITCH = range(5)

DONE, FULL, ESTIMATES, CURVE, TOO_STIFF, SINGULAR, NOT_FINITE, LEFT = range(8)
MANY_STEPS, MANY_IMPACTS, BEYOND, GROWS, NOT_CLOSING, INTO_STOP, TOO_LARGE = range(8, 15)
MODE, INSIDE, SLIDES, COINCIDE, SPLITS, TOGETHER, IN_TURN = range(15, 22)
ACCUMULATE, UNDEFINED, UNDETERMINED, BY_SWITCH, ARMED, UNORDERED = range(22, 28)
BEYOND_LAW, MANY_SWITCHES = 28, 29

CLOSED, OPEN, ASKS = range(3)

GUARDS, STOPS, ORDERS = 16, 8, 64

_number, _count, _address = ctypes.c_double, ctypes.c_longlong, ctypes.c_void_p


class TapeType(ctypes.Structure):
    """A formula: ``zl_tape``."""

    _fields_ = [
        *((name, _count) for name in ("n_varying", "n_parameters", "n_constants", "n_registers")),
        *((name, _count) for name in ("n_once", "n_first", "n_instructions", "n_outputs")),
        *((name, _address) for name in ("code", "constants", "outputs", "tables")),
    ]


class SchemeType(ctypes.Structure):
    """The implicit scheme: ``zl_scheme``."""

    _fields_ = [
        ("nodes", _number * STAGES),
        ("inverse", _number * (STAGES * STAGES)),
        ("monomials", _number * (STAGES * STAGES)),
        ("gamma", _number),
        ("embedded", _number * STAGES),
        ("values", _number * 8),
        ("columns", _number * (8 * STAGES)),
        ("rows", _number * (8 * STAGES)),
    ]


class ProblemType(ctypes.Structure):
    """The formulas of a problem: ``zl_problem``."""

    _fields_ = [
        *((name, _count) for name in ("n_x", "n_q", "n_p")),
        ("carried", _count * 3),
        ("tapes", TapeType * TAPES),
        ("scheme", _address),
        ("graph", _address),
        ("formulas", _count),
        ("code", _address),
    ]


class CodeType(ctypes.Structure):
    """Compiled formulas: ``zl_code``."""

    _fields_ = [("one", _address), ("lanes", _address)]


class SideType(ctypes.Structure):
    """The guard of a switch on one side of it: ``zl_side``."""

    _fields_ = [("place", _count), ("value", TapeType), ("bounds", TapeType)]


class GraphType(ctypes.Structure):
    """A graph of modes: ``zl_graph``."""

    _fields_ = [
        *((name, _count) for name in ("n_stops", "n_declared", "n_switches", "n_views", "n_sides")),
        ("n_frictional", _count),
        *((name, _count) for name in ("n_numbers", "switches_place", "delassus_place")),
        *((name, _count) for name in ("orders_place", "first_clock", "end_clock")),
        *((name, TapeType) for name in ("switches", "delassus", "orders")),
        *((name, _address) for name in ("resets", "reset_places", "causes")),
        *((name, _address) for name in ("view_keys", "view_places")),
        *((name, _address) for name in ("views", "side_keys", "sides")),
    ]


class OutlookType(ctypes.Structure):
    """What a run looks at: ``zl_outlook``."""

    _fields_ = [(name, _count) for name in ("rest", "focus", "sides", "above", "splits")]


def mode_key(closed: int, sides: int) -> int:
    """Return the key of a mode: ``ZL_MODE_KEY``. Both are bits."""
    return sides << STOPS | closed


def view_key(mode: int, stop: int) -> int:
    """Return the key of an open stop of a mode: ``ZL_VIEW_KEY``."""
    return mode << 5 | stop


def side_key(mode: int, switch: int, positive: int) -> int:
    """Return the key of a side of a switch in a mode: ``ZL_SIDE_KEY``.

    Args:
        mode: Index of the mode.
        switch: Index of the switch.
        positive: 1 for the side where the switching function is positive, otherwise 0.
    """
    return mode << 5 | switch << 1 | positive


_SETTINGS = (
    *("until", "relative", "absolute", "contact", "restitution", "time", "gap", "gap_rate"),
    *("gap_acceleration", "multiplier", "largest_explicit", "largest_implicit", "limit_tolerance"),
    *("resolved", "delta", "n_fixed", "most_releases", "most_landings"),
)


class SettingsType(ctypes.Structure):
    """Accuracy and limits of a run: ``zl_settings``."""

    _fields_ = [
        *((name, _number) for name in _SETTINGS),
        *((name, _number * MOST) for name in ("sizes", "weights", "flight_weights", "reach")),
        *((name, _count) for name in ("begins_explicit", "goes_implicit", "completion")),
        *((name, _count) for name in ("most_steps", "most_impacts", "records", "past")),
        ("varies", _count),
    ]


class RecordsType(ctypes.Structure):
    """Memory for records: ``zl_records``."""

    _fields_ = [
        *((name, _address) for name in ("steps", "polynomials", "arcs", "events")),
        *((name, _count) for name in ("most_steps", "most_polynomials", "most_arcs")),
        *((name, _count) for name in ("most_events", "n_steps", "n_polynomials", "n_arcs")),
        ("n_events", _count),
        ("estimates", _address),
        ("most_estimates", _count),
    ]


class TangentType(ctypes.Structure):
    """Derivatives of the formulas of a problem: ``zl_tangent``."""

    _fields_ = [
        ("n_chosen", _count),
        ("tapes", TapeType * SLOPES),
        *((name, _address * 3) for name in ("rows", "columns", "states", "ends")),
        ("n_blocks", _count * 3),
        ("matrix", _number * (STAGES * STAGES)),
    ]


class TrackType(ctypes.Structure):
    """Settings of the propagation of derivatives: ``zl_track``."""

    _fields_ = [
        *((name, _address) for name in ("steps", "polynomials", "arcs", "events")),
        *((name, _count) for name in ("n_arcs", "n_events")),
        ("trusted", _number),
        *((name, _address) for name in ("restitution", "estimates", "work")),
    ]


class DetailType(ctypes.Structure):
    """Details of a status: ``zl_detail``."""

    _fields_ = [
        ("time", _number),
        ("state", _number * MOST),
        *((name, _number) for name in ("number", "steps")),
        *((name, _count) for name in ("n_state", "index")),
        ("about", _count * 4),
    ]


class PairType(ctypes.Structure):
    """Two motions side by side: ``zl_pair``."""

    _fields_ = [
        *((name, _number) for name in ("turn", "distance", "vanished", "started")),
        *((name, _number * MOST) for name in ("first", "other", "direction", "scale")),
        ("in_clock", _count * MOST),
        *((name, _count) for name in ("moves", "n_turns", "n_rates", "closed", "sides")),
        ("rates", _address),
    ]


class ClosingType(ctypes.Structure):
    """Newton's method of a return: ``zl_closing``."""

    _fields_ = [
        *((name, _number) for name in ("guess", "exact", "trusted")),
        *((name, _number * MOST) for name in ("start", "sizes")),
        *((name, _count) for name in ("section", "n_returns")),
        *((name, _address) for name in ("settings", "p", "shifts", "work")),
        ("period", _number),
        *((name, _number * MOST) for name in ("end", "scale")),
        ("by_state", _number * (MOST * MOST)),
        *((name, _count) for name in ("n_arcs", "n_events")),
    ]


def declared(library: Any) -> Any:
    """Return the library with the types of its functions declared."""
    pointer, whole = ctypes.c_void_p, ctypes.c_int
    functions: dict[str, tuple[Any, list[Any]]] = {
        "zl_size": (_count, [pointer]),
        "zl_begin": (whole, [pointer] * 5),
        "zl_resume": (whole, [pointer] * 3),
        "zl_turns": (whole, [*[pointer] * 4, ctypes.c_longlong]),
        "zl_answer": (None, [pointer, whole, _number, _number, pointer]),
        "zl_tell": (None, [pointer] * 2),
        "zl_now": (_number, [pointer] * 4),
        "zl_states_at": (
            None,
            [pointer, pointer, whole, _number, pointer, pointer, ctypes.c_longlong, pointer],
        ),
        "zl_flight": (
            whole,
            [pointer, pointer, pointer, _number, _number, _number, pointer],
        ),
        "zl_evaluate": (None, [pointer, pointer, whole, pointer, pointer]),
        "zl_room": (_count, [pointer]),
        "zl_outlook_of": (None, [pointer] * 2),
        "zl_copy": (None, [pointer] * 3),
        "zl_tangent_work": (_count, [pointer] * 2),
        "zl_follow": (_count, [*[pointer] * 4, whole, pointer]),
        "zl_close": (whole, [pointer] * 7),
        "zl_course": (None, [*[pointer] * 4, whole, *[pointer] * 4]),
        "zl_fault": (whole, [pointer]),
        "zl_begin_leg": (whole, [*[pointer] * 5, whole, _number, _number]),
        "zl_resume_leg": (whole, [pointer] * 3),
    }
    for name, (result, arguments) in functions.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library
