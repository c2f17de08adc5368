"""Completion: what a shell offers at each place of a command line."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.commands import YES, ask, assert_refused
from zeno_orbits.cli import build_parser

needs_bash = pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")

REDUCED = ("corrected", "quasi_static")

_REPLY = """
words=("$@")
COMP_WORDS=("${words[@]}")
COMP_CWORD=$((${#words[@]} - 1))
_shtab_zeno_orbits zeno-orbits "${words[-1]}"
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture(name="script", scope="module")
def _script() -> str:
    answer = ask("completion", "bash")
    assert answer.code == YES
    return answer.out


@needs_bash
@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (("se",), {"search"}),
        (
            ("search", "motor_p"),
            {f"motor_pendulum{x}" for x in ("", "@corrected", "@quasi_static")},
        ),
        (("search", "m"), {"motor_cart", "motor_valve", "mine.py", "motor_pendulum"}),
        (("verify", ""), {"orbit.json", "sub/"}),
        (("rig", "o"), {"orbit.json"}),
        (("compare", "orbit.json", ""), {"run.csv", "sub/"}),
        (("search", "motor_pendulum", "--obj"), {"--objective"}),
        (("search", "motor_pendulum", "--near", ""), {"orbit.json", "sub/"}),
        (("simulate", "motor_pendulum", "--engine", "ex"), {"explicit"}),
        (("map", "motor_pendulum", "--checkpoint", "s"), {"sub"}),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_a_shell_offers_commands_options_problems_and_files(
    words: tuple[str, ...], offered: set[str], script: str, tmp_path: Path
) -> None:
    for name in ("orbit.json", "mine.py", "run.csv"):
        (tmp_path / name).touch()
    (tmp_path / "sub").mkdir()
    (tmp_path / "script").write_text(f"{script}{_REPLY}")
    found = subprocess.run(
        ["bash", tmp_path / "script", "zeno-orbits", *words],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    replies = set(found.stdout.split())
    assert offered <= replies
    assert all(reply.startswith(words[-1]) for reply in replies)
    if not any(one.startswith("motor") for one in offered):
        assert replies == offered


def test_the_script_for_zsh_names_every_command_and_problem() -> None:
    answer = ask("completion", "zsh", "--json")
    assert answer.code == YES
    assert answer.data["script"].startswith("#compdef zeno-orbits")
    assert "motor_pendulum@corrected" in answer.data["script"]
    for line in build_parser().format_help().splitlines():
        if line.startswith("    ") and not line.startswith("     "):
            assert f"{line.split()[0]}:'" in answer.data["script"]


def test_another_shell_is_refused() -> None:
    assert_refused(ask("completion", "tcsh"), "shell: unknown name `tcsh`", "Known: bash, zsh")
