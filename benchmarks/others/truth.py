"""The answer that all are held against: heyoka in 80-bit arithmetic, its tolerance at rounding.

Impacts are made plastic below 1e-5 rad/s, which costs about 1.5e-21 (docs/theory.md (11)). The
driver holds it together with a second one, which shares neither model nor integrator nor treatment
of the Zeno point: ours at 1e-13 where that is affordable.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

import heyoka_by_hand
import numpy as np
import work
from work import Method, Motion


def prepare(
    rate: float, accuracy: float, start: Sequence[float], locked: bool
) -> Callable[[], Motion]:
    """Compile, and return the whole motion as a function without arguments."""
    hand = heyoka_by_hand.Hand(rate, accuracy, np.longdouble, 1e-5)
    return lambda: hand.follow(start, locked)


METHODS = [
    Method(
        name="80 bits",
        accuracies=(float(np.finfo(np.longdouble).eps),),
        sweep_accuracies=(float(np.finfo(np.longdouble).eps),),
        prepare=prepare,
    )
]

if __name__ == "__main__":
    sys.exit(work.serve(__doc__, METHODS, heyoka_by_hand.version))
