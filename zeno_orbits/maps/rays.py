r"""The smallest impulse along a ray after which a motion does not return to its orbit.

Basins of attraction may be nonconvex, so impulses are scanned before a loss is located. A motion
that starts near the boundary of a basin first follows an orbit of saddle type in it. It therefore
returns late, by :math:`\ln(1/d) / \ln\mu` periods at a distance `d` from the boundary, with
:math:`\mu` the unstable multiplier of the saddle. Where the return is later than at both
neighbours of the scan, or by more than one return later than at one of them, a loss may lie in
between, and further impulses are tried.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from zeno_orbits.maps.attractors import Attractor

_HALVINGS = 4
"""Halvings of a step next to which the return is late."""
_BUMP, _LEAP = 0.25, 1.5
"""Differences of neighbouring delays, in periods, next to which further impulses are tried: at a
delay above both its neighbours, and elsewhere. Returns are counted, so differences of one are
usual."""
_PARTS = 8
"""Parts into which an interval with a loss at its end is divided until it is short enough."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RayTrial:
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


UNPUSHED = RayTrial(impulse=0.0, beyond=None, delay=0.0)
"""The orbit itself."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ray:
    """A ray of impulses.

    Attributes:
        tried: Function from an impulse to its trial.
        period: Period of the orbit [s].
        error: Largest relative error of a located impulse.
    """

    tried: Callable[[float], RayTrial]
    period: float
    error: float

    def first_loss(self, reach: float, steps: int) -> Loss | None:
        """Return the smallest impulse with a loss up to a reach, or ``None`` without a loss.

        Args:
            reach: Largest impulse.
            steps: Number of equidistant impulses of the scan.
        """
        scan = [UNPUSHED]
        for k in range(1, steps + 1):
            trial = self.tried(k * reach / steps)
            if trial.beyond is not None:
                return self.located(scan, trial)
            scan.append(trial)
        hidden = self._hidden_loss(scan)
        return None if hidden is None else self.located(*hidden)

    def located(self, returns: Sequence[RayTrial], lost: RayTrial) -> Loss:
        """Locate the smallest impulse with a loss between returns and above them.

        Args:
            returns: Trials with a return, in increasing order, at least one.
            lost: Trial of a larger impulse with a loss.
        """
        returns = list(returns)
        while True:
            hidden = self._hidden_loss(returns)
            if hidden is not None:
                returns, lost = hidden
            kept = returns[-1].impulse
            part = (lost.impulse - kept) / _PARTS
            inside = [kept + k * part for k in range(1, _PARTS)]
            # Doubles may not resolve the interval.
            resolved = kept < inside[0] <= inside[-1] < lost.impulse
            if lost.impulse - kept <= self.error * lost.impulse or not resolved:
                if lost.beyond is None:
                    raise ValueError("Argument `lost` must be an impulse that loses the orbit.")
                return Loss(kept=kept, gone=lost.impulse, beyond=lost.beyond)
            returns = returns[-2:]
            for impulse in inside:
                trial = self.tried(impulse)
                if trial.beyond is not None:
                    lost = trial
                    break
                returns.append(trial)

    def _hidden_loss(self, scan: Sequence[RayTrial]) -> tuple[list[RayTrial], RayTrial] | None:
        """Return a loss between the returns of a scan, with the returns below it."""
        for place in range(1, len(scan)):
            before, here, *after = scan[place - 1 : place + 2]
            around = [before, here, *after]
            fallen = [here.delay - other.delay for other in (before, *after)]
            if len(fallen) < 2 or min(fallen) <= 0.0 or max(fallen) < _BUMP * self.period:
                if abs(fallen[0]) <= _LEAP * self.period:
                    continue
                around = [before, here]
            for _ in range(_HALVINGS):
                finer = around[:1]
                for low, high in pairwise(around):
                    trial = self.tried((low.impulse + high.impulse) / 2)
                    if trial.beyond is not None:
                        return finer, trial
                    finer += [trial, high]
                around = _around_latest(finer)
        return None


def _around_latest(trials: Sequence[RayTrial]) -> list[RayTrial]:
    """Return the trial inside with the latest return, and its neighbours."""
    top = max(range(1, len(trials) - 1), key=lambda k: trials[k].delay)
    return list(trials[top - 1 : top + 2])
