"""The help of commands: options in groups, and commands by purpose.

A single table serves all commands, so that an option is in the same group everywhere.
"""
# pyright: reportPrivateUsage=false

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterator, Sequence
from textwrap import shorten, wrap

COMMANDS = {
    "model": ("problems", "new", "zeno-condition", "reduced-models"),
    "find": ("simulate", "search"),
    "check": ("verify", "stability", "prove"),
    "explore": ("map", "continue", "push", "recovery", "scatter", "feedback", "work-precision"),
    "real machines": ("rig", "read", "compare", "identify", "export"),
    "show": ("plot", "figures", "report"),
    "tools": ("cache", "completion"),
}
"""Commands by purpose, in the order of the help."""

GROUPS = {
    "problem": (
        "--set",
        "--vary",
        "--start",
        "--at",
        "--near",
        "--t-start",
        "--t-end",
        "--problem",
        "--column",
        "--unit",
        "--zero",
        "--frame-rate",
        *("--trial", "--second-file", "--initial", "--transient", "--law"),
    ),
    "machine": ("--part", "--only", "--without", "--exact-pwm", "--cycles"),
    "objective": (
        "--objective",
        "--method",
        "--uncertain",
        "--bounds",
        "--shape",
        "--allow-unstable",
        "--fit",
    ),
    "range": (
        *(
            "--x",
            "--y",
            "--grid",
            "--refine",
            "--parameter",
            "--parameter2",
            "--section",
            "--interval",
            "--branch",
        ),
        *("--kind", "--recording", "--directions", "--phases", "--reach", "--spread"),
        *("--inputs", "--method", "--weight", "--multipliers", "--delay", "--extent"),
        "--stabilize",
    ),
    "effort": (
        *("--until", "--n-starts", "--candidates", "--max-points"),
        *("--max-steps", "--max-impacts"),
        *("--periods", "--steps", "--quick", "--measure", "--settle", "--seed"),
        *("--trade", "--pushes", "--recovery"),
    ),
    "accuracy": (
        *("--accuracy", "--tolerance", "--engine", "--truncation", "--model", "--radius"),
        *("--basin", "--proof", "--rigorous", "--error", "--decay", "--samples", "--confidence"),
    ),
    "parallel": ("--workers", "--scheduler", "--checkpoint"),
    "output": (
        *("--output", "--plot", "--boundaries", "--rate", "--noise", "--orbit", "--format"),
        *("--fmu", "--input", "--controller", "--persists", "--window", "--period", "--machine"),
        *("--events", "--all-states", "--states", "--margins", "--all"),
        *("--json", "--verbose", "--debug", "--help", "--help-all"),
    ),
}
"""Long names of the options of each group, in the order of the help."""

COMMON = frozenset(
    {
        *("--set", "--vary", "--start", "--at", "--near", "--t-start", "--t-end", "--objective"),
        "--until",
        *("--bounds", "--fit", "--x", "--y", "--grid", "--parameter", "--cycles", "--kind"),
        *("--accuracy", "--tolerance", "--check", "--compile", "--clear", "--measure", "--quick"),
        *(
            "--with-motor",
            "--with-circuit",
            "--workers",
            "--margins",
            "--all",
            "--events",
            "--output",
            "--plot",
        ),
        *(
            "--recording",
            "--column",
            "--unit",
            "--directions",
            "--phases",
            "--decay",
            "--samples",
            "--json",
            "--help-all",
        ),
    }
)
"""Options in the short help of a command."""

_LINES = 24
_WIDTH, _NAMES = 80, 30
_EXAMPLES = 2


def help_of(
    parser: argparse.ArgumentParser,
    formatter: Callable[[], argparse.HelpFormatter],
    *,
    everything: bool = False,
) -> str:
    """Return the help of a parser.

    Args:
        parser: The parser of a command, or of the program.
        formatter: Function that returns the formatter of the whole help.
        everything: True shows all options and examples. False shows the common options of a
            command if the whole help needs more lines than a screen has.
    """
    whole = _whole_help(parser, formatter())
    if everything or _commands_of(parser) is not None or whole.count("\n") <= _LINES:
        return whole
    return _short_help(parser)


def _short_help(parser: argparse.ArgumentParser) -> str:
    """Return the help of the common options of a command, one line for each."""
    actions = _actions(parser)
    arguments = [action for action in actions if not action.option_strings]
    options = [action for action in actions if COMMON & set(action.option_strings)]
    usage = " ".join([parser.prog, "[options]", *map(_names, arguments)])
    summary = (parser.description or "").partition(";")[0].rstrip(".")
    examples = (parser.epilog or "").replace(" \\\n", "\0").splitlines()[: 1 + _EXAMPLES]
    lines = [
        f"usage: {usage}",
        "",
        *wrap(f"{summary}.", _WIDTH),
        "",
        *map(_line, arguments),
        *map(_line, sorted(options, key=_place)),
        "",
        *"\n".join(examples).replace("\0", " \\\n").splitlines(),
    ]
    return "\n".join(lines) + "\n"


def _names(action: argparse.Action) -> str:
    """Return the words of an argument or option as a user types them."""
    metavar = action.metavar if isinstance(action.metavar, str) else ""
    if action.choices and not metavar:
        listed = f"{{{','.join(map(str, action.choices))}}}"
        metavar = listed if len(listed) <= _NAMES else action.dest.upper()
    if not action.option_strings:
        return f"[{metavar}]" if action.nargs == "?" else metavar or action.dest.upper()
    if action.nargs == 0:
        metavar = ""
    elif not metavar:
        metavar = action.dest.upper()
    return f"{', '.join(action.option_strings)} {metavar}".rstrip()


def _line(action: argparse.Action) -> str:
    """Return one line on an argument or option: its words, and the first clause of its help."""
    names = _names(action)
    clause = (action.help or "").partition(";")[0]
    room = _WIDTH - 3 - max(_NAMES, len(names))
    while len(clause) > room:
        shorter = re.split(r",? \(|[,:] |, for example", clause)[0]
        clause = shorter if len(shorter) < len(clause) else shorten(clause, room, placeholder="")
    return f"  {names:<{_NAMES}} {clause}"


def _whole_help(parser: argparse.ArgumentParser, formatter: argparse.HelpFormatter) -> str:
    """Return the help of all options, in groups."""
    sections = list(_sections(parser))
    actions = [action for _, members in sections for action in members]
    if _commands_of(parser) is not None:
        actions = _actions(parser)
    formatter.add_usage(parser.usage, actions, [])
    formatter.add_text(parser.description)
    for title, members in sections:
        formatter.start_section(title)
        formatter.add_arguments(members)
        formatter.end_section()
    formatter.add_text(parser.epilog)
    return formatter.format_help()


def _sections(
    parser: argparse.ArgumentParser,
) -> Iterator[tuple[str, Sequence[argparse.Action]]]:
    commands = _commands_of(parser)
    if commands is not None:
        for title, names in COMMANDS.items():
            yield title, [commands[name] for name in names]
    named = {title: list[argparse.Action]() for title in ("arguments", *GROUPS, "options")}
    for action in _actions(parser):
        if not isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            named["options" if commands is not None else _title(action)].append(action)
    for title, members in named.items():
        if members:
            yield title, sorted(members, key=_place)


def _actions(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    return parser._actions  # noqa: SLF001 (argparse offers no other way to them)


def _commands_of(parser: argparse.ArgumentParser) -> dict[str, argparse.Action] | None:
    """Return the commands of a program by name, or None for a single command."""
    for action in _actions(parser):
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            entries = action._choices_actions  # noqa: SLF001
            return {entry.dest: entry for entry in entries}
    return None


def _title(action: argparse.Action) -> str:
    if not action.option_strings:
        return "arguments"
    words = set(action.option_strings)
    return next((title for title, names in GROUPS.items() if words & set(names)), "options")


def _place(action: argparse.Action) -> int:
    """Return the index of an option in the order of the help. Arguments keep their order."""
    for place, name in enumerate(name for names in GROUPS.values() for name in names):
        if name in action.option_strings:
            return place
    return -1
