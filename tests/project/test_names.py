"""The names of the package, with its extras and without them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import zeno_orbits as zo

ROOT = Path(__file__).resolve().parents[2]


def run_without_flint(folder: Path, program: str) -> str:
    """Run a program where python-flint is not installed."""
    hide = "import sys; sys.modules['flint'] = None\n"
    hide += "import importlib.util as u; f = u.find_spec\n"
    hide += "u.find_spec = lambda name, *more: None if name == 'flint' else f(name, *more)\n"
    done = subprocess.run(
        [sys.executable, "-c", hide + program],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_version_is_a_name_and_every_name_of_dir_can_be_used() -> None:
    assert "__version__" in dir(zo)
    for name in dir(zo):
        assert getattr(zo, name) is not None


def test_everything_is_imported_without_an_extra(tmp_path: Path) -> None:
    program = "from zeno_orbits import *\nprint(__version__, simulate.__name__, 'Proof' in dir())"
    assert run_without_flint(tmp_path, program) == f"{zo.__version__} simulate False\n"


def test_a_name_that_needs_an_extra_is_one_line_that_names_it(tmp_path: Path) -> None:
    program = "import zeno_orbits as zo\n"
    program += "try: zo.Proof\nexcept zo.InputError as error: print(error)\n"
    program += "try: zo.Nothing\nexcept AttributeError: print('no such name')"
    said = run_without_flint(tmp_path, program).splitlines()
    assert said == [
        "`zeno_orbits.Proof` needs python-flint: run `pip install 'zeno_orbits[proof]'`.",
        "no such name",
    ]


def test_a_recording_is_cut_between_two_times(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    rows = "".join(f"{0.1 * k},{k}\n" for k in range(20))
    path.write_text(f"time [s],height [m]\n{rows}")
    found = zo.crop(zo.read_recording(path), 0.45, 1.25)
    assert found.time.tolist() == [0.1 * k for k in range(5, 13)]
