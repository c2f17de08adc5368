"""Every command on five machines of 1e-6 to 10 m: the answer, or the reason why it is refused.

    python benchmarks/every_command.py [MACHINE ...]

The machines are those of `tests/support/machines`. Commands that read an orbit or a recording take
the files that earlier commands wrote. Exit code 1 if a command ends with an internal error, or the
message of a refusal is longer than a line.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

MACHINES = Path(__file__).resolve().parents[1] / "tests/support/machines"
SIZES = {
    "micro_relay": "1e-6 m",
    "eccentric_cam": "5e-3 m",
    "juggler": "0.08 m",
    "hammer": "0.1 m",
    "rocking_block": "10 m",
}
COMMANDS: tuple[tuple[str, ...], ...] = (
    ("zeno-condition", "FILE"),
    ("reduced-models", "FILE"),
    ("cache", "--compile", "FILE"),
    ("simulate", "FILE", "--until", "TIME"),
    ("search", "FILE", "-o", "orbit.json"),
    ("verify", "orbit.json", "--problem", "FILE"),
    ("prove", "orbit.json", "--problem", "FILE", "-o", "proof.json"),
    ("prove", "--check", "proof.json", "--problem", "FILE"),
    ("map", "FILE", "--x", "restitution=0.2:0.4", "--y", "m=LIGHT:HEAVY", "--grid", "2x2"),
    ("continue", "FILE", "--parameter", "restitution=0.2:0.4"),
    ("push", "orbit.json", "--problem", "FILE", "--phases", "2"),
    ("work-precision", "FILE", "--quick"),
    ("rig", "orbit.json", "--problem", "FILE", "--cycles", "3", "-o", "run.csv"),
    ("compare", "orbit.json", "run.csv", "--problem", "FILE"),
    ("identify", "FILE", "run.csv", "--fit", "restitution"),
    ("export", "FILE", "-o", "exported.c"),
    ("plot", "orbit.json", "--problem", "FILE", "-o", "orbit.png"),
    ("figures", "orbit.json", "--problem", "FILE", "-o", "figures"),
    ("report", "orbit.json", "--problem", "FILE", "-o", "report.html"),
)


ANSWERS = {0: "yes", 1: "no", 2: "refused"}


def main() -> int:
    """Print the table, then the reasons of the refusals."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("machines", nargs="*", default=list(SIZES))
    names = parser.parse_args().machines
    columns = [answers_of(name) for name in names]
    print("| command |", " | ".join(f"`{name}`, {SIZES[name]}" for name in names), "|")
    print("|" + (1 + len(names)) * "---|")
    for k, words in enumerate(COMMANDS):
        name = " ".join(word for word in words[:2] if word == words[0] or word[:2] == "--")
        print(f"| `{name}` |", " | ".join(column[k][0] for column in columns), "|")
    wrong = False
    for name, column in zip(names, columns, strict=True):
        for words, (answer, said) in zip(COMMANDS, column, strict=True):
            if answer != "yes":
                print(f"{name}, {words[0]}: {said}")
                wrong |= answer not in ANSWERS.values() or "internal" in said or "\n" in said
    return int(wrong)


def answers_of(machine: str) -> list[tuple[str, str]]:
    """Return the answer of every command about a machine, with its message."""
    file = MACHINES / f"{machine}.py"
    with tempfile.TemporaryDirectory() as folder:
        return [answer_of(words, file, Path(folder)) for words in COMMANDS]


def answer_of(words: tuple[str, ...], file: Path, folder: Path) -> tuple[str, str]:
    """Return the answer of a command, with its message on standard error or its first line."""
    values = values_of(file)
    filled = [fill(word, values) for word in words]
    path = os.pathsep.join((str(MACHINES.parents[2]), os.environ.get("PYTHONPATH", "")))
    done = subprocess.run(
        [sys.executable, "-m", "zeno_orbits", *filled],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path, "COLUMNS": "200"},
        capture_output=True,
        text=True,
        check=False,
    )
    said = done.stdout.strip().split("\n")[0] if done.returncode == 1 else done.stderr.strip()
    return ANSWERS.get(done.returncode, f"exit code {done.returncode}"), said


def values_of(file: Path) -> dict[str, str]:
    """Return the words that stand for a number or the file of a machine."""
    import zeno_orbits as zo

    problem = zo.load_problem(file)
    values = problem.values()
    mass = values.parameters["m"]
    return {
        "FILE": str(file),
        "TIME": repr(20.0 * problem.dynamics(values).own.time),
        "LIGHT": repr(0.9 * mass),
        "HEAVY": repr(1.1 * mass),
    }


def fill(word: str, values: dict[str, str]) -> str:
    """Return a word with its placeholders replaced."""
    for name, value in values.items():
        word = word.replace(name, value)
    return word


if __name__ == "__main__":
    sys.exit(main())
