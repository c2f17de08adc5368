"""What starts without what: heavy libraries are loaded where they are used, and not before."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence

import pytest

SCIPY = ("scipy.integrate", "scipy.linalg", "scipy.optimize", "scipy.special", "scipy.stats")
RARE = (
    *("dask", "distributed", "heyoka", "joblib", "matplotlib", "plotly", "rich", "sympy"),
    *SCIPY,
)
"""No search, verification or simulation needs these to compute."""

EVERY_MODULE = (
    *(
        "zeno_orbits",
        "zeno_orbits.model.problem",
        "zeno_orbits.model.numeric.compiled",
        "zeno_orbits.simulation.simulator",
    ),
    *(
        "zeno_orbits.verification.verifier",
        "zeno_orbits.search.search",
        "zeno_orbits.search.objectives",
        "zeno_orbits.cli",
    ),
    *(
        "zeno_orbits.orbits.orbit",
        "zeno_orbits.verification.certificate",
        "zeno_orbits.report.terminal",
    ),
    *(
        "zeno_orbits.maps.mapping",
        "zeno_orbits.maps.map_file",
        "zeno_orbits.work",
        "zeno_orbits.report.page",
    ),
)
WITHOUT_CASADI = (
    "zeno_orbits.work",
    "zeno_orbits",
    "zeno_orbits.cli",
    "zeno_orbits.report.terminal",
    "zeno_orbits.report.terminal.progress",
    "zeno_orbits.cli.parsing",
)

HELP = ("--help", "map --help", "search --help", "verify --help", "search --gian Kp=2")


def loaded_by(statements: str, names: Sequence[str]) -> set[str]:
    """Return which of the names a fresh interpreter has loaded after some statements."""
    program = f"import sys\n{statements}\nprint(*(n for n in {tuple(names)!r} if n in sys.modules))"
    answer = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True
    )
    return set(answer.stdout.splitlines()[-1].split())


def run(command: str) -> str:
    """Return statements that run a command and go on after its end."""
    return (
        "import contextlib, io\n"
        "from zeno_orbits.__main__ import main\n"
        f"sys.argv = ['zeno-orbits', *{command.split()!r}]\n"
        "with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):"
        "\n    with contextlib.suppress(SystemExit):\n        main()"
    )


@pytest.mark.slow
def test_a_module_loads_no_library_that_it_needs_rarely() -> None:
    assert loaded_by(f"import {', '.join(EVERY_MODULE)}", RARE) == set()


def test_what_needs_no_symbols_loads_no_casadi() -> None:
    assert loaded_by(f"import {', '.join(WITHOUT_CASADI)}", ("casadi", "numpy", *RARE)) == set()


def test_a_problem_is_described_without_scipy() -> None:
    assert loaded_by("import zeno_orbits.model.problem", ("casadi", *SCIPY)) == {"casadi"}


def test_help_and_misuse_load_neither_casadi_nor_numpy() -> None:
    assert loaded_by("\n".join(map(run, HELP)), ("casadi", "numpy", *RARE)) == set()


@pytest.mark.slow
def test_the_problems_are_listed_without_scipy_and_in_json_without_rich() -> None:
    heavy = ("casadi", "matplotlib", "rich", "sympy", *SCIPY)
    assert loaded_by(run("problems"), heavy) == {"casadi", "rich"}
    assert loaded_by(run("problems --json"), heavy) == {"casadi"}


@pytest.mark.slow
def test_a_module_that_draws_is_seen_to_load_matplotlib() -> None:
    assert loaded_by("import zeno_orbits.report.plots.style", RARE) >= {"matplotlib"}
    assert loaded_by("import zeno_orbits.model.formulas", RARE) >= {"sympy"}
    assert loaded_by("import scipy.stats", SCIPY) == set(SCIPY)
