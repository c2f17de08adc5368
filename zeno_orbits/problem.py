"""A scene: a completed system with named parameters, a gain box and where to start.

A scene is found by its name among the bundled ones, or by the path of a Python file (or of a
folder with a ``model.py``) that defines ``PROBLEM``. ``scene@fidelity`` is a reduced model of it.
"""

from __future__ import annotations

import importlib.util
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import ModuleType

import casadi as ca

from zeno_orbits.drawings import Drawing, lines_of
from zeno_orbits.errors import InputError, ProblemFileError
from zeno_orbits.hybrid import CompletedSystem
from zeno_orbits.imperfections import Rig
from zeno_orbits.quantities import (
    Escape,
    Output,
    Quantity,
    Setting,
    positive,
    require_names,
    require_ranges,
    restitution,
)
from zeno_orbits.soundness import (
    built,
    require_known_symbols,
    require_sound_numbers,
    require_states,
    unused_symbols,
)

__all__ = [
    "Escape",
    "Output",
    "Problem",
    "Quantity",
    "Setting",
    "bundled_problems",
    "load_problem",
    "load_reference",
    "positive",
    "restitution",
    "split_fidelity",
]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """A scene; two are equal if they are the same object, as their functions cannot be compared.

    Attributes:
        name: Its name.
        title: One line for the user.
        source: Where it comes from.
        state_names: Name of each state, ``(n_x,)``, configuration, velocity, currents.
        state_units: Unit of each state.
        parameters: Physical constants; one of them is ``restitution``.
        gains: Feedback gains; their ranges are the default search box. May be empty.
        model: From named symbols (gains and parameters) to the completed system.
        starts: Initial states from which the scene may settle to an orbit, name to value; a state
            that is not named is zero.
        portraits: Pairs of state names to draw against each other.
        amplitude_of: State whose amplitude a search may prescribe.
        derive: From the given and default values to those that have no default.
        reference: A hand-written numeric model of the same scene, if there is one: a function of a
            ``Setting`` that returns a ``HybridDynamics``.
        fidelities: Reduced models of the same scene, by the word after the ``@``. A parameter that
            a reduced model does not have has no influence there.
        escapes: Coordinates that may run away, by name. Others are followed as far as they go.
        outputs: What else is to be drawn over time.
        drawing: How the machine looks, if that is to be seen: its links as lines.
        rig: The parts of a plausible machine, for the virtual rig; ``None`` for a stop alone.
    """

    name: str
    title: str
    source: str
    state_names: tuple[str, ...]
    state_units: tuple[str, ...]
    parameters: tuple[Quantity, ...]
    gains: tuple[Quantity, ...]
    model: Callable[[Mapping[str, ca.SX]], CompletedSystem]
    starts: tuple[Mapping[str, float], ...]
    portraits: tuple[tuple[str, str], ...]
    amplitude_of: str
    derive: Callable[[Mapping[str, float]], Mapping[str, float]] | None = None
    reference: Path | None = None
    fidelities: Mapping[str, Problem] = field(default_factory=dict["str", "Problem"])
    escapes: Mapping[str, Escape] = field(default_factory=dict[str, Escape])
    outputs: tuple[Output, ...] = ()
    drawing: Drawing | None = None
    rig: Rig | None = None

    def __post_init__(self) -> None:
        """Refuse names, units and ranges that cannot be; the model is looked at by `checked`."""
        require_names(self.state_names, self.state_units, (*self.gains, *self.parameters))
        require_ranges(self.gains, self.parameters, derives=self.derive is not None)
        _require_states(self)
        for name in self.escapes:
            if name not in self.state_names:
                raise InputError(_unknown("escapes", name, self.state_names))

    def escaped(self, state: Sequence[float]) -> str:
        """Return the name of a coordinate that has run away, or an empty text.

        Args:
            state: A state, ``(n_x,)``.
        """
        for name, escape in self.escapes.items():
            if abs(state[self.state_names.index(name)]) > escape.beyond:
                return name
        return ""

    def checked(self) -> Problem:
        """Return the scene itself, if its model holds together at its own numbers.

        Raises:
            ValueError: If it does not; the text names the thing at fault.
        """
        symbols = self.symbols()
        system = built(self.model, symbols)
        require_states(system, self.state_names, self.state_units)
        require_known_symbols(system, symbols)
        setting = self.setting()
        looks = [*self.output_formulas(system, symbols), *self.lines(system, symbols).values()]
        unused = unused_symbols(system, symbols, looks)
        for name in unused:
            if not self._derives_from(name, setting):
                kind = "gains" if name in setting.gains else "parameters"
                wanted = "must appear in the model or an output"
                raise ValueError(f"Argument `{kind}` {wanted}, but `{name}` appears nowhere.")
        starts = [self.state_vector(start) for start in self.starts]
        require_sound_numbers(system, symbols, setting.values(), self.state_names, starts)
        for word in self.fidelities:
            self.at_fidelity(word).checked()
        return self

    def output_formulas(
        self, system: CompletedSystem, symbols: Mapping[str, ca.SX]
    ) -> tuple[ca.SX, ...]:
        """Return the expressions of the outputs in the states of a system and named symbols."""
        states = {name: system.state[k] for k, name in enumerate(self.state_names)}
        return tuple(ca.SX(output.formula(states, symbols)) for output in self.outputs)

    def lines(self, system: CompletedSystem, symbols: Mapping[str, ca.SX]) -> dict[str, ca.SX]:
        """Return the lines of the drawing, corners as rows ``(n, 2)`` [m]; none without one."""
        if self.drawing is None:
            return {}
        states = {name: system.state[k] for k, name in enumerate(self.state_names)}
        return lines_of(self.drawing, states, symbols)

    def _derives_from(self, name: str, setting: Setting) -> bool:
        """Tell whether derived parameters change with a parameter."""
        if self.derive is None or name not in setting.parameters:
            return False
        given = {q.name for q in self.parameters if q.default is not None}
        known = {key: value for key, value in setting.parameters.items() if key in given}
        moved = {**known, name: known.get(name, 0.0) * 1.01 + 1e-6}
        try:
            return dict(self.derive(known)) != dict(self.derive(moved))
        except ValueError:
            return True

    def at_fidelity(self, word: str) -> Problem:
        """Return the reduced model of that name; its own name is ``scene@word``.

        Raises:
            InputError: If the scene declares no such model; it lists those that it does.
        """
        if word not in self.fidelities:
            asked = f"{self.name}@{word}"
            if not self.fidelities:
                message = f"must have reduced models for `{asked}`, but `{self.name}` has none"
                raise InputError(f"Argument `problem` {message}.")
            known = (self.name, *(f"{self.name}@{one}" for one in self.fidelities))
            raise InputError(_unknown("problem", asked, known))
        return replace(self.fidelities[word], name=f"{self.name}@{word}", fidelities={})

    def ladder(self) -> tuple[Problem, ...]:
        """Return the scene and its reduced models, as they are declared."""
        return (self, *(self.at_fidelity(word) for word in self.fidelities))

    def shared(self, setting: Setting) -> Setting:
        """Return the numbers of another fidelity's setting for the names that this one has."""
        known = {quantity.name for quantity in self.parameters}
        parameters = {name: value for name, value in setting.parameters.items() if name in known}
        return self.setting(gains=setting.gains, parameters=parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of gains, then of parameters, in the order of the parameter vector."""
        return tuple(quantity.name for quantity in (*self.gains, *self.parameters))

    def setting(
        self,
        *,
        gains: Mapping[str, float] | None = None,
        parameters: Mapping[str, float] | None = None,
    ) -> Setting:
        """Return checked numbers for every name, defaults and derived values filled in.

        Args:
            gains: Gains that differ from their defaults.
            parameters: Parameters that differ from their defaults.

        Raises:
            InputError: If a name is unknown or a value is out of its range.
        """
        chosen_gains = _chosen("gain", self.gains, gains or {}, bounded=False)
        chosen = _chosen("parameter", self.parameters, parameters or {}, bounded=True)
        if self.derive is not None:
            derived = self._derived(chosen)
            chosen = {
                quantity.name: quantity.checked(
                    chosen[quantity.name] if quantity.name in chosen else derived[quantity.name]
                )
                for quantity in self.parameters
            }
        return Setting(gains=chosen_gains, parameters=chosen)

    def _derived(self, chosen: Mapping[str, float]) -> Mapping[str, float]:
        """Return the derived parameters.

        Raises:
            InputError: If numbers so far from each other allow none in double precision.
        """
        if self.derive is None:
            return {}
        try:
            return self.derive(chosen)
        except ArithmeticError as error:
            wanted = f"must be numbers from which `{self.name}` can derive the others"
            raise InputError(
                f"Argument `parameters` {wanted}, but they are not ({error})."
            ) from error

    def symbols(self) -> dict[str, ca.SX]:
        """Return one symbol for every gain and parameter, in order."""
        return {name: ca.SX.sym(name) for name in self.names}

    @property
    def gap_unit(self) -> str:
        """Unit of the gap: of the coordinates whose sum or difference it is, else only ``SI``."""
        system = self.model(self.symbols())
        slopes = ca.jacobian(system.gap, system.state)
        units = set[str]()
        for k, unit in enumerate(self.state_units):
            if not slopes[k].is_zero():
                plain = slopes[k].is_constant() and abs(float(ca.DM(slopes[k]))) == 1.0
                units.add(unit if plain else "SI")
        return units.pop() if len(units) == 1 else "SI"

    def state_vector(self, named: Mapping[str, float]) -> tuple[float, ...]:
        """Return the state with the named entries, the others zero, ``(n_x,)``.

        Args:
            named: State name to value, as in ``starts`` or an orbit's ``release_state``.

        Raises:
            InputError: If a name is not a state of the scene or a value is not finite.
        """
        for name, value in named.items():
            if name not in self.state_names:
                raise InputError(_unknown("state", name, self.state_names))
            if not math.isfinite(value):
                raise InputError(f"Argument `{name}` must be a finite number, but it is {value}.")
        return tuple(float(named.get(name, 0.0)) for name in self.state_names)


def bundled_problems() -> dict[str, Path]:
    """Return name to path of every scene that comes with the package."""
    folder = _problems_folder()
    return {
        path.stem: path
        for path in sorted(folder.iterdir())
        if (path.is_dir() and (path / "model.py").is_file())
        or (path.suffix == ".py" and not path.stem.startswith("_"))
    }


def load_problem(name_or_path: str | Path) -> Problem:
    """Return a scene by its name, or from the Python file (or scene folder) at a path.

    Either may end in ``@fidelity``, for a reduced model that the scene declares.

    A file's model is checked; those of the bundled scenes the tests have checked.

    Args:
        name_or_path: A bundled scene's name, or the path of a file or folder.

    Raises:
        InputError: If there is no such scene or fidelity.
        ProblemFileError: If the file raises, defines no ``PROBLEM`` or one that cannot be.
    """
    bundled = bundled_problems()
    scene, fidelity = split_fidelity(name_or_path)
    if scene in bundled:
        path = bundled[scene]
    else:
        path = Path(scene)
        if not _is_there(path):
            raise InputError(_unknown("problem", scene, tuple(bundled)))
    problem = _declared(path)
    if scene not in bundled:
        _require_sound(path, problem)
    return problem.at_fidelity(fidelity) if fidelity is not None else problem


def _is_there(path: Path) -> bool:
    """Tell whether there is a file or folder; a name that no file can have has none."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def split_fidelity(name_or_path: str | Path) -> tuple[str, str | None]:
    """Return the scene's name or path, and the word after its ``@`` if there is one.

    A path that exists as it stands keeps its ``@``; a bundled name goes before any path.
    """
    whole = str(name_or_path)
    scene, at, word = whole.rpartition("@")
    if not at or (scene not in bundled_problems() and _is_there(Path(whole))):
        return whole, None
    return scene, word


def _declared(path: Path) -> Problem:
    file = path / "model.py" if path.is_dir() else path
    problem = getattr(_execute(file), "PROBLEM", None)
    if not isinstance(problem, Problem):
        raise ProblemFileError(file, "it has no `PROBLEM` of type `Problem`")
    return problem


def _require_sound(path: Path, problem: Problem) -> None:
    try:
        problem.checked()
    except Exception as error:
        file = path / "model.py" if path.is_dir() else path
        raise ProblemFileError(file, _reason(error)) from error


def load_reference(problem: Problem) -> ModuleType:
    """Return the module of a scene's hand-written model.

    Raises:
        InputError: If the scene has none.
    """
    if problem.reference is None:
        raise InputError(
            f"Argument `problem` must have a hand-written reference, but `{problem.name}` has none."
        )
    return _execute(problem.reference)


def _problems_folder() -> Path:
    package = Path(__file__).resolve().parent
    installed = package / "problems"
    return installed if installed.is_dir() else package.parent / "problems"


class _NoCache(SourceFileLoader):
    """Leaves no compiled file beside the user's own."""

    def set_data(self, path: str, data: object, *, _mode: int = 0o666) -> None:
        """Write nothing."""


def _execute(file: Path) -> ModuleType:
    if file.suffix != ".py" or not file.is_file():
        raise ProblemFileError(file, "it is not a Python file")
    name = f"zeno_orbits_scene_{file.parent.name}_{file.stem}".replace("-", "_")
    spec = importlib.util.spec_from_file_location(name, file, loader=_NoCache(name, str(file)))
    if spec is None or spec.loader is None:
        raise ProblemFileError(file, "Python cannot load it")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise ProblemFileError(file, _reason(error)) from error
    return module


def _reason(error: BaseException) -> str:
    """Return an error of a scene's code in one line."""
    text = " ".join(str(error).split())
    return f"it raises {type(error).__name__}: {text}".removesuffix(".")


def _require_states(problem: Problem) -> None:
    """Refuse starts, portraits and an amplitude that name no state."""
    states = problem.state_names
    if not problem.starts:
        raise ValueError("Argument `starts` must hold a state to start from, but it is empty.")
    for argument, named in (
        *(("starts", name) for start in problem.starts for name in start),
        *(("portraits", name) for pair in problem.portraits for name in pair),
        ("amplitude_of", problem.amplitude_of),
    ):
        if named not in states:
            known = ", ".join(states)
            message = f"must name states ({known}), but it names `{named}`"
            raise ValueError(f"Argument `{argument}` {message}.")


def _chosen(
    kind: str, quantities: tuple[Quantity, ...], given: Mapping[str, float], *, bounded: bool
) -> dict[str, float]:
    known = tuple(quantity.name for quantity in quantities)
    for name in given:
        if name not in known:
            raise InputError(_unknown(kind, name, known))
    chosen: dict[str, float] = {}
    for quantity in quantities:
        value = given.get(quantity.name, quantity.default)
        if value is None:
            continue
        if not math.isfinite(value):
            message = f"Argument `{quantity.name}` must be a finite number, but it is {value}."
            raise InputError(message)
        chosen[quantity.name] = quantity.checked(value) if bounded else float(value)
    return chosen


def _unknown(kind: str, name: str, known: tuple[str, ...]) -> str:
    return f"Argument `{kind}` must be one of {', '.join(known) or 'none'}, but it is `{name}`."
