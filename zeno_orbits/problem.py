"""A scene: a completed system with named parameters, a gain box and where to start.

A scene is found by its name among the bundled ones, or by the path of a Python file (or of a
folder with a ``model.py``) that defines ``PROBLEM``. ``scene@fidelity`` is a reduced model of it.
"""

from __future__ import annotations

import importlib.util
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import ModuleType

import casadi as ca

from zeno_orbits.errors import InputError, ProblemFileError
from zeno_orbits.hybrid import CompletedSystem


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """A named number of a scene, with its unit and the range in which it makes sense.

    Attributes:
        name: How it is called on the command line and in files.
        unit: SI unit, in brackets in tables; ``1`` for a pure number.
        meaning: One line for the user.
        default: Its value when nobody sets it; ``None`` if the scene derives it from the others.
        lower: Smallest sensible value. For a gain, the lower end of the search box.
        upper: Largest sensible value. For a gain, the upper end of the search box.
        excluded: Values at the ends that are themselves not allowed.
        instead: What to do at an excluded value, as a sentence; it ends the refusal.
    """

    name: str
    unit: str
    meaning: str
    default: float | None
    lower: float = -math.inf
    upper: float = math.inf
    excluded: tuple[float, ...] = ()
    instead: str = ""

    def checked(self, value: float) -> float:
        """Return ``value`` if it is a finite number inside the range, else raise ``InputError``."""
        value = float(value)
        if not math.isfinite(value):
            raise InputError(f"Argument `{self.name}` must be a finite number, but it is {value}.")
        if not self.lower <= value <= self.upper or value in self.excluded:
            message = f"Argument `{self.name}` must {self._range()}, but it is {value:g}."
            helped = f"{message} {self.instead}" if value in self.excluded else message
            raise InputError(helped.rstrip())
        return value

    def _range(self) -> str:
        below, above = math.isfinite(self.lower), math.isfinite(self.upper)
        if not below and not above:
            return f"differ from {', '.join(f'{value:g}' for value in self.excluded)}"
        if not above:
            word = "greater than" if self.lower in self.excluded else "at least"
            return f"be {word} {self.lower:g}"
        if not below:
            word = "less than" if self.upper in self.excluded else "at most"
            return f"be {word} {self.upper:g}"
        left = "(" if self.lower in self.excluded else "["
        right = ")" if self.upper in self.excluded else "]"
        return f"lie in {left}{self.lower:g}, {self.upper:g}{right}"


def positive(
    name: str, default: float | None, unit: str, meaning: str, *, instead: str = ""
) -> Quantity:
    """Return a quantity that must be greater than zero."""
    return Quantity(
        name=name,
        unit=unit,
        meaning=meaning,
        default=default,
        lower=0.0,
        excluded=(0.0,),
        instead=instead,
    )


def restitution(default: float) -> Quantity:
    """Return the coefficient of restitution `e`, in [0, 1)."""
    return Quantity(
        name="restitution",
        unit="1",
        meaning="coefficient of restitution of the stop",
        default=default,
        lower=0.0,
        upper=1.0,
        excluded=(1.0,),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """Numbers for every name of a scene.

    Attributes:
        gains: Name to value, in the scene's order.
        parameters: Name to value, in the scene's order; derived ones included.
    """

    gains: Mapping[str, float]
    parameters: Mapping[str, float]

    def values(self) -> tuple[float, ...]:
        """Return gains, then parameters: the parameter vector of the compiled system."""
        return (*self.gains.values(), *self.parameters.values())

    def number(self, name: str) -> float:
        """Return a gain or a parameter."""
        return self.gains[name] if name in self.gains else self.parameters[name]

    def replaced(self, numbers: Mapping[str, float]) -> Setting:
        """Return a setting with other numbers for some names; what is derived stays as it is."""
        return Setting(
            gains={name: numbers.get(name, value) for name, value in self.gains.items()},
            parameters={name: numbers.get(name, value) for name, value in self.parameters.items()},
        )


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
        """Names of gains, then parameters: the order of the parameter vector."""
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
            derived = self.derive(chosen)
            chosen = {
                quantity.name: quantity.checked(
                    chosen[quantity.name] if quantity.name in chosen else derived[quantity.name]
                )
                for quantity in self.parameters
            }
        return Setting(gains=chosen_gains, parameters=chosen)

    def symbols(self) -> dict[str, ca.SX]:
        """Return one symbol for every gain and parameter, in order."""
        return {name: ca.SX.sym(name) for name in self.names}

    def state_vector(self, named: Mapping[str, float]) -> tuple[float, ...]:
        """Return the state with the named entries, the others zero.

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

    Raises:
        InputError: If there is no such scene or fidelity.
        ProblemFileError: If the file raises or defines no ``PROBLEM``.
    """
    bundled = bundled_problems()
    scene, fidelity = split_fidelity(name_or_path)
    if scene in bundled:
        path = bundled[scene]
    else:
        path = Path(scene)
        if not path.exists():
            raise InputError(_unknown("problem", scene, tuple(bundled)))
    problem = _declared(path)
    return problem.at_fidelity(fidelity) if fidelity is not None else problem


def split_fidelity(name_or_path: str | Path) -> tuple[str, str | None]:
    """Return the scene's name or path, and the word after its ``@`` if there is one.

    A path that exists as it stands keeps its ``@``; a bundled name goes before any path.
    """
    whole = str(name_or_path)
    scene, at, word = whole.rpartition("@")
    if not at or (scene not in bundled_problems() and Path(whole).exists()):
        return whole, None
    return scene, word


def _declared(path: Path) -> Problem:
    file = path / "model.py" if path.is_dir() else path
    problem = getattr(_execute(file), "PROBLEM", None)
    if not isinstance(problem, Problem):
        raise ProblemFileError(file, "it has no `PROBLEM` of type `Problem`")
    return problem


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
        reason = f"it raises {type(error).__name__}: {' '.join(str(error).split())}"
        raise ProblemFileError(file, reason) from error
    return module


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
