"""Nonsense at each argument of every public name: one line that names an argument.

Some values are sound for some arguments, so a call may succeed. Everything else is an error of the
package, or a `ValueError` about misuse, and never an error from inside.
"""

from __future__ import annotations

import enum
import inspect
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo

VALUES: tuple[Any, ...] = (
    *(None, object(), 3, -1, float("nan"), float("inf"), 10**400, 1j, True, "nonsense", "", "a\nb"),
    *(
        b"x",
        [],
        {},
        frozenset[str](),
        [None],
        (1, 2, 3),
        ("a",),
        {"q": "x"},
        {1: 2},
        {"a": object()},
    ),
    *(np.zeros((2, 2)), ca.SX.sym("z"), ca.SX.sym("w", 2, 3), ca.MX.sym("m"), type),
    *(lambda: 0, print),
)
"""Values that few arguments take."""


def _callables() -> dict[str, Callable[..., Any]]:
    """Return the public functions, classes and constructors, by name."""
    found = dict[str, Callable[..., Any]]()
    for name in zo.__all__:
        one = getattr(zo, name)
        if not callable(one) or (
            inspect.isclass(one) and issubclass(one, BaseException | enum.Enum)
        ):
            continue
        found[name] = one
        if inspect.isclass(one):
            makers = inspect.getmembers(one, inspect.ismethod)
            found |= {f"{name}.{word}": maker for word, maker in makers if word[0] != "_"}
    return found


@pytest.fixture(name="sound")
def _sound(orbit: zo.Orbit) -> dict[str, Any]:
    """Return sound values of arguments that need one."""
    ball = zo.load_problem("bouncing_ball")
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    mass = zo.HybridLagrangian.from_energies(q=q, v=v, kinetic=v**2 / 2, potential=9.81 * q, gap=q)
    values = {name: getattr(ball, name) for name in ("title", "source", "starts", "portraits")}
    values |= {name: getattr(ball, name) for name in ("state_names", "state_units", "parameters")}
    return values | {
        "amplitude_of": "height",
        "certificate": "certificate.json",
        "default": 1.0,
        "fit": ["Kp"],
        "gains": (),
        "gap": q,
        "guard": q - 1,
        "kinetic": v**2 / 2,
        "knots": [0.0, 1.0, 2.0],
        "meaning": "meaning",
        "mechanism": mass,
        "model": ball.model,
        "name": "name",
        "orbit": orbit,
        "parameter": ("Kp", 2.4, 2.5),
        "path": "out.json",
        "potential": 9.81 * q,
        "problem": "bouncing_ball",
        "q": q,
        "recording": "recording.csv",
        "restitution": 0.5,
        "samples": [0.0, 1.0, 0.0],
        "signals": (),
        "states": q,
        "time": np.array([0.0, 1.0, 2.0]),
        "unit": "m",
        "until": 0.5,
        "v": v,
        "values": [1.0, 2.0, 3.0],
        "x": ("g", 5, 10, 2),
        "y": ("m", 1, 2, 2),
    }


def _calls(n: int, sound: dict[str, Any]) -> Iterator[tuple[str, str, Any, Callable[[], Any]]]:
    """Yield random calls with one nonsense value: name, argument, value, call."""
    drawn, known = random.Random(42), list(_callables().items())
    while n:
        name, one = drawn.choice(known)
        try:
            arguments = list(inspect.signature(one).parameters.values())
        except ValueError:
            continue
        named = [a for a in arguments if a.kind in (a.POSITIONAL_OR_KEYWORD, a.KEYWORD_ONLY)]
        if not named or name in {"Workers", "Cluster"}:
            continue
        bad, value = drawn.choice(named), drawn.choice(VALUES)
        given = {a.name: sound.get(a.name, 1.0) for a in named if a.default is a.empty}
        given |= {"until": 0.5} if "until" in {a.name for a in named} else {}
        given[bad.name] = value
        yield name, bad.name, value, lambda one=one, given=given: one(**given)
        n -= 1


@pytest.mark.slow
@pytest.mark.weekly
@pytest.mark.filterwarnings("ignore")
def test_nonsense_is_refused_in_one_line_by_every_public_name(
    sound: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    raw, refused = list[str](), 0
    for name, argument, value, call in _calls(900, sound):
        try:
            call()
        except (zo.ZenoOrbitsError, ValueError) as error:
            refused += 1
            own = isinstance(error, zo.ZenoOrbitsError) or str(error).startswith("Argument `")
            if not own or "\n" in str(error):
                raw.append(f"{name}({argument}={value!r:.40}): {error!r:.200}")
        except Exception as error:  # noqa: BLE001
            raw.append(f"{name}({argument}={value!r:.40}): {error!r:.200}")
    assert raw == []
    assert refused > 500
