"""Every benchmark runs to its end in a reduced form: its imports, its options, its exit code."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = sorted((ROOT / "benchmarks").glob("*.py"))

REDUCED = {
    "beside_others": ("--quick", "--runs", "1"),
    "chatter_cascade": ("--most", "2"),
    "comparison": ("--machines", "motor_flap", "--samples", "150", "--seeds", "1"),
    "contact_coverage": ("--recordings", "2", "--periods", "3"),
    "contact_fits": ("--quick",),
    "coverage": ("--quick", "--problems", "vibrating_table", "--workers", "1"),
    "error_over_tolerance": ("--starts", "1"),
    "every_command": ("eccentric_cam",),
    "explore_browser": ("--changes", "3"),
    "extremes": ("pendulum in",),
    "families": ("--quick", "--workers", "1"),
    "fidelity": ("--least", "1e-3", "--runs", "1"),
    "friction_machines": ("--machines", "2", "--until", "4"),
    "held_orbits": ("--machines", "table_juggler", "--periods", "150", "--others", "20"),
    "held_sensors": ("--rows", "window 40 ms", "--periods", "4", "--seeds", "1"),
    "identification_intervals": ("--seeds", "2"),
    "loop": ("--runs", "1", "--no-reference"),
    "many_gains": ("--gains", "2", "--kinds", "amplitudes", "--trials", "4"),
    "map_agreement": ("--points", "3", "--grid", "4"),
    "map_speed": ("--size", "3", "--orbits", "2", "--fates", "2"),
    "one_story": ("vibrating_table",),
    "optima": ("--only", "4", "--workers", "1"),
    "problem_cost": ("--runs", "1"),
    "proof_table": ("motor_valve", "--restitutions", "0.3", "--check"),
    "proofs": ("--orbits", "1"),
    "push_gains": (
        *("--problems", "motor_pendulum", "--starts", "0"),
        *("--objectives", "nearest"),
    ),
    "pushes": (
        *("--grid", "9", "--pushes", "20", "--rig", "2", "--sets", "1"),
        *("--phases", "2", "--steps", "4", "--workers", "1"),
    ),
    "random_graphs": ("--machines", "4", "--turns", "2"),
    "random_machines": ("--machines", "2", "--turns", "150"),
    "restitution_near_one": ("--repeats", "1"),
    "rig_convergence": ("--only", "portrait", "--points", "3"),
    "two_methods": ("--machines", "motor_pendulum", "--trials", "1"),
    "search_success": ("--problems", "1", "--kinds", "fixed", "--workers", "1"),
    "shaken_tables": ("--tables", "2", "--searches", "0"),
    "special_points": ("--only", "3", "5", "--points", "40", "--marginal", "2", "--workers", "1"),
    "start_up": ("--runs", "1"),
    "transients": ("coverage", "--count", "1", "--machines", "ball", "stick slip"),
    "event_verdicts": ("--yes", "3", "--no", "4"),
    "table_cost": ("--runs", "3"),
    "verdicts": ("--quick", "--workers", "1"),
    "warm_calls": ("--runs", "1", "--size", "20"),
    "warm_orbit": ("--runs", "9"),
}
"""Script to the words of a run of at most a minute or so."""

TOOLS = {"mutants", "same_answers"}
"""Scripts that study a change of the code; they take long and measure no documented figure."""


def run(words: list[str], path: Path) -> subprocess.CompletedProcess[str]:
    """Run a script as a user would, from the repository's root with the package installed."""
    # The package is there as if it was installed; the root of the repository is on no path.
    (path / "zeno_orbits").symlink_to(ROOT / "zeno_orbits")
    return subprocess.run(
        [sys.executable, *words],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(path)},
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )


def test_every_benchmark_is_run_in_a_reduced_form() -> None:
    # `memory` has a test of its own.
    assert {script.stem for script in SCRIPTS} == set(REDUCED) | TOOLS | {"memory"}


def test_every_benchmark_that_a_document_names_exists() -> None:
    named = {
        (path, page.name)
        for page in (*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"))
        for path in re.findall(r"benchmarks/[\w/]+\.py", page.read_text(encoding="utf-8"))
        if page.name != "CHANGELOG.md"
    }
    assert len(named) > 20
    assert [one for one in sorted(named) if not (ROOT / one[0]).is_file()] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(TOOLS))
def test_a_tool_prints_its_usage(name: str, tmp_path: Path) -> None:
    told = run([f"benchmarks/{name}.py", "--help"], tmp_path)
    assert told.returncode == 0, told.stderr
    assert told.stdout.startswith("usage: ")


@pytest.mark.slow
def test_a_long_lived_process_keeps_little_and_leaves_nothing(tmp_path: Path) -> None:
    done = run(["benchmarks/memory.py", "--quick", "--json"], tmp_path)
    kept = json.loads(done.stdout)
    # The aim for the whole work; a twentieth of it grew by 4 MB.
    assert sum(kept["growth_MB"].values()) < 20.0
    assert all(number <= 0 for number in kept["left"].values()), kept["left"]
    assert kept["reading_s"] < 2.0


@pytest.mark.slow
@pytest.mark.weekly
@pytest.mark.parametrize("name", REDUCED)
def test_a_benchmark_runs_to_its_end(name: str, tmp_path: Path) -> None:
    done = run([f"benchmarks/{name}.py", *REDUCED[name]], tmp_path)
    # Exit code 1 is a goal that a busy machine misses.
    assert done.returncode in (0, 1), done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout.strip()
