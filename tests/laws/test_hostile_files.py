"""Hostile files, for every command and function that reads one: one line, at once, no damage."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import pytest

import zeno_orbits as zo
from tests.support.commands import NO, YES, ask, contents
from tests.support.data_files import contents_by_kind, reading_commands
from zeno_orbits import api
from zeno_orbits.maps import read_boundaries, read_map, read_pushes, read_recovery
from zeno_orbits.precision import read_work_precision

PATIENCE = 10.0
"""Longest answer [s], in processor time."""

KINDS = (
    *("orbit_1.json", "orbit_2.json", "orbit_3.json", "proof.json", "pushes.json"),
    *("recovery.json", "trade.json", "map.json", "family.json"),
)


def test_every_kind_of_file_is_covered() -> None:
    assert tuple(contents_by_kind("motor_pendulum")) == KINDS


def _text(kind: str) -> str:
    return json.dumps(contents_by_kind("motor_pendulum")[kind])


def _write(change: Callable[[str], str | bytes]) -> Callable[[Path, str], None]:
    def write(path: Path, kind: str) -> None:
        content = change(_text(kind))
        path.write_bytes(content if isinstance(content, bytes) else content.encode())

    return write


def _replaced(old: str, new: str) -> Callable[[Path, str], None]:
    """Return a function that writes a file with another entry, in every kind that has the entry."""
    return _write(lambda text: text.replace(old, new))


def _link(target: str) -> Callable[[Path, str], None]:
    return lambda path, _kind: path.symlink_to(target)


def _sparse(path: Path, _kind: str) -> None:
    with path.open("wb") as file:
        file.truncate(1 << 33)


TRAPS: dict[str, Callable[[Path, str], None]] = {
    "a pipe": lambda path, _: os.mkfifo(path),
    "an endless device": _link("/dev/zero"),
    "a device": _link("/dev/null"),
    "a folder": lambda path, _: path.mkdir(),
    "a link to nothing": _link("nowhere"),
    "a link in a circle": lambda path, _: path.symlink_to(path),
    "eight gigabytes": _sparse,
    "empty": _write(lambda _: ""),
    "a byte order mark": _write(lambda text: b"\xef\xbb\xbf" + text.encode()),
    "UTF-16": _write(lambda text: text.encode("utf-16")),
    "a zero byte": _write(lambda text: text.replace(":", ":\0", 1)),
    "no UTF-8": _write(lambda text: text.encode() + b"\xff\xfe"),
    "cut": _write(lambda text: text[: len(text) // 2]),
    "a list": _write(lambda text: f"[{text}]"),
    "a number": _write(lambda _: "7"),
    "null": _write(lambda _: "null"),
    "an object without entries": _write(lambda _: "{}"),
    "deep lists": _write(lambda _: "[" * 200_000 + "]" * 200_000),
    "deep entries": _write(lambda text: text[:-1] + ', "x": ' + '{"a":' * 900 + "1" + "}" * 901),
    "deep parameters": _replaced('"parameters": {', '"parameters": {"m": ' + "[" * 900 + "]" * 900),
    "a long text": _write(lambda text: text[:-1] + f', "{"a" * 5_000_000}": 1}}'),
    "many names": _write(
        lambda text: text[:-1] + "".join(f', "{k}": 0' for k in range(300_000)) + "}"
    ),
    "a name twice": _write(lambda text: text[:-1] + ', "problem": "evil.py"}'),
    "many names twice": _write(
        lambda text: text[:-1] + "".join(f', "{k % 20_000}": 0' for k in range(40_000)) + "}"
    ),
    "a huge whole number": _write(lambda text: text[:-1] + f', "period": {"9" * 4000}}}'),
    "digits without end": _write(lambda text: text[:-1] + f', "x": {"9" * 1_000_000}}}'),
    "a large period": _replaced('"period": 2.0', '"period": 1e308'),
    "a tiny period": _replaced('"period": 2.0', '"period": 5e-324'),
    "a whole period": _replaced('"period": 2.0', f'"period": {"9" * 400}'),
    "a period beyond doubles": _replaced('"period": 2.0', '"period": 1e999'),
    "not a number": _replaced('"period": 2.0', '"period": NaN'),
    "infinity": _replaced('"period": 2.0', '"period": -Infinity'),
    "an escape sequence": _replaced('"period"', '"\\u001b[2Jperiod"'),
    "an escaped name": _replaced('"motor_pendulum"', '"\\u001b]0;x\\u0007"'),
    "a path": _replaced('"motor_pendulum"', '"../../evil.py"'),
    "names of Python": _replaced('"q"', '"__class__"'),
    "a format of the future": _replaced('"format": ', '"format": 9'),
    "a truth value": _replaced("2.0", "true"),
    "texts": _replaced("2.0", '"2.0"'),
    "no value": _replaced("2.0", "null"),
    "many impacts": _write(lambda text: text.replace("[{", "[" + "{}," * 100_000 + "{", 1)),
}
"""What a file may be, and how it is made."""

BEFORE_CONTENT = (
    *("a pipe", "an endless device", "a device", "a folder", "a link to nothing"),
    *("a link in a circle", "eight gigabytes", "empty", "a number", "null", "deep lists"),
    *("an object without entries", "a byte order mark", "UTF-16", "a zero byte", "no UTF-8"),
    *("cut", "deep entries", "a long text", "many names", "digits without end"),
)
"""Traps that end before the content counts: one reader of text serves every kind."""
FAST = ("a pipe", "a folder", "eight gigabytes", "deep lists", "many names twice", "a path")


def _cases() -> list[object]:
    def mark(trap: str, kind: str) -> object:
        quick = trap in FAST and (
            kind == "orbit_1.json" or (trap, kind) == ("a path", "proof.json")
        )
        return pytest.param(trap, kind, marks=() if quick else pytest.mark.slow)

    spoiled = ("orbit_1.json", "orbit_3.json", "proof.json", "pushes.json")
    return [
        mark(trap, kind)
        for trap in TRAPS
        for kind in (("orbit_1.json",) if trap in BEFORE_CONTENT else spoiled)
    ]


@contextmanager
def at_once() -> Generator[None]:
    """Require an answer in time. A reader that waits for a pipe is interrupted."""

    def late(_signal: int, _frame: FrameType | None) -> None:
        raise AssertionError("no answer")

    before, began = signal.signal(signal.SIGALRM, late), time.process_time()
    signal.alarm(120)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    assert time.process_time() - began < PATIENCE


EVIL = "from pathlib import Path\nPath('it ran').touch()\n"


@pytest.fixture(name="here")
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "one" / "two"
    folder.mkdir(parents=True)
    (tmp_path / "evil.py").write_text(EVIL)
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.parametrize(("trap", "kind"), _cases())
def test_a_hostile_file_is_one_line_for_every_command(
    trap: str, kind: str, here: Path, tmp_path: Path
) -> None:
    path = Path("orbit.json")
    TRAPS[trap](path, kind)
    before = contents(tmp_path / "one") if trap != "eight gigabytes" else {}
    for words in reading_commands(path, output=Path("out.html")):
        with at_once():
            answer = ask(*words)
        assert "internal error" not in answer.err, (words, answer.err)
        assert "Traceback" not in answer.err
        assert answer.code in (YES, NO, 2)
        assert answer.err.count("\n") <= 1
        assert len(answer.err) < 1500
        if answer.code == 2 and trap not in ("eight gigabytes", "a pipe"):
            assert contents(tmp_path / "one") == before
    assert not (here / "it ran").exists()


READERS: dict[str, Callable[[Path], object]] = {
    "read_orbit": zo.read_orbit,
    "any_orbit": api.any_orbit,
    "verify": zo.verify,
    "check_proof": zo.check_proof,
    "check_certificate": api.check_certificate,
    "read_recording": zo.read_recording,
    "read_map": read_map,
    "read_pushes": read_pushes,
    "read_recovery": read_recovery,
    "read_work_precision": read_work_precision,
    "read_boundaries": lambda path: read_boundaries(path, "m", "g"),
    "load_problem": zo.load_problem,
}


@pytest.mark.parametrize(("trap", "kind"), _cases())
def test_a_hostile_file_is_one_line_for_every_reader(trap: str, kind: str, here: Path) -> None:
    path = Path("orbit.json")
    TRAPS[trap](path, kind)
    for name, reader in READERS.items():
        with at_once():
            try:
                reader(path)
            except zo.ZenoOrbitsError as error:
                told = str(error)
                assert "\n" not in told, (name, told)
                assert len(told) < 1500, (name, told)
    assert not (here / "it ran").exists()
