"""Texts in files do no harm: not in a terminal, on the page, or in a picture."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.commands import ask
from tests.support.data_files import contents_by_kind, reading_commands
from zeno_orbits.maps import read_map, write_map
from zeno_orbits.precision import TimedSetting, WorkPrecision
from zeno_orbits.report import terminal

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = ("\x1b[2J", "\x1b]0;title\x07", "\x9b31m", "\r", "\b", "\u202e", "\x7f")
"""Texts that clear or repaint a terminal, name its window, or reorder what follows."""
HARM = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e]")


def _spoiled(data: Any, text: str, chosen: int, count: list[int]) -> Any:
    """Return plain data with a text behind one of its texts or names."""
    if isinstance(data, dict):
        found = {}
        for name, entry in data.items():
            count[0] += 1
            key = name + text if count[0] == chosen else name
            found[key] = _spoiled(entry, text, chosen, count)
        return found
    if isinstance(data, list):
        return [_spoiled(entry, text, chosen, count) for entry in data]
    if isinstance(data, str):
        count[0] += 1
        return data + text if count[0] == chosen else data
    return data


@pytest.mark.slow
@pytest.mark.parametrize("text", fast(1, COMMANDS))
def test_no_text_of_a_file_commands_the_terminal(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    drawn = np.random.default_rng(1)
    for name, content in contents_by_kind("motor_pendulum").items():
        count = [0]
        _spoiled(content, "", -1, count)
        for chosen in drawn.integers(1, count[0] + 1, 2):
            spoiled = _spoiled(content, text, int(chosen), [0])
            Path(name).write_text(json.dumps(spoiled), encoding="utf-8")
            for words in list(reading_commands(Path(name), output=tmp_path / "out.html"))[::4]:
                answer = ask(*words)
                assert not HARM.search(answer.out + answer.err), (words, answer)
                assert answer.err.count("\n") <= 1
    Path("data.csv").write_text(f"time [s],x{text} [m]\n0,1\n1,2\n", encoding="utf-8")
    Path(f"no{text}.json").write_text("{}", encoding="utf-8")
    for words in (
        ("identify", "bouncing_ball", "data.csv", "--fit", "g"),
        ("verify", f"no{text}.json"),
        ("simulate", f"bouncing{text}"),
        ("simulate", "bouncing_ball", "--set", f"g{text}=1"),
    ):
        answer = ask(*words)
        assert not HARM.search(answer.out + answer.err), (words, answer)


def test_tables_and_sentences_show_a_command_as_its_escape(
    capsys: pytest.CaptureFixture[str],
) -> None:
    trial = TimedSetting(
        sweep="\x1b[2Jtolerance", name="a\x9b", value=1.0, seconds=1.0, error=1e-3, n_impacts=2
    )
    study = WorkPrecision(
        problem="p", work="\x1b]0;x\x07", truth="t", truth_error=0.0, trials=(trial,)
    )
    terminal.print_trade(study)
    terminal.print_error("bad \x1b[2J name")
    terminal.print_note("bad \x1b[2J name")
    told = capsys.readouterr()
    assert not HARM.search(told.out + told.err)
    assert "\\x1b[2J" in told.err


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    fast(1, ["$x^{2$", "$", "a $ b", r"$\frac{$", "$$", r"$\nope$", "$^^$", "x$_$", "$x_1$", "%"]),
)
def test_an_axis_of_any_name_is_drawn(name: str, tmp_path: Path) -> None:
    found = zo.parameter_map("bouncing_ball", x=("g", 5, 10, 2), y=("m", 1, 2, 2))
    path = tmp_path / "map.json"
    write_map(found, path)
    data = json.loads(path.read_text())
    data["x"]["name"] = name
    path.write_text(json.dumps(data))
    picture = zo.plot(read_map(path))
    for ending in ("png", "svg"):
        zo.save_figure(picture, tmp_path / f"map.{ending}")
    titled = zo.plot(zo.simulate("bouncing_ball", until=0.5), title=name)
    zo.save_figure(titled, tmp_path / "titled.png")


def _python(folder: Path, program: str, **variables: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), **variables},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


DRAWS = """
import zeno_orbits as zo
zo.save_figure(zo.plot(zo.simulate("bouncing_ball", until=0.5)), "a.png")
import matplotlib as mpl
print(mpl.rcParams["animation.ffmpeg_path"], mpl.rcParams["font.size"])
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", fast(1, ["settings", "pipe", "nonsense"]))
def test_settings_of_matplotlib_in_the_current_folder_are_not_obeyed(
    kind: str, tmp_path: Path
) -> None:
    path = tmp_path / "matplotlibrc"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "settings":
        path.write_text("animation.ffmpeg_path: /tmp/evil\nfont.size: 30\nbackend: module://evil")
    else:
        path.write_bytes(b"\xff\xfe\0nonsense")
    usual = mpl.rcParamsDefault
    # Nor is a backend that does not exist: a picture needs none.
    told = _python(tmp_path, DRAWS, MPLCONFIGDIR=str(tmp_path / "none"), MPLBACKEND="nonsense")
    assert told == f"{usual['animation.ffmpeg_path']} {usual['font.size']}\n"
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("backend", fast(0, ["nonsense", "module://nonsense", "agg", ""]))
def test_a_picture_needs_no_backend(backend: str, tmp_path: Path) -> None:
    _python(tmp_path, DRAWS, MPLBACKEND=backend)
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("count", fast(1, [20_000, 200_000]))
def test_repeated_names_are_found_at_once(count: int, tmp_path: Path) -> None:
    path = tmp_path / "orbit.json"
    names = ",".join(f'"name{k}":0' for k in range(count))
    path.write_text(f'{{{names},"name{count - 1}":1}}')
    began = time.process_time()
    with pytest.raises(zo.OrbitFileError, match=f"it names `name{count - 1}` twice"):
        zo.read_orbit(path)
    assert time.process_time() - began < 2.0


@pytest.mark.parametrize("count", [20_000, pytest.param(200_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", ["orbit_1.json", "orbit_2.json", "orbit_3.json"])
def test_a_period_of_too_many_events_is_refused_at_once(
    kind: str, count: int, tmp_path: Path
) -> None:
    data = contents_by_kind("motor_pendulum")[kind]
    holder, name = (data, "events") if "events" in data else (data, "impacts")
    holder = data["phases"][1] if "phases" in data else holder
    holder[name] = holder[name] * count
    path = tmp_path / kind
    path.write_text(json.dumps(data))
    began = time.process_time()
    told = f"its `{name}` has {count} entries, and the most is 10000"
    with pytest.raises(zo.OrbitFileError, match=told):
        zo.verify(path)
    assert time.process_time() - began < 8.0
