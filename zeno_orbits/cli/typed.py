"""Error messages with options as the user typed them in place of the names of arguments."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

_UNKNOWN = re.compile(
    r"Argument `(?:parameter|gain|state|name|vary)`: unknown (\w+) `([^`]*)`\."
    r"( Did you mean `[^`]*`\?)? Known: (.*)\."
)
_ARGUMENT = re.compile(r"Argument `([^`]+)`:? (.*)", flags=re.DOTALL)
_BOTH_NAMES = re.compile(r"`\w+` \((--[a-z-]+)\)")
_FILE = re.compile(r"[A-Z][a-z]+ file `")
_ROOM_NAMES = {
    "direction": "--directions",
    "gain": "--set",
    "most_impacts": "--max-impacts",
    "most_steps": "--max-steps",
    "name": "--set",
    "names": "--column",
    "parameter": "--set",
    "picture": "--plot",
    "state": "--start",
    "units": "--unit",
    "zeros": "--zero",
}
"""Name of an argument in the package to the option that gives it."""
_POSITIONALS = {"recording": "data"}
"""Name of an argument in the package to the word without an option that gives it."""
_ORBITS = ("problem", "orbit", "target")
"""Arguments that a command mostly takes without an option."""
_KINDS = {"--start": "state", "--at": "state", "--set": "gain or parameter"}


def as_typed(message: str, words: Sequence[str], options: argparse.Namespace) -> str:
    """Return an error with the option as it was typed, if it is about an option.

    Args:
        message: The error of the package.
        words: The command line.
        options: The parsed options, with the parser of the command.
    """
    message = with_options(message)
    found = _UNKNOWN.fullmatch(message)
    typed = "" if found is None else _option_of_name(found[2], words)
    if found is not None and typed:
        noun, name, near, known = found.groups()
        kind = _KINDS.get(re.split(r"[ =]", typed)[0], noun)
        return f"{typed}: unknown {kind} `{name}`.{near or ''} Known: {known}."
    folder = f"Checkpoint `{getattr(options, 'checkpoint', None)}` "
    if message.startswith(folder):
        return f"{_typed({'--checkpoint'}, words)}: {message.removeprefix(folder)}"
    about = _ARGUMENT.fullmatch(message)
    if about is None:
        label = _option_of_path(message, words, options) if _FILE.match(message) else ""
        return f"{label}: {message}" if label else message
    if about[1].startswith("--"):
        return f"{about[1]}: {about[2]}"
    label = (
        _option_of_path(about[2], words, options)
        or _option_of(about[1], words, options)
        or _option_of_name(about[1], words)
        or _positional(about[1], options)
        or _left_out(about[1], options)
    )
    return f"{label}: {about[2]}" if label else message


def with_options(message: str) -> str:
    """Return a message with the option alone if it names an argument and its option."""
    return _BOTH_NAMES.sub(r"\1", message)


def _positional(argument: str, options: argparse.Namespace) -> str:
    """Return a word without an option that gave an argument, after its name in the usage."""
    named = _POSITIONALS.get(argument, argument)
    for action in options.parser.actions():
        given = getattr(options, action.dest, None)
        if action.dest == named and not action.option_strings and given is not None:
            return f"{action.metavar or action.dest} {given}"
    return ""


def _left_out(argument: str, options: argparse.Namespace) -> str:
    """Return the option of an argument that was left out, or no text."""
    option = f"--{argument.replace('_', '-')}"
    is_known = any(option in action.option_strings for action in options.parser.actions())
    return option if is_known and argument not in _ORBITS else ""


def _option_of_path(clause: str, words: Sequence[str], options: argparse.Namespace) -> str:
    """Return the option that gave the one path in a clause, as it was typed, or no text."""
    named = [
        action
        for action in options.parser.actions()
        if (action.type is Path or action.dest == "problem")
        and f"`{getattr(options, action.dest, None)}`" in clause
    ]
    return _typed({*named[0].option_strings}, words) if len(named) == 1 else ""


def _option_of(argument: str, words: Sequence[str], options: argparse.Namespace) -> str:
    """Return the option of an argument and its value as they were typed, or no text."""
    strings = _strings(argument, options)
    if argument in _ORBITS and not strings & set(words):
        return ""
    return _typed(strings, words)


def _typed(strings: set[str], words: Sequence[str]) -> str:
    """Return one of some options and its value as they were typed, or no text."""
    short = {one for one in strings if len(one) == 2}
    for k in reversed(range(len(words))):
        option, sign, _ = words[k].partition("=")
        if words[k][:2] in short and len(words[k]) > 2:
            # A short option and its value may be one word.
            return words[k]
        if option in strings:
            value = words[k + 1 : k + 1 + (not sign)]
            return " ".join([words[k], *(one for one in value if not one.startswith("--"))])
    return ""


def _strings(argument: str, options: argparse.Namespace) -> set[str]:
    """Return the option strings of an argument in the command."""
    own = f"--{argument.replace('_', '-')}"
    known = {one for action in options.parser.actions() for one in action.option_strings}
    wanted = {own} if own in known else {own, _ROOM_NAMES.get(argument, "")}
    found: set[str] = set()
    for action in options.parser.actions():
        if argument == action.dest or wanted & set(action.option_strings):
            found |= set(action.option_strings)
    return found


def _option_of_name(name: str, words: Sequence[str]) -> str:
    """Return the option and the words after it that give a value to a name, or no text."""
    for option, word in pairwise(words):
        if option.startswith("--") and word.startswith(f"{name}="):
            return f"{option} {word}"
    pattern = rf"--[a-z0-9-]+={re.escape(name)}="
    return next((word for word in words if re.match(pattern, word)), "")
