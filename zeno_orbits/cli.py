"""The command line.

Exit codes: 0, yes; 1, searched or checked and the answer is no; 2, wrong usage or input;
130, interrupted.

A command imports what it runs when it runs: `--help` and a mistyped option need no CasADi.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from zeno_orbits import report
from zeno_orbits.arguments import read_boxes, read_count, read_numbers, read_objective, read_seed
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.files import require_picture, require_writable, write_whole
from zeno_orbits.interrupts import Interrupts

if TYPE_CHECKING:
    from zeno_orbits.dynamics import HybridDynamics
    from zeno_orbits.execution import Execution
    from zeno_orbits.orbit import ZenoOrbit
    from zeno_orbits.problem import Problem, Setting
    from zeno_orbits.search import SearchResult
    from zeno_orbits.simulate import SimulationSettings
    from zeno_orbits.verify import VerificationSettings

YES, NO, MISUSE, INTERRUPTED = 0, 1, 2, 130

_PICTURES = ("portraits", "time", "zeno", "region")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    options = _parser().parse_args(arguments)
    try:
        with Interrupts() as interrupts:
            options.interrupts = interrupts
            return options.run(options)
    except InputError as error:
        return _end(error, MISUSE, options)
    except ZenoOrbitsError as error:
        return _end(error, NO, options)
    except BrokenPipeError:
        # The reader has seen enough; nothing is left to flush at the end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return YES
    except KeyboardInterrupt:
        report.print_error("interrupted; nothing was written")
        return INTERRUPTED
    except Exception as error:
        # The last line of defence against a raw traceback.
        if options.debug:
            raise
        text = f"internal error, please report it ({type(error).__name__}: {error}); see --debug"
        report.print_error(text)
        return MISUSE


def _end(error: Exception, code: int, options: argparse.Namespace) -> int:
    if options.debug:
        raise error
    report.print_error(str(error))
    return code


class _Parser(argparse.ArgumentParser):
    """A parser that complains in one line."""

    def error(self, message: str) -> NoReturn:
        """Exit with the code of misuse."""
        report.print_error(f"{message} (see `{self.prog} --help`)")
        sys.exit(MISUSE)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="zeno-orbits",
        description="Find, verify and follow Zeno periodic orbits.",
        epilog=(
            "exit codes: 0 yes; 1 searched or checked, and the answer is no; 2 wrong usage or "
            "input\n\n"
            "example:\n"
            "  zeno-orbits search motor_pendulum -o orbit.json\n"
            "  zeno-orbits verify orbit.json\n"
            "  zeno-orbits plot orbit.json -o pictures"
        ),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_problems(commands)
    _add_conditions(commands)
    _add_simulate(commands)
    _add_fidelity(commands)
    _add_search(commands)
    _add_verify(commands)
    _add_trade(commands)
    _add_plot(commands)
    return parser


def _command(
    commands: Any,
    name: str,
    run: Callable[[argparse.Namespace], int],
    summary: str,
    examples: Sequence[str],
) -> argparse.ArgumentParser:
    """Return the parser of a command, with what all commands share."""
    parser = commands.add_parser(
        name,
        help=summary,
        description=summary[0].upper() + summary[1:] + ".",
        epilog="examples:\n" + "\n".join(f"  {example}" for example in examples),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run)
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    parser.add_argument("--debug", action="store_true", help="show where an error comes from")
    return parser


def _add_scene(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "problem", metavar="PROBLEM", help="a scene's name or Python file, or scene@fidelity"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="change a parameter of the scene; may be repeated",
    )


def _add_start(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--start",
        action="append",
        default=[],
        metavar="STATE=VALUE",
        help="initial state; what is not named is zero; by default the scene's first start",
    )


def _start(problem: Problem, options: argparse.Namespace) -> tuple[float, ...]:
    named = read_numbers(options.start, "start") if options.start else problem.starts[0]
    return problem.state_vector(named)


def _add_accuracy(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--accuracy",
        type=float,
        metavar="A",
        help="take the cheapest settings measured to reach this relative error, 1e-6 for instance, "
        "and report the error that was made; by default as accurate as is cheap",
    )
    parser.add_argument(
        "--engine",
        choices=("automatic", "explicit", "implicit", "taylor"),
        default="automatic",
        help="the integrator; automatic steps explicitly, and implicitly where the scene is stiff; "
        "taylor needs the extra of that name",
    )


def _simulation(options: argparse.Namespace) -> SimulationSettings:
    """Return the simulator's settings for the engine that was asked for."""
    from zeno_orbits.engines import Automatic, Radau, RungeKutta, Taylor
    from zeno_orbits.simulate import SimulationSettings
    from zeno_orbits.translate import load_heyoka

    if options.engine == "taylor":
        load_heyoka()
    engines = {
        "automatic": Automatic,
        "explicit": RungeKutta,
        "implicit": Radau,
        "taylor": Taylor,
    }
    return SimulationSettings(engine=engines[options.engine]())


def _add_gain_values(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--gain",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="change a gain; may be repeated",
    )


def _add_problems(commands: Any) -> None:
    _command(
        commands,
        "problems",
        _run_problems,
        "list the scenes",
        ["zeno-orbits problems", "zeno-orbits problems --json"],
    )


def _run_problems(options: argparse.Namespace) -> int:
    from zeno_orbits.problem import bundled_problems, load_problem

    problems = [one for name in bundled_problems() for one in load_problem(name).ladder()]
    if options.json:
        _print_json([_problem_json(problem) for problem in problems])
    else:
        report.print_problems(problems)
    return YES


def _problem_json(problem: Problem) -> dict[str, Any]:
    return {
        "name": problem.name,
        "title": problem.title,
        "source": problem.source,
        "states": dict(zip(problem.state_names, problem.state_units, strict=True)),
        "gains": {
            gain.name: {"default": gain.default, "lower": gain.lower, "upper": gain.upper}
            for gain in problem.gains
        },
        "parameters": dict(problem.setting().parameters),
    }


def _add_conditions(commands: Any) -> None:
    parser = _command(
        commands,
        "conditions",
        _run_conditions,
        "Theorem 1: d2h/dt2 at the Zeno equilibria, in symbols and numbers",
        [
            "zeno-orbits conditions motor_pendulum",
            "zeno-orbits conditions motor_pendulum --set m2=0.12 -o region.png",
        ],
    )
    _add_scene(parser)
    _add_gain_values(parser)
    parser.add_argument("-o", "--output", type=Path, help="draw the region d2h/dt2 < 0 here")


def _run_conditions(options: argparse.Namespace) -> int:
    from zeno_orbits.problem import load_problem
    from zeno_orbits.symbolic import (
        equilibrium_acceleration,
        six_digits,
        with_numbers,
    )

    problem = load_problem(options.problem)
    setting = _setting(problem, options)
    if options.output is not None:
        require_picture(options.output)
    formula = equilibrium_acceleration(problem)
    numbers = with_numbers(formula, setting)
    always = bool(numbers < 0) if numbers.is_number else None
    if options.json:
        _print_json(
            {
                "problem": problem.name,
                "restitution": setting.parameters["restitution"],
                "formula": str(formula),
                "numbers": six_digits(numbers),
                "coefficients": {
                    str(term): float(factor)
                    for term, factor in numbers.as_coefficients_dict().items()
                },
                "parameters": dict(setting.parameters),
            }
        )
    else:
        report.print_conditions(problem, setting, str(formula), six_digits(numbers), always=always)
    if options.output is not None:
        from zeno_orbits import plots
        from zeno_orbits.compiled import bind
        from zeno_orbits.models import compiled_model

        dynamics = bind(compiled_model(problem), setting.values())
        plots.save_figure(plots.plot_zeno_region(problem, dynamics), options.output)
        _say_written(options, [options.output])
    return NO if always is False else YES


def _add_simulate(commands: Any) -> None:
    parser = _command(
        commands,
        "simulate",
        _run_simulate,
        "follow a completed execution",
        [
            "zeno-orbits simulate motor_pendulum --until 10",
            "zeno-orbits simulate motor_pendulum --start theta1=1.2 --start dtheta2=0.5",
            "zeno-orbits simulate motor_pendulum --set L=1e-6 --accuracy 1e-6",
            "zeno-orbits simulate bouncing_ball --set restitution=0.8 --until 5 --json",
        ],
    )
    _add_scene(parser)
    _add_gain_values(parser)
    _add_accuracy(parser)
    parser.add_argument("--until", type=float, default=10.0, metavar="T", help="how long [s]")
    _add_start(parser)
    parser.add_argument("-o", "--output", type=Path, help="draw the states over time here")


def _run_simulate(options: argparse.Namespace) -> int:
    from zeno_orbits.accuracy import why_engine
    from zeno_orbits.compiled import bind
    from zeno_orbits.models import compiled_model
    from zeno_orbits.problem import load_problem

    problem = load_problem(options.problem)
    setting = _setting(problem, options)
    state = _start(problem, options)
    if options.output is not None:
        require_picture(options.output)
    dynamics = bind(compiled_model(problem), setting.values())
    execution, error = _simulated(options, dynamics, state)
    if options.json:
        accuracy = {} if error is None else {"error": error}
        _print_json(_execution_json(problem, execution) | accuracy)
    else:
        report.print_execution(problem, execution)
        report.print_engine(options.engine, why_engine(dynamics, state), error)
    if options.output is not None:
        from zeno_orbits import plots

        plots.save_figure(plots.plot_time_series(problem, execution), options.output)
        _say_written(options, [options.output])
    return YES


def _simulated(
    options: argparse.Namespace, dynamics: HybridDynamics, state: Sequence[float]
) -> tuple[Execution, float | None]:
    """Return the execution, and its estimated error if an accuracy was asked for."""
    from zeno_orbits.accuracy import simulate_to
    from zeno_orbits.simulate import simulate

    settings = _simulation(options)
    with report.Progress(options.interrupts.check) as progress:

        def tell(time: float) -> None:
            progress.tell("simulating", time / options.until)

        if options.accuracy is None:
            execution = simulate(
                dynamics, state, until=options.until, settings=settings, on_progress=tell
            )
            return execution, None
        assured = simulate_to(
            dynamics,
            state,
            until=options.until,
            accuracy=options.accuracy,
            settings=settings,
            on_progress=tell,
        )
    return assured.execution, assured.error


def _execution_json(problem: Problem, execution: Execution) -> dict[str, Any]:
    from zeno_orbits.execution import Impact, ZenoPoint

    def named(state: Any) -> dict[str, float]:
        return dict(zip(problem.state_names, map(float, state), strict=True))

    events: list[dict[str, Any]] = []
    for event in execution.events:
        if isinstance(event, Impact):
            events.append(
                {
                    "event": "impact",
                    "time": event.time,
                    "approach_rate": event.approach_rate,
                    "state_minus": named(event.state_minus),
                    "state_plus": named(event.state_plus),
                }
            )
        else:
            kind = "zeno_point" if isinstance(event, ZenoPoint) else "release"
            entry = {"event": kind, "time": event.time, "state": named(event.state)}
            if isinstance(event, ZenoPoint):
                entry["error"] = event.error
            events.append(entry)
    return {
        "problem": problem.name,
        "end_time": execution.end_time,
        "end_mode": execution.arcs[-1].mode.value,
        "end_state": named(execution.end_state),
        "events": events,
    }


def _add_fidelity(commands: Any) -> None:
    parser = _command(
        commands,
        "fidelity",
        _run_fidelity,
        "what a scene's reduced models cost in accuracy, before one is taken",
        [
            "zeno-orbits fidelity motor_pendulum",
            "zeno-orbits fidelity motor_pendulum --set L=0.02 --measure --json",
        ],
    )
    _add_scene(parser)
    _add_gain_values(parser)
    parser.add_argument(
        "--measure", action="store_true", help="find the full scene's orbit, too, and compare"
    )


def _run_fidelity(options: argparse.Namespace) -> int:
    from zeno_orbits.fidelity import reduction_costs
    from zeno_orbits.problem import load_problem

    problem = load_problem(options.problem)
    setting = _setting(problem, options)
    costs = list(reduction_costs(problem, setting, measure=options.measure).values())
    if options.json:
        _print_json([asdict(cost) for cost in costs])
    else:
        report.print_costs(costs)
    return YES


def _add_search(commands: Any) -> None:
    parser = _command(
        commands,
        "search",
        _run_search,
        "find gains and initial states of a Zeno periodic orbit, and verify it",
        [
            "zeno-orbits search motor_pendulum -o orbit.json",
            "zeno-orbits search motor_pendulum --fix Kp=4 --fix Kd=-1",
            "zeno-orbits search motor_pendulum --gain Kp=1:5 --fix Kd=-1 --objective period=1.83",
            "zeno-orbits search motor_pendulum --set R=2 --objective energy",
        ],
    )
    _add_scene(parser)
    parser.add_argument(
        "--gain",
        action="append",
        default=[],
        metavar="NAME=LOW:HIGH",
        help="search a gain in this range; one that is not named is searched in the scene's range",
    )
    parser.add_argument(
        "--fix",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="hold a gain; may be repeated",
    )
    parser.add_argument(
        "--objective",
        default="nearest",
        metavar="WISH",
        help=(
            "nearest (to the scene's gains), nearest:Kp=3,Kd=-1, period=SECONDS, "
            "amplitude=VALUE, or energy"
        ),
    )
    parser.add_argument(
        "--allow-unstable", action="store_true", help="take an orbit that does not attract, too"
    )
    _add_accuracy(parser)
    parser.add_argument("--starts", type=read_count, default=12, metavar="N", help="random starts")
    parser.add_argument("--seed", type=read_seed, default=0, help="of the random starts")
    parser.add_argument("-o", "--output", type=Path, help="write the verified orbit here")


def _run_search(options: argparse.Namespace) -> int:
    from zeno_orbits.problem import load_problem
    from zeno_orbits.search import SearchSettings, search_gains
    from zeno_orbits.verify import verify

    problem = load_problem(options.problem)
    fixed = read_numbers(options.fix, "fix")
    boxes = read_boxes(options.gain)
    both = sorted(set(fixed) & set(boxes))
    if both:
        message = f"Argument `gain` must not name a fixed gain, but it names {', '.join(both)}."
        raise InputError(message)
    setting = problem.setting(gains=fixed, parameters=read_numbers(options.set, "set"))
    scene_boxes = {gain.name: (gain.lower, gain.upper) for gain in problem.gains}
    free = {name: box for name, box in {**scene_boxes, **boxes}.items() if name not in fixed}
    objective = read_objective(options.objective, problem, free)
    if options.output is not None:
        require_writable(options.output)
    settings = SearchSettings(n_starts=options.starts, seed=options.seed)
    if options.accuracy is not None:
        settings = settings.for_accuracy(options.accuracy)
    verification = _verification(options, 1e-9)
    found: dict[str, Any] = {}

    def accept(orbit: ZenoOrbit) -> str:
        certificate = verify(orbit, problem, settings=verification)
        if not certificate.passed or not (certificate.stable or options.allow_unstable):
            radius = certificate.spectral_radius
            unstable = f"The orbit does not attract: its spectral radius is {radius:.4g}."
            return unstable if certificate.passed else certificate.verdict()
        found["certificate"] = certificate
        return ""

    with report.Progress(options.interrupts.check) as progress:
        result = search_gains(
            problem,
            setting,
            free_gains=free,
            objective=objective,
            settings=settings,
            accept=accept,
            on_progress=progress.tell,
        )
    return _finish_search(options, problem, result, found)


def _finish_search(
    options: argparse.Namespace, problem: Problem, result: SearchResult, found: dict[str, Any]
) -> int:
    from zeno_orbits.orbit import write_orbit
    from zeno_orbits.verify import certified

    if result.orbit is None:
        if options.json:
            _print_json(
                {
                    "found": False,
                    "status": result.status.value,
                    "detail": result.detail,
                    "attempts": [
                        {"gains": dict(a.gains), "status": a.status.value, "detail": a.detail}
                        for a in result.attempts
                    ],
                }
            )
        else:
            report.print_search(result)
        return NO
    options.interrupts.check()
    certificate = found["certificate"]
    orbit = certified(result.orbit, certificate)
    if options.output is not None:
        write_orbit(orbit, options.output)
    if options.json:
        _print_json(orbit.as_json())
    else:
        report.print_search(result)
        report.print_orbit(problem, orbit, certificate)
        if options.accuracy is not None:
            report.print_error_made(max(result.agreement, certificate.integration_error))
        report.print_verdict(certificate)
        _say_written(options, [] if options.output is None else [options.output])
    return YES


def _add_verify(commands: Any) -> None:
    parser = _command(
        commands,
        "verify",
        _run_verify,
        "check an orbit by forward integration from its file alone",
        [
            "zeno-orbits verify orbit.json",
            "zeno-orbits verify orbit.json --model reference --tolerance 1e-8 --json",
        ],
    )
    _add_orbit(parser)
    parser.add_argument(
        "--tolerance",
        type=float,
        metavar="TOL",
        help="largest relative residual that passes; the accuracy by default, or 1e-9",
    )
    _add_accuracy(parser)
    parser.add_argument(
        "--periods", type=read_count, default=3, metavar="N", help="periods to follow"
    )
    parser.add_argument(
        "--model",
        choices=("derived", "reference"),
        default="derived",
        help="integrate the model derived from energies, or the scene's hand-written one",
    )


def _add_orbit(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("orbit", metavar="ORBIT.json", type=Path, help="an orbit file")
    parser.add_argument(
        "--problem", metavar="FILE.py", help="the scene, where it is not a bundled one"
    )


def _run_verify(options: argparse.Namespace) -> int:
    from zeno_orbits.verify import verify

    tolerance = options.tolerance
    if tolerance is not None and not 0.0 < tolerance < 1.0:
        raise InputError(f"Argument `tolerance` must lie in (0, 1), but it is {tolerance:g}.")
    orbit, problem = _orbit_and_problem(options)
    settings = replace(
        _verification(options, 1e-9 if tolerance is None else tolerance),
        n_periods=options.periods,
        use_reference=options.model == "reference",
    )
    if tolerance is not None:
        settings = replace(settings, tolerance=tolerance)
    with report.Progress(options.interrupts.check) as progress:
        certificate = verify(orbit, problem, settings=settings, on_progress=progress.tell)
    if options.json:
        _print_json(certificate.as_json())
    else:
        report.print_certificate(certificate)
        report.print_verdict(certificate)
        if options.accuracy is not None:
            report.print_error_made(certificate.integration_error)
    return YES if certificate.passed else NO


def _verification(options: argparse.Namespace, tolerance: float) -> VerificationSettings:
    """Return how to check at the accuracy that was asked for, if one was."""
    from zeno_orbits.accuracy import settings_for
    from zeno_orbits.observation import LOOSER
    from zeno_orbits.verify import VerificationSettings

    simulation = _simulation(options)
    if options.accuracy is None:
        return VerificationSettings(tolerance=tolerance, simulation=simulation)
    # The looser of the two integrations has to reach the accuracy, too.
    fine = settings_for(max(options.accuracy / LOOSER, 1e-12), simulation)
    settings_for(options.accuracy)
    return VerificationSettings(tolerance=options.accuracy, simulation=fine)


def _add_trade(commands: Any) -> None:
    parser = _command(
        commands,
        "trade",
        _run_trade,
        "measure what accuracy costs: engines, tolerances, closures, meshes, reduced models",
        [
            "zeno-orbits trade motor_pendulum",
            "zeno-orbits trade motor_pendulum --set L=1e-5 --quick",
            "zeno-orbits trade bouncing_ball --until 1.5 -o trade.json --picture trade.png",
        ],
    )
    _add_scene(parser)
    _add_gain_values(parser)
    _add_start(parser)
    parser.add_argument("--until", type=float, metavar="T", help="how long an execution [s]")
    parser.add_argument("--quick", action="store_true", help="a first look: few settings, one run")
    parser.add_argument("--picture", type=Path, help="draw the work-precision diagram here")
    parser.add_argument("-o", "--output", type=Path, help="write all figures here, as JSON")


def _run_trade(options: argparse.Namespace) -> int:
    from zeno_orbits.problem import load_problem
    from zeno_orbits.trade import QUICK, TradeSettings, trade

    problem = load_problem(options.problem)
    setting = _setting(problem, options)
    state = _start(problem, options)
    if options.output is not None:
        require_writable(options.output)
    if options.picture is not None:
        require_picture(options.picture)
    settings = QUICK if options.quick else TradeSettings()
    if options.until is not None:
        settings = replace(settings, until=options.until)
    with report.Progress(options.interrupts.check) as progress:
        found = trade(problem, setting, state, settings=settings, tell=progress.tell)
    written: list[Path] = []
    if options.output is not None:
        write_whole(options.output, (_json(found.as_json()) + "\n").encode())
        written.append(options.output)
    if options.picture is not None:
        from zeno_orbits import plots

        plots.save_figure(plots.plot_trade(found), options.picture)
        written.append(options.picture)
    if options.json:
        _print_json(found.as_json())
    else:
        report.print_trade(found)
    _say_written(options, written)
    return YES


def _add_plot(commands: Any) -> None:
    parser = _command(
        commands,
        "plot",
        _run_plot,
        "draw an orbit",
        [
            "zeno-orbits plot orbit.json -o pictures",
            "zeno-orbits plot orbit.json --kind portraits --format pdf",
        ],
    )
    _add_orbit(parser)
    parser.add_argument(
        "--kind",
        action="append",
        choices=_PICTURES,
        help="which picture: phase portraits, states over time, zoom into the Zeno point, "
        "region d2h/dt2 < 0; may be repeated; all by default",
    )
    parser.add_argument("--format", choices=("png", "pdf", "svg"), default="png")
    parser.add_argument(
        "--periods", type=read_count, default=1, metavar="N", help="periods to draw"
    )
    parser.add_argument("-o", "--output", type=Path, default=Path(), help="folder for the pictures")


def _run_plot(options: argparse.Namespace) -> int:
    from zeno_orbits import plots
    from zeno_orbits.simulate import simulate
    from zeno_orbits.verify import problem_dynamics

    orbit, problem = _orbit_and_problem(options)
    dynamics = problem_dynamics(orbit, problem)
    if options.output.exists() and not options.output.is_dir():
        raise InputError(f"Argument `output` must be a folder, but `{options.output}` is a file.")
    release = problem.state_vector(orbit.release_state)
    # A little longer, so that rounding does not cut off the last release.
    horizon = options.periods * orbit.period * (1 + 1e-6)
    execution = simulate(dynamics, release, until=horizon)
    draw = {
        "portraits": lambda: plots.plot_portraits(problem, execution),
        "time": lambda: plots.plot_time_series(problem, execution),
        "zeno": lambda: plots.plot_zeno_zoom(problem, execution, dynamics),
        "region": lambda: plots.plot_zeno_region(problem, dynamics, execution),
    }
    try:
        options.output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        message = (
            f"Argument `output` must be a folder that can be made, but `{options.output}` is not"
        )
        raise InputError(f"{message} ({error.strerror}).") from error
    paths = [options.output / f"{kind}.{options.format}" for kind in options.kind or _PICTURES]
    for path in paths:
        require_writable(path)
        plots.save_figure(draw[path.stem](), path)
    if options.json:
        _print_json({"pictures": [str(path) for path in paths]})
    else:
        _say_written(options, paths)
    return YES


def _orbit_and_problem(options: argparse.Namespace) -> tuple[ZenoOrbit, Problem]:
    from zeno_orbits.orbit import read_orbit
    from zeno_orbits.problem import bundled_problems, load_problem, split_fidelity

    orbit = read_orbit(options.orbit)
    scene, fidelity = split_fidelity(orbit.problem)
    if options.problem is not None:
        problem = load_problem(options.problem)
        if fidelity is not None and problem.name == scene:
            problem = problem.at_fidelity(fidelity)
        if problem.name != orbit.problem:
            wanted = f"must be the scene `{orbit.problem}` of the orbit"
            raise InputError(f"Argument `problem` {wanted}, but it is `{problem.name}`.")
        return orbit, problem
    if scene not in bundled_problems():
        message = f"Argument `problem` must name the file of scene `{scene}`, but it is missing."
        raise InputError(message)
    return orbit, load_problem(orbit.problem)


def _setting(problem: Problem, options: argparse.Namespace) -> Setting:
    return problem.setting(
        gains=read_numbers(options.gain, "gain"), parameters=read_numbers(options.set, "set")
    )


def _print_json(data: Any) -> None:
    print(_json(data))


def _json(data: Any) -> str:
    import json

    return json.dumps(data, indent=2, allow_nan=False)


def _say_written(options: argparse.Namespace, paths: Sequence[Path]) -> None:
    if not options.json:
        report.print_lines(f"Written: {path}" for path in paths)
