"""The optional dependency for ball arithmetic."""

from __future__ import annotations

from importlib.util import find_spec

from zeno_orbits.errors import InputError


def require_flint(what: str) -> None:
    """Raise an error if python-flint is not installed.

    Args:
        what: Plural noun that starts the message.

    Raises:
        InputError: If python-flint is missing.
    """
    if find_spec("flint") is None:
        raise InputError(f"{what} need python-flint: run `pip install 'zeno_orbits[proof]'`.")
