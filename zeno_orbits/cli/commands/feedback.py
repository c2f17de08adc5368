"""The command `feedback`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from zeno_orbits import api
from zeno_orbits.cli.options import (
    NO,
    YES,
    Named,
    add_command,
    add_orbit,
    add_shared,
    hand_out,
    say_written,
)
from zeno_orbits.cli.outputs import JSON, PICTURE, PYTHON, require_outputs
from zeno_orbits.cli.parsing import (
    read_input,
    read_multipliers,
    read_named_number,
    read_number,
    read_range,
)
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report


def add_feedback(commands: Any) -> None:
    """Add the command `feedback`."""
    parser = add_command(
        commands,
        "feedback",
        _run_feedback,
        "design inputs that are set once per period and keep an orbit, also one that repels",
        [
            "zeno-orbits feedback orbit.json --input Kd=-1.9:-1.3",
            "zeno-orbits feedback orbit.json --input Kp --input Kd --method deadbeat",
            "zeno-orbits feedback orbit.json --input Kd --extent -o feedback.json",
            "zeno-orbits feedback orbit.json --input Kd --error dtheta1=0.02",
            "zeno-orbits feedback orbit.json --input Kd --method robust "
            "--uncertain restitution=0.4:0.5",
            "zeno-orbits feedback orbit.json --input Kd --machine held.py",
        ],
    )
    add_orbit(parser)
    parser.add_argument(
        "--input",
        "--inputs",
        dest="inputs",
        type=read_input,
        action=Named,
        required=True,
        metavar="NAME[=LOW:HIGH]",
        help="gain or parameter that is held from return to return, and its range (repeatable)",
    )
    parser.add_argument(
        "--section",
        metavar="EVENT",
        help="event at which a period starts and ends, and inputs are set (default: the orbit's)",
    )
    add_shared(
        parser,
        "method",
        ": lqr (least squares), place (chosen multipliers), deadbeat (zero) or robust (least "
        "largest multiplier at the corners of --uncertain) (default: lqr)",
        choices=("lqr", "place", "deadbeat", "robust"),
        default="lqr",
    )
    parser.add_argument(
        "--weight",
        type=read_number,
        metavar="W",
        help="with lqr or robust: cost of a state of its largest value per input of its own "
        "(default: 1e-3)",
    )
    parser.add_argument(
        "--multipliers",
        type=read_multipliers,
        metavar="MU,...",
        help="with place: multipliers of the loop, such as 0.2,0.1 or 0.2+0.1j,0.2-0.1j",
    )
    parser.add_argument(
        "--uncertain",
        action=Named,
        type=read_range,
        metavar="NAME=LOW:HIGH",
        help="range of an uncertain parameter: also compute the loop at the corners of these "
        "ranges, where the law has the centre of the orbit (repeatable)",
    )
    parser.add_argument(
        "--delay", action="store_true", help="apply inputs one return after their measurement"
    )
    parser.add_argument(
        "--extent",
        action="store_true",
        help="also find the disturbances of each coordinate from which the motion returns",
    )
    parser.add_argument(
        "--error",
        "--errors",
        dest="errors",
        type=read_named_number,
        action=Named,
        metavar="NAME=VALUE",
        help="also compute how an error of this size in a coordinate's reading acts on the orbit: "
        "if it is constant, and if it is random with this standard deviation (repeatable)",
    )
    parser.add_argument(
        "--machine",
        type=Path,
        metavar="FILE.py",
        help="write the machine with its feedback here, as a problem file for other commands",
    )
    parser.add_argument("-o", "--output", type=Path, help="write the result here, as JSON")
    parser.set_defaults(picture=None)


def _run_feedback(options: argparse.Namespace) -> int:
    outputs = {"output": JSON, "picture": PICTURE, "machine": PYTHON}
    require_outputs(options, outputs, reads=[options.orbit])
    if options.method == "robust" and not options.uncertain:
        raise InputError("Argument `--method robust` must have --uncertain NAME=LOW:HIGH.")
    if options.method == "place" and not options.multipliers:
        raise InputError("Argument `--method place` must have --multipliers MU,MU of the loop.")
    with report.ProgressLine(options.interrupts.check) as progress:
        found = api.design_feedback(
            options.orbit,
            options.inputs,
            problem=options.problem,
            section=options.section,
            method=options.method,
            weight=options.weight,
            multipliers=options.multipliers,
            delay=options.delay,
            uncertain=options.uncertain,
            on_progress=progress,
        )
        extents = {
            name: found.extent(name, on_progress=progress)
            for name in found.returns.coordinates
            if options.extent
        }
    errors = options.errors
    acts = (found.offset(errors), found.scatter(errors)) if errors else None
    if options.machine is not None:
        found.machine(options.machine)

    def show(_: object) -> None:
        report.print_feedback(found, extents)
        if acts is not None:
            report.print_reading_errors(found, errors, *acts)

    hand_out(options, _Data(found, extents, errors, acts), show)
    say_written(options, [] if options.machine is None else [options.machine])
    return YES if found.robust else NO


class _Data:
    """The data of a feedback, with its disturbances that return and its errors of readings."""

    def __init__(
        self,
        found: Any,
        extents: dict[str, tuple[float, float]],
        errors: dict[str, float],
        acts: tuple[dict[str, float], dict[str, float]] | None,
    ) -> None:
        self._found, self._extents, self._errors, self._acts = found, extents, errors, acts

    def as_json(self) -> dict[str, Any]:
        more: dict[str, Any] = {}
        if self._extents:
            more["extent"] = {name: [*ends] for name, ends in self._extents.items()}
        if self._acts is not None:
            offset, scatter = self._acts
            more["reading_errors"] = {
                "errors": self._errors,
                "offset": offset,
                "scatter": scatter,
            }
        return {**self._found.as_json(), **more}
