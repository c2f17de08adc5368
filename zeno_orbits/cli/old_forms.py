"""Old commands and options, which keep working for one release with one line on standard error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

COMMANDS = {
    "conditions": "zeno-condition",
    "fidelity": "reduced-models",
    "trade": "work-precision",
}
"""Old name of a command to its new name."""

_VALUES = {"--gain": "--set"}
_START = {"--initial": "--start"}
_NEAR = {"--from": "--near"}
_END = {"--t-end": "--until"}
_LONGEST = {"--max-time": "--until"}
_PICTURE = {"--picture": "--plot"}
_RECORDING = {"--from": "--t-start", "--to": "--t-end"}
OPTIONS: Mapping[str, Mapping[str, str]] = {
    "zeno-condition": {**_VALUES, "--output": "--plot", "-o": "--plot"},
    "simulate": {
        **_VALUES,
        **_START,
        **_END,
        "--most-steps": "--max-steps",
        "--data": "--output",
        "--output": "--plot",
        "-o": "--plot",
    },
    "reduced-models": _VALUES,
    "search": {
        **_START,
        **_NEAR,
        **_LONGEST,
        "--gain": "--vary",
        "--free": "--vary",
        "--fix": "--set",
        "--keep": "--bounds",
        "--bound": "--bounds",
        "--starts": "--n-starts",
    },
    "prove": {"--over": "--interval"},
    "map": {
        **_VALUES,
        **_START,
        **_PICTURE,
        **_LONGEST,
        "--points": "--grid",
    },
    "push": {**_LONGEST, "--direction": "--directions"},
    "continue": {
        **_VALUES,
        **_START,
        **_NEAR,
        **_PICTURE,
        "--in": "--parameter",
        "--second": "--parameter2",
        "--steps": "--max-points",
        "--point": "--kind",
    },
    "work-precision": {**_VALUES, **_START, **_END, **_PICTURE},
    "rig": {**_VALUES, **_START, **_END, "--exact": "--exact-pwm"},
    "compare": {**_RECORDING, **_PICTURE},
    "identify": {**_VALUES, **_RECORDING},
    "figures": {"--data": "--recording"},
    "export": {**_VALUES, **_START, **_END},
}
"""Command to its old options, each with its new name."""

_PICTURES = (".png", ".pdf", ".svg")
_DATA_TOO = ("-o", "--output")
"""Options that named a picture and name data now: the ending of the file decides."""


def in_new_forms(words: Sequence[str]) -> tuple[list[str], str]:
    """Return a command line in the new forms, and a clause about the old forms or no text.

    Args:
        words: The words after the name of the program.
    """
    place = next((k for k, word in enumerate(words) if not word.startswith("-")), len(words))
    if place == len(words):
        return list(words), ""
    typed = words[place]
    command = COMMANDS.get(typed, typed)
    changes = {typed: command} if command != typed else {}
    found = [*words[:place], command]
    rest = list(words[place + 1 :])
    for k, word in enumerate(rest):
        new, change = _in_new_form(OPTIONS.get(command, {}), word, rest[k + 1 : k + 2])
        found.append(new)
        changes.update(change)
    return found, ", ".join(f"`{old}` is now `{new}`" for old, new in changes.items())


def _in_new_form(
    options: Mapping[str, str], word: str, after: Sequence[str]
) -> tuple[str, dict[str, str]]:
    """Return a word in its new form, with the change of its option."""
    option, sign, value = word.partition("=")
    if "-o" in options and not word.startswith("--") and word[:2] == "-o" and len(word) > 2:
        option, sign, value = "-o", "=", word[2:].removeprefix("=")
    new = options.get(option)
    if new is None:
        return word, {}
    file = value if sign else "".join(after)
    if option in _DATA_TOO and not file.lower().endswith(_PICTURES):
        return word, {}
    return f"{new}{sign}{value}", {option: new}
