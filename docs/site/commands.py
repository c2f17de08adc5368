"""The help of every command as one page, from the parsers that the command line uses."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from zeno_orbits.cli import build_parser


def command_page() -> str:
    """Return the page in Markdown."""
    program = build_parser()
    return "\n".join(["# The command line", "", *_overview(program), *_commands(program)])


def _overview(program: argparse.ArgumentParser) -> Iterator[str]:
    yield f"{program.description} {_sentence((program.epilog or '').split(chr(10))[0])}"
    yield ""
    yield from ("| Command | What it does |", "|---|---|")
    for name, summary, _ in _subparsers(program):
        yield f"| [`{name}`](#command-{name}) | {_escaped(summary)} |"
    yield ""


def _commands(program: argparse.ArgumentParser) -> Iterator[str]:
    for name, _, command in _subparsers(program):
        usage = " ".join(command.format_usage().removeprefix("usage: ").split())
        yield from (
            f"(command-{name})=",
            f"## `{name}`",
            "",
            _escaped(command.description or ""),
            "",
        )
        yield from ("```text", *_folded(usage), "```", "")
        yield from ("| Option | What it says |", "|---|---|")
        for action in _options(command):
            yield f"| {_words(action)} | {_escaped(_sentence(action.help or ''))} |"
        examples = (command.epilog or "").splitlines()[1:]
        yield from ("", "```sh", *(line.strip() for line in examples), "```", "")


def _subparsers(
    program: argparse.ArgumentParser,
) -> Iterator[tuple[str, str, argparse.ArgumentParser]]:
    for action in program._actions:  # noqa: SLF001 (argparse offers no other way to its commands)
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for chosen in action._choices_actions:  # noqa: SLF001
                yield chosen.dest, chosen.help or "", action.choices[chosen.dest]


def _options(command: argparse.ArgumentParser) -> list[argparse.Action]:
    return [action for action in command._actions if "--help" not in action.option_strings]  # noqa: SLF001


def _words(action: argparse.Action) -> str:
    value = action.metavar or ("|".join(action.choices) if action.choices else action.dest.upper())
    if not action.option_strings:
        return f"`{value}`"
    takes = "" if action.nargs == 0 else f" {value}"
    return ", ".join(f"`{word}{takes}`" for word in action.option_strings).replace("|", r"\|")


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:].rstrip('.')}." if text else ""


def _escaped(text: str) -> str:
    return text.replace("%%", "%").replace("|", r"\|").replace("<", r"\<").replace("*", r"\*")


def _folded(usage: str, width: int = 90) -> Iterator[str]:
    """Fold a usage between its options, never inside one."""
    line = ""
    for word in usage.replace(" [", "\n[").split("\n"):
        if line and len(line) + len(word) >= width:
            yield line
            line = "   "
        line = f"{line} {word}" if line else word
    yield line
