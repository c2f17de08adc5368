r"""The smallest impulse along a ray after which a motion does not return to its orbit.

Basins of attraction may be nonconvex, so impulses are scanned before a loss is located. A motion
that starts near the boundary of a basin first follows an orbit of saddle type in it. It therefore
returns late, by :math:`\ln(1/d) / \ln\mu` periods at a distance `d` from the boundary, with
:math:`\mu` the unstable multiplier of the saddle. Where the return is later than at both
neighbours of the scan, a loss may lie in between, and further impulses are tried.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from zeno_orbits.maps.attractors import Attractor

_CLIMBS = 4
"""Halvings of the steps next to an impulse whose return is later than at its neighbours."""
_PARTS = 8
"""Parts into which an interval with a loss at its end is divided until it is short enough."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """The motion after one impulse of a ray.

    Attributes:
        impulse: Size of the impulse.
        beyond: Attractor of a lost motion, or ``None`` if the motion returns to the orbit.
        delay: Time after which a returning motion only approaches the orbit [s].
    """

    impulse: float
    beyond: Attractor | None
    delay: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """The smallest impulse with a loss.

    Attributes:
        kept: Largest impulse below it with a return.
        gone: The impulse.
        beyond: Attractor of the lost motion.
    """

    kept: float
    gone: float
    beyond: Attractor


Try = Callable[[float], Trial]
"""Function from an impulse to its trial."""


def first_loss(tried: Try, reach: float, steps: int, error: float) -> Loss | None:
    """Return the smallest impulse with a loss up to a reach, or ``None`` without a loss.

    Args:
        tried: Function from an impulse to its trial.
        reach: Largest impulse.
        steps: Number of equidistant impulses of the scan.
        error: Largest relative error of the impulse.
    """
    scan = [Trial(impulse=0.0, beyond=None, delay=0.0)]
    for k in range(1, steps + 1):
        trial = tried(k * reach / steps)
        if trial.beyond is not None:
            return _located(tried, scan, trial, error)
        scan.append(trial)
    hidden = _hidden_loss(tried, scan)
    return None if hidden is None else _located(tried, *hidden, error)


def located(tried: Try, kept: float, lost: Trial, error: float) -> Loss:
    """Locate the smallest impulse with a loss between a return and a loss.

    Args:
        tried: Function from an impulse to its trial.
        kept: Impulse with a return.
        lost: A larger impulse with a loss.
        error: Largest relative error of the impulse.
    """
    return _located(tried, [Trial(impulse=kept, beyond=None, delay=0.0)], lost, error)


def _located(tried: Try, scan: Sequence[Trial], lost: Trial, error: float) -> Loss:
    """Locate the smallest impulse with a loss above the returns of a scan, and between them."""
    returns = list(scan)
    while True:
        hidden = _hidden_loss(tried, returns)
        if hidden is not None:
            returns, lost = hidden
        kept = returns[-1].impulse
        part = (lost.impulse - kept) / _PARTS
        inside = [kept + k * part for k in range(1, _PARTS)]
        # Doubles may not resolve the interval.
        resolved = kept < inside[0] <= inside[-1] < lost.impulse
        if lost.impulse - kept <= error * lost.impulse or not resolved:
            if lost.beyond is None:
                raise ValueError("Argument `lost` must be a loss.")
            return Loss(kept=kept, gone=lost.impulse, beyond=lost.beyond)
        returns = returns[-2:]
        for impulse in inside:
            trial = tried(impulse)
            if trial.beyond is not None:
                lost = trial
                break
            returns.append(trial)


def _hidden_loss(tried: Try, scan: Sequence[Trial]) -> tuple[list[Trial], Trial] | None:
    """Return a loss between the returns of a scan, and the returns around the gap below it."""
    for place in range(1, len(scan) - 1):
        around = list(scan[place - 1 : place + 2])
        if not around[0].delay < around[1].delay > around[2].delay:
            continue
        for _ in range(_CLIMBS):
            finer = around[:1]
            for low, high in pairwise(around):
                trial = tried((low.impulse + high.impulse) / 2)
                if trial.beyond is not None:
                    return finer, trial
                finer += [trial, high]
            top = max(range(1, len(finer) - 1), key=lambda k: finer[k].delay)
            around = finer[top - 1 : top + 2]
    return None
