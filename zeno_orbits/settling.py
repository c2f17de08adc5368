"""Whether the impacts of a sequence have come onto their curve (theory (22))."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from zeno_orbits.fibre import relative
from zeno_orbits.zeno import TailEstimate

_DIFFERENCES = 4
"""Differences of successive impacts that tell a transient from the curve."""
_SEEN = 3e-14
"""A relative difference below this is rounding."""
_SMOOTH = 0.01
"""Fourth difference along a curve, for a unit of `(1 - e)^4`, at most about."""
_DECAYED = 1e-12
"""Amplitude of a transient that is over."""
_WORTH_WAITING = 150
"""Impacts that cost less than the pieces of a layer."""


def is_settled(estimates: Sequence[TailEstimate], restitution: float) -> bool:
    r"""Tell whether the curve of the impacts is worth a try, as far as the last six tell.

    Along the curve a state changes smoothly over :math:`1 / (1 - e)` impacts, and the fourth
    difference of successive ones is of the order :math:`(1 - e)^4`. A transient
    :math:`a \mu^k` adds :math:`a (1 - \mu)^4 \mu^k`, and two such differences tell `a` and
    :math:`\mu`. If it decays in a few impacts, they are better made. One that takes many is a layer
    of the curve.

    Args:
        estimates: One an impact.
        restitution: :math:`e`.
    """
    if len(estimates) < _DIFFERENCES + 2:
        return False
    states = np.array([estimate.resting for estimate in estimates[-_DIFFERENCES - 2 :]])
    differences = np.diff(states, n=_DIFFERENCES, axis=0)
    before, now = (relative(difference, states[-1]) for difference in differences)
    if now <= _SEEN + _SMOOTH * (1 - restitution) ** _DIFFERENCES or now >= before:
        return True
    ratio = now / before
    amplitude = now / (1 - ratio) ** _DIFFERENCES
    return math.log(amplitude / _DECAYED) > -_WORTH_WAITING * math.log(ratio)
