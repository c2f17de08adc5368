"""The C code of a compiled leg: numbers of the event search and `fall.c`, then `follow.c`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from zeno_orbits.integrators import automatic, dop853, events, flow, radau, steps
from zeno_orbits.integrators.collocation import Collocation


def fall_source() -> str:
    """Return the C code that finds where in a step a guard falls."""
    numbers = {
        "CUBIC": events.CUBIC,
        "CUBIC_STEPS": events.CUBIC_STEPS,
        "HALVINGS": events.HALVINGS,
        "TINY": events.TINY,
        "DOUBLES": events.DOUBLES,
        "POLISH": events.POLISH,
    }
    return _with_numbers(numbers, "fall.c")


def follow_source(n_y: int, n_factors: int, scheme: Collocation) -> str:
    """Return the C code of the loop over the steps of a mode.

    Args:
        n_y: Number of states.
        n_factors: Entries of the factors of Newton's matrices.
        scheme: Of the implicit steps.
    """
    numbers: dict[str, float | int] = {
        "N_Y": n_y,
        "N_S": scheme.n_stages,
        "N_FACTORS": n_factors,
        "FIRST_ITERATIONS": flow.FIRST_ITERATIONS,
        "MOST_ITERATIONS": steps.MOST_ITERATIONS,
        "NEWTON_SHARE": steps.NEWTON_SHARE,
        "NEWTON_FLOOR": steps.NEWTON_FLOOR,
        "EXPLICIT_SAFETY": dop853.SAFETY,
        "EXPLICIT_SHRINK": dop853.SHRINK,
        "EXPLICIT_GROW": dop853.GROW,
        "EXPLICIT_EXPONENT": dop853.EXPONENT,
        "IMPLICIT_SAFETY": radau.SAFETY,
        "IMPLICIT_SHRINK": radau.SHRINK,
        "IMPLICIT_GROW": radau.GROW,
        "UNSOLVED": radau.UNSOLVED,
        "FIRST_LOOK": automatic.FIRST_LOOK,
        "PATIENCE": automatic.PATIENCE,
        "HELD": automatic.HELD,
        "STUCK": automatic.STUCK,
        "PAYS": automatic.PAYS,
        "LONG_LEFT": automatic.LONG,
        "FIRST_STEP": automatic.FIRST_STEP,
        "LEAVES": events.LEAVES,
    }
    entries = ", ".join(repr(float(entry)) for entry in scheme.monomials.ravel())
    monomials = f"static const double MONOMIALS[] = {{{entries}}};"
    return "\n".join((fall_source(), monomials, _with_numbers(numbers, "follow.c")))


def _with_numbers(numbers: Mapping[str, float], file: str) -> str:
    lines = [f"#define {name} ({value!r})" for name, value in numbers.items()]
    code = Path(__file__).with_name(file).read_text(encoding="utf-8")
    return "\n".join((*lines, code))
