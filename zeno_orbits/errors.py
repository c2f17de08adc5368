"""The exceptions of the package: named by the fact, carrying their evidence."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any


class ZenoOrbitsError(Exception):
    """Base of every outcome that keeps a promise from being kept."""


class InputError(ZenoOrbitsError, ValueError):
    """An argument, a name or a file is not usable; the text says which and why."""


def _about_file(kind: str, path: Path, wanted: str, reason: str) -> str:
    """Return why a file is not usable; a file that cannot be read is not told what it must hold."""
    if reason.startswith("it cannot be read"):
        return f"{kind} file `{path}` {reason.removeprefix('it ')}."
    return f"{kind} file `{path}` must {wanted}, but {reason}."


class ProblemFileError(InputError):
    """A problem file could not be turned into a problem.

    Attributes:
        path: The file.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(_about_file("Problem", path, "define a problem", reason))
        self.path = path


class OrbitFileError(InputError):
    """An orbit file could not be read.

    Attributes:
        path: The file.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(_about_file("Orbit", path, "hold a Zeno orbit", reason))
        self.path = path


class MapFileError(InputError):
    """A map file could not be read.

    Attributes:
        path: The file.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(_about_file("Map", path, "hold a map", reason))
        self.path = path


class TranslationError(InputError):
    """A model uses an operation that Taylor's method cannot follow.

    Attributes:
        operation: Its name.
    """

    def __init__(self, operation: str, reason: str) -> None:
        wanted = "must be made of analytic operations for Taylor's method"
        super().__init__(f"Argument `system` {wanted}, but it uses `{operation}`, {reason}.")
        self.operation = operation


class SimulationError(ZenoOrbitsError):
    """An execution could not be continued.

    Attributes:
        time: Where it stopped [s].
        state: The state there, ``(n_x,)``.
        execution: What came before, up to its last event (an ``Execution``); ``None`` if nothing.
    """

    def __init__(self, reason: str, *, time: float, state: tuple[float, ...]) -> None:
        super().__init__(f"{reason} (at t = {time:.9g} s)")
        self.reason = reason
        self.time = time
        self.state = state
        self.execution: Any = None


class StepSizeError(SimulationError):
    """The step size fell to rounding level, or the flow ceased to be finite."""


class RunawayError(SimulationError):
    """A coordinate went farther than the simulation was asked to follow it.

    Attributes:
        coordinate: Its name; empty where a speed grew too fast.
    """

    def __init__(
        self, reason: str, *, time: float, state: tuple[float, ...], coordinate: str = ""
    ) -> None:
        super().__init__(reason, time=time, state=state)
        self.coordinate = coordinate


class PenetrationError(SimulationError):
    """The state left the admissible set without an impact: the reset map or the state is false."""


class ChatterError(SimulationError):
    """The impacts did not settle to a Zeno point within the allowed number."""


class CheckpointError(InputError):
    """A folder cannot keep the finished parts of a work; it is left as it is.

    Attributes:
        folder: The folder.
    """

    def __init__(self, folder: Path, reason: str) -> None:
        super().__init__(f"Checkpoint `{folder}` must belong to this work, but {reason}.")
        self.folder = folder


class WorkError(ZenoOrbitsError):
    """Work that was spread over processes or machines cannot be finished.

    Attributes:
        trace: Where it went wrong in the worker; empty if no worker told.
    """

    def __init__(self, reason: str, *, trace: str = "") -> None:
        super().__init__(reason)
        self.trace = trace


class KernelError(ZenoOrbitsError):
    """Compiled kernels cannot be had; the text says why, as a clause."""


class ProofError(ZenoOrbitsError):
    """A claim could not be proved; that does not make it false.

    Attributes:
        claim: Name of the claim.
        reason: What fails, with the numbers.
    """

    def __init__(self, claim: str, reason: str) -> None:
        super().__init__(f"Not proved: `{claim}`: {reason}.")
        self.claim = claim
        self.reason = reason


class DataFileError(InputError):
    """A file of time series could not be read.

    Attributes:
        path: The file.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(_about_file("Data", path, "hold a recording", reason))
        self.path = path


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a question that ends a message about an unknown name, or nothing.

    Args:
        name: The name that is not known.
        known: The names that are.
    """
    # Rarely needed, and start-up counts.
    from difflib import get_close_matches

    words = {word.casefold(): word for word in known}
    # Of two letters, such as those of gains, one may be wrong.
    alike = 0.5 if len(name) < 4 else 0.6
    near = get_close_matches(name.casefold(), words, n=1, cutoff=alike)
    return f" Did you mean `{words[near[0]]}`?" if near else ""


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, such as ``1 impact`` or ``2 impacts``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
