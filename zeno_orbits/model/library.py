"""A problem as text that another process can load: its file, and the contents of the file."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
import stat
import sys
import warnings
from collections.abc import Generator, Mapping
from contextlib import chdir, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any

from zeno_orbits.errors import (
    EquationsWarning,
    InputError,
    ProblemFileError,
    others_beside,
    shortened,
)
from zeno_orbits.model.declared.origin import with_origin
from zeno_orbits.model.declared.quantities import unknown
from zeno_orbits.model.mistakes import account_of
from zeno_orbits.model.problem import Problem
from zeno_orbits.work import others_may_write, read_object

_MOST = 16
"""Number of problems cached per process, with their compiled models."""


def bundled_problems() -> dict[str, Path]:
    """Return name to path of every problem that comes with the package."""
    return dict(_problems_in(_problems_folder()))


@lru_cache(maxsize=1)
def _problems_in(folder: Path) -> tuple[tuple[str, Path], ...]:
    """Return name and path of the problems in a folder. That of the package does not change."""
    return tuple(
        (path.stem, path)
        for path in sorted(folder.iterdir())
        if (path.is_dir() and (path / "model.py").is_file())
        or (path.suffix == ".py" and not path.stem.startswith("_"))
    )


def load_problem(name_or_path: str | Path) -> Problem:
    """Return a problem by its name, or from the Python file (or problem folder) at a path.

    Either may end in ``@fidelity``, for a reduced model that the problem declares.

    A bundled name is the bundled problem. If the current folder holds a problem of that name, an
    `EquationsWarning` gives the path to pass for it.

    The model of a file is checked. The models of the bundled problems were checked by the tests.

    Args:
        name_or_path: A bundled problem's name, or the path of a file or folder.

    Raises:
        InputError: If the problem or fidelity does not exist.
        ProblemFileError: If the file raises, defines no ``PROBLEM`` or an invalid problem.
    """
    _tell_of_namesake(split_fidelity(name_or_path)[0])
    return _of_word(name_or_path)


def _tell_of_namesake(name: str) -> None:
    """Issue a warning if the current folder holds another problem with a bundled name."""
    path = bundled_problems().get(name)
    if path is None:
        return
    own = path / "model.py" if path.is_dir() else path
    for file, word in ((f"{name}.py", f"{name}.py"), (f"{name}/model.py", f"./{name}")):
        if _is_there(Path(file)) and not Path(file).samefile(own):
            text = f"`{name}` is the bundled problem. For the file in this folder, pass `{word}`."
            warnings.warn(text, EquationsWarning, stacklevel=3)


def _of_word(name_or_path: str | Path) -> Problem:
    """Return the problem that `load_problem` describes, without a warning."""
    bundled = bundled_problems()
    name, fidelity = split_fidelity(name_or_path)
    if name in bundled:
        path = bundled[name]
    else:
        path = Path(name)
        if not _is_there(path):
            if path.suffix == ".py":
                reason = "cannot be read (No such file or directory)."
                raise ProblemFileError(path, f"{reason}{others_beside(path)}")
            if _is_there(Path(f"{name}.py")):
                raise InputError(f"Unknown problem `{name}`. For the file, pass `{name}.py`.")
            raise InputError(unknown("problem", name, tuple(bundled)))
    if name in bundled:
        problem = _bundled(path)
    else:
        problem = _declared(path)
        _require_sound(path, problem)
    return problem.at_fidelity(fidelity) if fidelity is not None else problem


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedFile:
    """The problem file that a result names. The text comes from data, so it may be hostile.

    Attributes:
        path: Absolute path of the file, or of the folder of the problem.
        near: True if the file lies beside the file of the result, or if the result was computed in
            this process from the file.
    """

    path: str
    near: bool

    @classmethod
    def of(cls, problem: Problem) -> RecordedFile | None:
        """Return the file of a problem, or None if it is bundled or lacks a file."""
        if problem.origin is None:
            return None
        word, _ = split_fidelity(getattr(problem.origin.file, "word", ""))
        return None if not word or word in bundled_problems() else cls(path=word, near=True)

    @classmethod
    def beside(cls, folder: Path, text: str) -> RecordedFile | None:
        """Return the file that an entry of a result names.

        Args:
            folder: Folder of the file of the result.
            text: The entry: a path relative to the folder, or an absolute path.
        """
        if not text:
            return None
        near = Path(text).name == text and text not in (".", "..")
        return cls(path=os.path.normpath(folder.absolute() / text), near=near)

    def relative_to(self, folder: Path) -> str:
        """Return the entry of a result in a folder: the path relative to the folder."""
        try:
            path = os.path.relpath(os.path.realpath(self.path), os.path.realpath(folder))
        except ValueError:
            # Two drives of Windows.
            return Path(self.path).as_posix()
        return Path(path).as_posix()

    def trusted(self) -> Path:
        """Return the file if it may be run without being named by the caller.

        It lies beside the result or in the current folder, is not a link, and nobody else may
        change it.

        Raises:
            InputError: Otherwise. The message gives the reason and the remedy.
        """
        own = Path(self.path)
        places = [own] if self.near else []
        if own.name and Path.cwd() / own.name not in places:
            places.append(Path.cwd() / own.name)
        reasons: list[tuple[str, Path]] = []
        for path in places:
            reason = _reason_not_to_run(path)
            if not reason:
                return path
            if reason != _MISSING:
                reasons.append((reason, path))
        if not reasons and not self.near and _is_there(own):
            reasons.append(("it is in another folder", own))
        clause, file = f"`{shortened(own.name)}` is missing", "FILE.py"
        if reasons:
            reason, path = reasons[0]
            clause = f"`{shortened(own.name)}` is not run unless you name it, since {reason}"
            file = _typable(str(path))
        raise InputError(f"{clause}: pass --problem {file} (`problem=` in Python)")


_MISSING = "it is missing"


def _reason_not_to_run(path: Path) -> str:
    """Return why a file or folder of a problem is not run unasked, as a clause, or no text."""
    files = [path]
    try:
        if stat.S_ISDIR(path.lstat().st_mode):
            files += sorted(path.glob("*.py"))
        folder = path.parent.stat()
        for file in files:
            kind = file.lstat().st_mode
            if not (stat.S_ISREG(kind) or (file is path and stat.S_ISDIR(kind))):
                return "it is a link or a device"
            if others_may_write(file):
                return "another user owns it or may write to it"
        if not folder.st_mode & stat.S_ISVTX and others_may_write(path.parent):
            return "another user may write to its folder"
        # A script of the user's that is no model must not run because data name it.
        if not any(b"PROBLEM" in one.read_bytes() for one in files if one.is_file()):
            return "it defines no `PROBLEM`"
    except FileNotFoundError:
        return _MISSING
    except (OSError, ValueError):
        return "it cannot be read"
    return "" if hasattr(os, "geteuid") else "its owner is unknown on this system"


def recorded_problem(
    word: str,
    given: Problem | None = None,
    *,
    result: str = "orbit",
    file: RecordedFile | None = None,
) -> Problem:
    """Return the problem of a result, whose file is data and never runs code by itself.

    The text that a result records is compared with names and is not used as a path. So a file of
    results can load a bundled problem only. Another problem comes from the caller, or from the
    file that the result records if `RecordedFile.trusted` accepts it. A result that records a file
    is not a result of a bundled problem.

    Args:
        word: The name in the result.
        given: The problem that the caller gives, or None.
        result: Noun for the result, for the message.
        file: The problem file that the result records, or None.

    Raises:
        InputError: If the given problem has another name, or no problem is given and the recorded
            file is missing or not trusted, or no file is recorded and the name is not bundled.
    """
    name, at, fidelity = str(word).partition("@")
    said = f"`{shortened(str(word))}`"
    if given is None:
        given = _found(name, said, file)
    if at and given.name == name:
        given = given.at_fidelity(fidelity)
    if given.name != word:
        wanted = f"must be the problem {said} of the {result}"
        raise InputError(f"Argument `problem` {wanted}, but it is `{given.name}`.")
    return given


def _found(name: str, said: str, file: RecordedFile | None) -> Problem:
    """Return the problem of a recorded file, or without one the bundled problem of a name.

    A result that records a file belongs to that file, even if a bundled problem has its name.

    Raises:
        InputError: If there is neither.
    """
    remedy = "If it is yours, pass its file with --problem FILE.py (`problem=` in Python)."
    if file is None:
        if name in bundled_problems():
            return _bundled(bundled_problems()[name])
        raise InputError(f"Unknown problem {said}. {remedy}")
    try:
        path = file.trusted()
    except InputError as error:
        raise InputError(f"Problem {said}: its file {error}.") from None
    return locate_problem(path).load()


def _typable(path: str) -> str:
    """Return a path as a word of a command, or a placeholder if a shell could misread the path."""
    with suppress(ValueError):
        path = min(path, os.path.relpath(path), key=len)
    return path if _PLAIN.fullmatch(path) else "FILE.py"


_PLAIN = re.compile(r"[\w./@+-]+", flags=re.ASCII)


def _is_there(path: Path) -> bool:
    """Return True if there is a file or folder of that name."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def split_fidelity(name_or_path: str | Path) -> tuple[str, str | None]:
    """Return the problem's name or path, and the word after its ``@`` if it has one.

    An existing path keeps its ``@``. A bundled name takes precedence over any path.
    """
    whole = str(name_or_path)
    name, at, word = whole.rpartition("@")
    if not at or (name not in bundled_problems() and _is_there(Path(whole))):
        return whole, None
    return name, word


@lru_cache(maxsize=_MOST)
def _bundled(path: Path) -> Problem:
    """Return a problem that comes with the package, the same object every time in one process."""
    return _declared(path)


def _declared(path: Path) -> Problem:
    file = path / "model.py" if path.is_dir() else path
    if not _is_there(file):
        others = sorted(one.name for one in path.glob("*.py"))[:3] if path.is_dir() else []
        known = f". It has {', '.join(f'`{path / one}`' for one in others)}" if others else ""
        raise ProblemFileError(path, f"it is a folder without `model.py`{known}")
    problem = getattr(_execute(file), "PROBLEM", None)
    if not isinstance(problem, Problem):
        raise ProblemFileError(
            file, "it lacks a `PROBLEM` of type `Problem`. Write `PROBLEM = zo.Problem(...)`"
        )
    bundled = bundled_problems()
    word = path.stem if bundled.get(path.stem) == path else str(path.resolve())
    return with_origin(problem, ProblemFile(word=word, digest=_digest(word)))


def _require_sound(path: Path, problem: Problem) -> None:
    try:
        with _numpy_welcome():
            problem.checked()
    except (Exception, SystemExit) as error:
        file = path / "model.py" if path.is_dir() else path
        raise ProblemFileError(file, *account_of(error, file)) from error


@lru_cache(maxsize=_MOST)
def load_reference(problem: Problem) -> ModuleType:
    """Return the module of a problem's hand-written model, read once for each problem.

    Raises:
        InputError: If the problem lacks a hand-written model.
        ProblemFileError: If its file does not load.
    """
    if problem.reference is None:
        raise InputError(
            f"Argument `problem` must have a hand-written model, but `{problem.name}` lacks it. "
            "Leave the reference (`--model reference`) out."
        )
    return _execute(problem.reference)


@lru_cache(maxsize=1)
def _problems_folder() -> Path:
    package = Path(__file__).resolve().parents[1]
    installed = package / "problems"
    return installed if installed.is_dir() else package.parent / "problems"


def _about_no_python(file: Path) -> str:
    """Return the message about a file that is not Python: it may be a result about a problem."""
    with suppress(ValueError, OSError):
        content = read_object(file) if file.suffix == ".json" else {}
        named, recorded = content.get("problem"), content.get("problem_file")
        if isinstance(named, str):
            name = shortened(named)
            own = recorded if isinstance(recorded, str) else name
            return (
                f"it is a result about the problem `{name}`. Give `{shortened(own)}` in its place"
            )
    if file.suffix in (".csv", ".tsv", ".txt"):
        return (
            "it is not a Python file. Write the problem (a name or NAME.py) or the orbit first, "
            "and the recording after it"
        )
    return "it is not a Python file: a problem is a name of `problems` or a file `NAME.py`"


class _NoCache(SourceFileLoader):
    """Loader that writes no compiled file next to the user's file."""

    def set_data(self, path: str, data: object, *, _mode: int = 0o666) -> None:
        """Write nothing."""


def _execute(file: Path) -> ModuleType:
    if file.suffix != ".py" or not file.is_file():
        raise ProblemFileError(file, _about_no_python(file))
    name = f"zeno_orbits_problem_{file.parent.name}_{file.stem}".replace("-", "_")
    spec = importlib.util.spec_from_file_location(name, file, loader=_NoCache(name, str(file)))
    if spec is None or spec.loader is None:
        raise ProblemFileError(file, "Python cannot load it")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        # Paths that the user typed remain valid.
        with _same_folder(), _numpy_welcome():
            spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise ProblemFileError(file, *account_of(error, file)) from error
    return module


@contextmanager
def _numpy_welcome() -> Generator[None, None, None]:
    """Let functions of NumPy take symbols without CasADi's warnings: their results are symbols."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"\s*casadi: a numpy function", FutureWarning)
        yield


@contextmanager
def _same_folder() -> Generator[None, None, None]:
    """Return to the current folder at the end. A folder that was deleted is left as it is."""
    try:
        here = Path.cwd()
    except OSError:
        yield
        return
    with chdir(here):
        yield


@dataclass(frozen=True, slots=True, kw_only=True)
class ProblemFile:
    """The file of a problem, which other processes can load.

    Attributes:
        word: Its name, or the absolute path of its file, with ``@fidelity`` if it has one.
        digest: Digest of the source.
    """

    word: str
    digest: str

    def load(self) -> Problem:
        """Return the problem, which is the same object in all calls of a process.

        Raises:
            InputError: If its file is missing on this machine, or differs.
        """
        return _loaded(self)

    def restored(self, changes: Mapping[str, Any]) -> Problem:
        """Return the problem with changes of some fields, for `pickle`.

        Args:
            changes: New values of the fields by name.

        Raises:
            InputError: If its file is missing on this machine, or differs.
        """
        return replace(self.load(), **changes) if changes else self.load()

    def reduced_model(self, fidelity: str) -> ProblemFile:
        """Return the file of a reduced model: the same file, with the word after the ``@``."""
        return ProblemFile(word=f"{self.word}@{fidelity}", digest=self.digest)


def locate_problem(name_or_path: str | Path) -> ProblemFile:
    """Return the source of a problem. A file is executed once per process and content.

    Raises:
        InputError: If the problem does not exist.
        ProblemFileError: If its file does not define a problem.
    """
    name, fidelity = split_fidelity(name_or_path)
    _tell_of_namesake(name)
    known = None
    with suppress(OSError, ValueError, RuntimeError):
        known = _located(name, fidelity)
    if known is not None and known in _LOCATED:
        return known
    # By the word of the user, which messages repeat.
    problem = _of_word(name_or_path)
    file = known or _located(name, fidelity)
    _keep(file, problem)
    return file


def _located(name: str, fidelity: str | None) -> ProblemFile:
    """Return the source of a problem, without loading it."""
    word = name if name in bundled_problems() else str(Path(name).resolve())
    whole = word if fidelity is None else f"{word}@{fidelity}"
    return ProblemFile(word=whole, digest=_digest(whole))


def _digest(word: str) -> str:
    """Return a digest of the Python files that a problem may be made of.

    Raises:
        OSError: If the word names no Python file. Pipes, devices and files of data are not read.
    """
    name, _ = split_fidelity(word)
    path = bundled_problems().get(name, Path(name))
    files = [path] if path.suffix == ".py" else sorted(path.glob("*.py"))
    files = [file for file in files if file.is_file()]
    if not files:
        raise FileNotFoundError(f"no Python file: {path}")
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"{file.name}\n".encode() + file.read_bytes())
    return digest.hexdigest()


_LOCATED: dict[ProblemFile, Problem] = {}
"""The last problems that were located in this process, which execute their files once."""


def _keep(file: ProblemFile, problem: Problem) -> None:
    """Cache a problem, in place of the oldest one if there are many."""
    if len(_LOCATED) >= _MOST:
        _LOCATED.pop(next(iter(_LOCATED)), None)
    _LOCATED[file] = problem


@lru_cache(maxsize=_MOST)
def _loaded(problem_file: ProblemFile) -> Problem:
    is_same = False
    with suppress(OSError):
        is_same = _digest(problem_file.word) == problem_file.digest
    known = _LOCATED.get(problem_file) if is_same else None
    problem = _of_word(problem_file.word) if known is None else known
    if not is_same:
        raise InputError(
            f"Argument `problem` must be the same file for all workers, but "
            f"`{problem_file.word}` is another file here."
        )
    return problem
