"""Exceptions of the package, each with the data of the failure as attributes."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, cast


class ZenoOrbitsError(Exception):
    """Base class of the package's errors. Each error can be pickled, so workers can raise it."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the recipe for unpickling: some classes do not take the message as argument."""
        return _remade, (type(self), self.args, self.__dict__)


def _remade(kind: type[ZenoOrbitsError], args: tuple[Any, ...], entries: dict[str, Any]) -> Any:
    error = kind.__new__(kind, *args)
    error.__dict__.update(entries)
    return error


class InputError(ZenoOrbitsError, ValueError):
    """An argument, a name or a file is not usable. The message gives the reason in one line."""

    def __str__(self) -> str:
        """Return the message, in which a name from a file or user commands no terminal."""
        return printable(super().__str__().replace("\n", " "))


class SwitchingTimesError(InputError):
    """The switching times of a piecewise input coincide, change order or leave the period.

    Attributes:
        lower: Value of the time that must be lower [s].
        upper: Value of the time that must be higher [s].
    """

    def __init__(self, message: str, lower: float, upper: float) -> None:
        super().__init__(message)
        self.lower, self.upper = lower, upper


def _about_file(kind: str, path: Path, reason: str, remedy: str = "") -> str:
    """Return the message about an unusable file, with the remedy that fits the reason."""
    if reason.startswith("it cannot be read"):
        known = others_beside(path) if _MISSING in reason else ""
        return f"{kind} file `{path}` {reason.removeprefix('it ')}.{known}"
    # A reason that ends in a sentence brings its own remedy.
    rest = "" if reason.endswith(("?", ".")) else f". {remedy}".rstrip()
    return f"{kind} file `{path}`: {reason}{rest}"


_MISSING = "No such file or directory"
_MOST_LISTED = 5


def others_beside(path: Path) -> str:
    """Return what to pass in place of a missing file: a like name, or the files of its kind there.

    Args:
        path: The missing file.
    """
    try:
        stems = sorted(one.stem for one in path.parent.iterdir() if one.suffix == path.suffix)
    except OSError:
        return f" The folder `{path.parent}` is missing, too."
    kind = path.suffix
    near = did_you_mean(path.stem, stems)
    if near:
        return near.replace("`?", f"{kind}`?")
    if not stems:
        return f" The folder `{path.parent}` has no `{kind}` file." if kind else ""
    listed = ", ".join(f"`{shortened(stem)}{kind}`" for stem in stems[:_MOST_LISTED])
    return f" The folder has {listed}{' and others' if len(stems) > _MOST_LISTED else ''}."


def newer_format(number: int, newest: int) -> str:
    """Return the reason why a file of a newer version cannot be read, with the remedy.

    Args:
        number: Format of the file.
        newest: Newest format that this version reads.
    """
    reads = f"the newest this version reads is {newest}"
    return f"its format is {number}, and {reads}. Update zeno_orbits."


class EquationsWarning(UserWarning):
    """The equations may be others than those meant: of another orbit, or of another file."""


class ProblemFileError(InputError):
    """A problem file could not be turned into a problem.

    Attributes:
        path: The file.
        line: The line of the mistake, if it is known.
    """

    def __init__(self, path: Path, reason: str, line: int | None = None) -> None:
        where = f"`{path}`" if line is None else f"`{path}`, line {line}"
        link = " " if line is None and reason.startswith("cannot") else ": "
        end = "" if reason.endswith(("?", ".")) else "."
        super().__init__(f"Problem file {where}{link}{reason}{end}")
        self.path, self.line = path, line


_WRITES_ORBIT = "`search PROBLEM -o FILE` writes orbit files."


class OrbitFileError(InputError):
    """An orbit file could not be read.

    Attributes:
        path: The file.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(_about_file("Orbit", path, reason, _WRITES_ORBIT))
        self.path = path


class MapFileError(InputError):
    """A map file could not be read.

    Attributes:
        path: The file.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(_about_file("Map", path, reason, "`map -o FILE` writes map files."))
        self.path = path


class BoundaryFileError(MapFileError):
    """A file of curves over two parameters could not be read.

    Attributes:
        path: The file.
    """

    def __init__(self, path: Path, reason: str) -> None:
        remedy = "`continue --parameter2 ... -o FILE` writes boundary files."
        InputError.__init__(self, _about_file("Boundary", path, reason, remedy))
        self.path = path


class TranslationError(InputError):
    """A formula uses an operation without an enclosure rule for proofs.

    Attributes:
        operation: Name of the operation.
    """

    def __init__(self, operation: str) -> None:
        wanted = "must be made of analytic operations that the prover has a rule for"
        super().__init__(f"The problem's formulas {wanted}, but one of them is `{operation}`.")
        self.operation = operation


class TableProofError(TranslationError):
    """A formula looks up a table, for which proofs lack a rule."""

    def __init__(self, table: str) -> None:
        super().__init__("call")
        self.args = (
            f"A proof needs analytic formulas, but the problem looks up {table}: prove it with a "
            "polynomial or another formula in place of the table.",
        )


class SimulationError(ZenoOrbitsError):
    """An execution could not be continued.

    Attributes:
        time: Time at which the execution stopped [s].
        state: State at this time, ``(n_x,)``.
        execution: The execution up to its last event (an ``Execution``), or ``None`` without an
            event.
    """

    def __init__(self, reason: str, *, time: float, state: tuple[float, ...]) -> None:
        super().__init__(f"{reason} (at t = {time:.9g} s)")
        self.reason = reason
        self.time = time
        self.state = state
        self.execution: Any = None


class StepLimitError(SimulationError):
    """The execution needs more steps than it may take."""


class UnsettledError(SimulationError):
    """A motion neither repeats nor ends within its time."""


class EventlessError(UnsettledError):
    """A motion strikes no stop and passes no switch within its time."""


class StepSizeError(SimulationError):
    """The step size fell to rounding level, or the flow is not finite any more."""


class RunawayError(SimulationError):
    """A coordinate exceeded the limit of the simulation.

    Attributes:
        coordinate: Name of the coordinate, empty if a speed exceeded its limit.
    """

    def __init__(
        self, reason: str, *, time: float, state: tuple[float, ...], coordinate: str = ""
    ) -> None:
        super().__init__(reason, time=time, state=state)
        self.coordinate = coordinate


class PenetrationError(SimulationError):
    """The state left the admissible set without an impact: the reset map or the state is wrong."""


class SlidingError(SimulationError):
    """The flows on both sides of a switch point to it: the motion slides along the switch.

    Attributes:
        remedy: What to write instead. It ends the message.
    """

    def __init__(
        self, reason: str, *, time: float, state: tuple[float, ...], remedy: str = ""
    ) -> None:
        super().__init__(reason, time=time, state=state)
        self.remedy = remedy
        if remedy:
            self.args = (f"{self}. {remedy}",)


class SimultaneousEventsError(SimulationError):
    """Two events coincide to rounding, or impacts accumulate on two stops at once."""


class ChatterError(SimulationError):
    """Impacts lack a Zeno point within the allowed number, or events of a switch accumulate."""


class CheckpointError(InputError):
    """A folder cannot be used as a checkpoint. It is left unchanged.

    Attributes:
        folder: The folder.
    """

    def __init__(self, folder: Path, reason: str) -> None:
        super().__init__(f"Checkpoint `{folder}` must belong to this work, but {reason}.")
        self.folder = folder


class WorkError(ZenoOrbitsError):
    """Parallel work on processes or machines cannot be finished.

    Attributes:
        trace: Traceback of the error in the worker, empty if no worker sent a traceback.
    """

    def __init__(self, reason: str, *, trace: str = "") -> None:
        super().__init__(reason)
        self.trace = trace


class KernelError(ZenoOrbitsError):
    """A library cannot be compiled or loaded. The message gives the reason as a clause."""


class ProofError(ZenoOrbitsError):
    """A claim could not be proved. It may still be true.

    Attributes:
        claim: Name of the claim.
        reason: The condition that fails, with its values.
    """

    def __init__(self, claim: str, reason: str) -> None:
        super().__init__(f"Not proved: `{claim}`: {reason}.")
        self.claim = claim
        self.reason = reason


class DataFileError(InputError):
    """A file of time series could not be read.

    Attributes:
        path: The file.
        reason: The reason, as a clause.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(_about_file("Data", path, reason))
        self.path, self.reason = path, reason


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a suggestion for the end of a message about an unknown name, or an empty text.

    The suggestion is the successor of a removed name, or else the most similar known name.

    Args:
        name: The unknown name.
        known: The known names.
    """
    # Rarely needed, and start-up counts.
    from difflib import get_close_matches

    from zeno_orbits.aliases import FORMER

    words = {word.casefold(): word for word in known}
    for successor in FORMER.get(name, ()):
        if successor.partition(".")[0].casefold() in words:
            return f" Did you mean `{successor}`?"
    # In names of two letters, such as gains, one letter may be wrong.
    alike = 0.5 if len(name) < 4 else 0.6
    near = get_close_matches(name.casefold(), words, n=1, cutoff=alike)
    if not near and len(name) > 2:
        # A beginning that only one name has is that name.
        near = [word for word in words if word.startswith(name.casefold())]
        near = near if len(near) == 1 else []
    return f" Did you mean `{words[near[0]]}`?" if near else ""


def not_known(name: str, known: Iterable[str], noun: str = "name") -> str:
    """Return the clause about an unknown name: the nearest name first, all known names last.

    Args:
        name: The unknown name.
        known: The known names.
        noun: Noun for a name.
    """
    names = tuple(known)
    listed = ", ".join(names) or "none"
    return f"unknown {noun} `{shortened(name)}`.{did_you_mean(name, names)} Known: {listed}."


def counted(number: int, noun: str) -> str:
    """Return a count with its noun, such as ``1 impact`` or ``2 impacts``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def finite_number(argument: str, value: Any) -> float:
    """Return a finite number as a float.

    Args:
        argument: Name of the argument, for the message.
        value: The value: a number of Python or NumPy.

    Raises:
        InputError: If the value is not a number, or not finite as a double.
    """
    number = any_number(argument, value)
    if not math.isfinite(number):
        raise InputError(
            f"Argument `{argument}` must be a finite number, but it is {shown(value)}."
        )
    return number


def positive_number(argument: str, value: Any) -> float:
    """Return a positive, finite number as a float.

    Args:
        argument: Name of the argument, for the message.
        value: The value: a number of Python or NumPy.

    Raises:
        InputError: If the value is not a number, not finite or not positive.
    """
    number = finite_number(argument, value)
    if number <= 0.0:
        raise InputError(
            f"Argument `{argument}` must be a positive number, but it is {shown(value)}."
        )
    return number


def any_number(argument: str, value: Any) -> float:
    """Return a number as a float, which may be infinite.

    Args:
        argument: Name of the argument, for the message.
        value: The value: a number of Python or NumPy.

    Raises:
        InputError: If the value is not a number.
    """
    # A symbol of CasADi becomes NaN as a float.
    known = getattr(value, "is_constant", None)
    listed = bool(getattr(value, "ndim", 0)) or (callable(known) and not known())
    if not isinstance(value, str | bytes | complex | bool) and not listed:
        try:
            return float(value)
        except (TypeError, ValueError, RuntimeError):
            # CasADi refuses symbols with an error of its own.
            pass
        except OverflowError:
            message = f"Argument `{argument}` must be a finite number, but it is {shown(value)}"
            raise InputError(f"{message}: larger than a double can be.") from None
    raise InputError(f"Argument `{argument}` must be a number, but it is {shown(value)}.")


def number_range(argument: str, box: Any, name: str = "") -> tuple[float, float]:
    """Return the ends of a range.

    Args:
        argument: Name of the argument, for the message.
        box: The range: a lower and an upper end.
        name: Name of the quantity, for the message.

    Raises:
        InputError: If the range is not two numbers.
    """
    try:
        low, high = box
    except (TypeError, ValueError) as error:
        wanted = f"must hold a lower and an upper end{f' for `{name}`' if name else ''}"
        raise InputError(f"Argument `{argument}` {wanted}, but it is {shown(box)}.") from error
    return any_number(argument, low), any_number(argument, high)


def named_numbers(argument: str, values: Any) -> dict[str, Any]:
    """Return a mapping with text keys. Its values are not checked.

    Args:
        argument: Name of the argument, for the message.
        values: The mapping, or None for an empty mapping.

    Raises:
        InputError: If the value is not a mapping, or a name is not a text.
    """
    if values is None:
        return {}
    if not isinstance(values, Mapping):
        wanted = "must map names to values, as {'name': 1.0} does"
        raise InputError(f"Argument `{argument}` {wanted}, but it is {shown(values)}.")
    for name in cast("Mapping[Any, Any]", values):
        if not isinstance(name, str):
            raise InputError(f"Argument `{argument}` must have texts as names, not {shown(name)}.")
    return dict(cast("Mapping[str, Any]", values))


_MOST_SHOWN = 40


def shown(value: Any) -> str:
    """Return a value for a message: on one line, and cut if it is long."""
    if isinstance(value, float):
        return str(value)
    try:
        text = repr(value)
    except ValueError:
        # Python refuses to print integers of thousands of digits.
        text = f"a whole number of {value.bit_length()} bits"
    return f"`{shortened(text)}`"


CONTROLS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")
"""Characters that command a terminal or reorder a text, but for tabs and ends of lines."""


def printable(text: str) -> str:
    """Return a text with escapes in place of characters that command a terminal."""
    return CONTROLS.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def shortened(text: str) -> str:
    """Return a text for a message: on one line, and cut if it is long."""
    text = " ".join(text.split())
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}..."


def require_counts(**counts: int) -> None:
    """Refuse counts below one.

    Args:
        **counts: Counts by the name of their argument.

    Raises:
        InputError: If a count is below one. The message names it.
    """
    for name, count in counts.items():
        if count < 1:
            raise InputError(f"Argument `{name}` must be at least 1, but it is {shown(count)}.")
