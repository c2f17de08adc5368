"""The code of a page, and how it is run: its blocks one after the other, in one empty folder.

A comment in the line before a block says what is special about it::

    <!-- slow -->               it takes long: run with the slow tests only
    <!-- exit 1 -->             its last command ends with this code, instead of 0
    <!-- not run: REASON -->    it cannot be run here
    <!-- command: NAME -->      `.ci/run` runs it

A Python block that begins with `# name.py` is written to that file. A block of `text` is what the
block before it prints: its lines occur there in this order, spaces aside, `...` standing for
anything.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from markdown_it import MarkdownIt

from zeno_orbits.cli import main

ROOT = Path(__file__).parents[2]
SHOWN = ("text", "math", "json", "none")
"""Languages of blocks that are read, not run."""


@dataclass(frozen=True, kw_only=True)
class Block:
    """A block of a page.

    Attributes:
        line: Where it begins, counted from 1.
        language: As it says; empty for one that is indented.
        text: What is in it.
        mark: The comment before it, without its brackets.
    """

    line: int
    language: str
    text: str
    mark: str

    @property
    def slow(self) -> bool:
        """Return True if it takes long."""
        return self.mark == "slow"

    @property
    def left_out(self) -> bool:
        """Return True if it is not run at all."""
        return self.mark.startswith(("not run: ", "command: "))

    @property
    def code(self) -> int:
        """Exit code of its last command."""
        return int(self.mark.removeprefix("exit ")) if self.mark.startswith("exit ") else 0


@cache
def blocks(page: Path) -> list[Block]:
    """Return the blocks of a page, from top to bottom."""
    found: list[Block] = []
    mark = ""
    for token in MarkdownIt("commonmark").parse(page.read_text()):
        if token.type in {"fence", "code_block"}:
            line = token.map[0] + 1 if token.map else 0
            found.append(Block(line=line, language=token.info, text=token.content, mark=mark))
        comment = re.fullmatch(r"<!-- (.*) -->\s*", token.content)
        mark = comment[1] if token.type == "html_block" and comment else ""
    return found


def run_page(page: Path, *, slow: bool) -> None:
    """Run the blocks of a page in the working folder, the slow ones if asked to.

    Raises:
        AssertionError: If a block fails, or prints other things than the page says.
    """
    known = set(sys.modules)
    try:
        _run_blocks(page, slow=slow)
    finally:
        for name in set(sys.modules) - known:
            if Path(getattr(sys.modules[name], "__file__", None) or "").parent == Path.cwd():
                del sys.modules[name]


def _run_blocks(page: Path, *, slow: bool) -> None:
    names: dict[str, Any] = {}
    printed: str | None = None
    for block in blocks(page):
        where = f"{page.name}, line {block.line}"
        if block.language in SHOWN:
            if block.language == "text" and printed is not None:
                _compare(block.text, printed, where)
            printed = None
        elif block.left_out or (block.slow and not slow):
            printed = None
        elif block.language == "python":
            printed = _run_python(block, names, where)
        else:
            assert block.language == "sh", f"{where}: `{block.language}`"
            printed = _run_shell(block, where)


def _run_python(block: Block, names: dict[str, Any], where: str) -> str:
    if title := re.match(r"# (\w+\.py)\n", block.text):
        Path(title[1]).write_text(block.text)
        return ""
    with _heard() as out:
        exec(compile("\n" * block.line + block.text, where, "exec"), names)
    return out.getvalue()


def _run_shell(block: Block, where: str) -> str:
    printed = ""
    lines = commands(block)
    for line in lines:
        program, *words = shlex.split(line)
        if program == "zeno-orbits":
            with _heard() as out:
                code = main(words)
            said = out.getvalue()
        else:
            assert program == "python", f"{where}: {line}"
            script = [sys.executable, str(ROOT / words[0]), *words[1:]]
            paths = {**os.environ, "PYTHONPATH": str(ROOT)}
            run = subprocess.run(script, capture_output=True, text=True, env=paths)
            code, said = run.returncode, run.stdout + run.stderr
        assert code == (block.code if line == lines[-1] else 0), f"{where}: {line}\n{said}"
        printed += said
    return printed


def commands(block: Block) -> list[str]:
    """Return the commands of a block, comments left out, continued lines in one."""
    whole = re.sub(r"\\\n\s*", "", block.text)
    cut = [re.sub(r"(^|\s+)#.*", "", line).strip() for line in whole.splitlines()]
    return [line for line in cut if line]


@contextlib.contextmanager
def _heard() -> Iterator[io.StringIO]:
    """Catch what is printed, errors and progress too, as a wide terminal would show it."""
    out = io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "200")
        patch.syspath_prepend(str(Path.cwd()))
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
            yield out


def _compare(promised: str, printed: str, where: str) -> None:
    said = " ".join(printed.split())
    place = 0
    for piece in re.split(r"\.\.\.|\n", promised):
        wanted = " ".join(piece.split())
        place = said.find(wanted, place)
        assert place >= 0, f"{where}: `{wanted}` is not printed, but\n{printed}"
        place += len(wanted)
