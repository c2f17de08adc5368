r"""The end of an impact sequence in closed form: tail, limit and its error, without a model.

Near a Zeno point the impact speeds decrease by the factor :math:`e`, and the impact states lie on
an analytic curve in the speed :math:`w` (theory (2.7)). The constrained flow first propagates each
impact state to the end of its own tail, with an error of :math:`O(w^2)`. The limit is then the
value at :math:`w = 0` of a polynomial without linear term through the last few results.

Everything here applies to values and CasADi symbols alike, so the transcription and the simulator
close an orbit by the same formula. Source: [OrAmes2011]_ for the tail.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import Step, fast_dataclass
from zeno_orbits.model import UNIT_SCALES, CharacteristicScales, ContactProjection, HybridDynamics

N_NODES = 5
"""Impacts that the extrapolation uses at most."""

NODE_RATIO = 0.5
"""Speeds of successive nodes differ at least by this factor, because closer nodes amplify
rounding."""


_FALLEN = 2.0**-60
"""Part of a speed below which later speeds do not change a sum."""
_MOST_FALLS = 100_000
"""Largest number of impacts whose speeds are added."""


def tail_time(speed: Any, gap_acceleration: Any, restitution: Any) -> Any:
    r"""Return the time from an impact to the Zeno point, to first order in the speed [s].

    .. math:: \sum_{k \ge 0} \frac{2 w e^k}{|\ddot h|} = \frac{2 w}{|\ddot h|\,(1 - e)}

    Args:
        speed: :math:`w`, gap rate just after the impact.
        gap_acceleration: :math:`\ddot h < 0` at the impact.
        restitution: :math:`e`.
    """
    return 2 * speed / (-gap_acceleration * (1 - restitution))


def speeds_excess(dynamics: HybridDynamics, speed: float) -> float:
    r"""Return the sum of an impact's speed and all later speeds, minus the geometric sum.

    The speeds are those of a constant gap acceleration, :math:`w_{k+1} = e(w_k)\,w_k`, and

    .. math:: \sum_{k \ge 0} w_k - \frac{w_0}{1 - e}
        = \sum_{k \ge 0} \frac{w_{k+1} - e\,w_k}{1 - e}

    with the restitution :math:`e` at speed zero. It is zero if the restitution is constant, and
    infinite if the speeds do not fall.

    Args:
        dynamics: The system, for its law of impact.
        speed: :math:`w_0`, the gap rate just after an impact.
    """
    if dynamics.restitution_at is None:
        return 0.0
    e, w, excess = dynamics.restitution, speed, 0.0
    for _ in range(_MOST_FALLS):
        if not w > _FALLEN * speed:
            return excess
        after = dynamics.speed_after(-w)
        excess += (after - e * w) / (1 - e)
        w = after
    return excess if not w > _FALLEN * speed else math.inf


def law_error(
    dynamics: HybridDynamics, estimates: Sequence[TailEstimate], limit: ZenoLimit
) -> float:
    r"""Return the error of a limit that the change of the restitution with the speed causes.

    The estimates assume that the tail contracts by :math:`e(0)`. At a constant gap acceleration
    the sums of the speeds give their errors exactly, for any law, and the extrapolation applies to
    these errors. A law that is analytic at speed zero leaves almost nothing. A law with a kink or a
    root leaves an error until the last impacts are slow enough.

    Args:
        dynamics: The system.
        estimates: The tail estimates of the sequence, at least one.
        limit: Their extrapolated limit.

    Returns:
        The error, relative to ``1 + |t|`` and ``1 + |x|`` as in `ZenoLimit`.
    """
    last = estimates[-1]
    tail = last.time - last.impact_time
    if dynamics.restitution_at is None or not tail > 0.0:
        return 0.0
    speeds = [estimate.speed for estimate in estimates]
    nodes = [speeds[k] for k in spread_nodes(speeds)]
    excess = 0.0
    for weight, speed in zip(limit_weights(nodes), nodes, strict=True):
        excess += weight * speeds_excess(dynamics, speed)
    late = abs(2 * excess / -last.gap_acceleration)
    if math.isnan(late):
        return math.inf
    sizes = dynamics.own.states(len(last.state)).tolist()
    told = zip(last.resting.tolist(), last.state.tolist(), limit.state.tolist(), sizes, strict=True)
    change = [
        abs((end - rested) * (late / tail)) / (size + abs(x)) for rested, end, x, size in told
    ]
    return max(late / (dynamics.own.time + abs(limit.time)), *change)


def limit_weights(speeds: Sequence[Any]) -> list[Any]:
    r"""Return the weights, at :math:`w = 0`, of the polynomial without linear term in the nodes.

    .. math:: \alpha_k = \frac{1/w_k}{\sum_j 1/w_j} \prod_{j \ne k} \frac{w_j}{w_j - w_k}

    The tail estimates of one orbit differ from their limit by :math:`O(w^2)`: no linear term.
    """
    if len(speeds) == 1:
        return [1.0]
    shares = [speeds[-1] / speed for speed in speeds]
    total = sum(shares[1:], shares[0])
    weights: list[Any] = []
    for k, speed in enumerate(speeds):
        product: Any = 1.0
        for j, other in enumerate(speeds):
            if j != k:
                product *= other / (other - speed)
        weights.append(shares[k] / total * product)
    return weights


def limit_slopes(speeds: Sequence[float]) -> Vector:
    r"""Return the derivatives of the weights, a row each, by logarithms of the speeds, ``(n, n)``.

    .. math:: \frac{\partial \ln \alpha_k}{\partial \ln w_j} =
        \frac{1/w_j}{\sum_i 1/w_i} - \begin{cases}
            w_k / (w_j - w_k) & j \ne k\\
            1 - \sum_{i \ne k} w_k / (w_i - w_k) & j = k
        \end{cases}

    Logarithms, as the speeds may be as small as numbers get.
    """
    w = np.array(speeds)
    weights = np.array(limit_weights(speeds))
    shares = w[-1] / w
    apart = w[None, :] - w[:, None] + np.eye(len(w))
    quotients = w[:, None] / apart * (1 - np.eye(len(w)))
    diagonal = np.diag(1 - np.sum(quotients, axis=1))
    return np.asarray(weights[:, None] * (shares / np.sum(shares) - quotients - diagonal))


def spread_nodes(speeds: Sequence[float]) -> list[int]:
    """Return the indices of the decreasing speeds that serve for the extrapolation.

    Args:
        speeds: Impact speeds, decreasing, ``(n,)``.

    Returns:
        At most ``N_NODES`` increasing indices: the last speed and faster speeds before it, with
        speeds of neighbours that differ at least by ``NODE_RATIO``.
    """
    nodes = [len(speeds) - 1]
    while len(nodes) < N_NODES:
        wanted = speeds[nodes[-1]] / NODE_RATIO
        before = nodes[-1] - 1
        if before >= 0 and 0.0 < wanted <= speeds[before]:
            # Mostly the speeds fall that fast at every impact.
            nodes.append(before)
            continue
        earlier = bisect_right(speeds, -wanted, key=lambda speed: -speed) - 1
        if earlier < 0 or wanted == 0.0:
            break
        nodes.append(earlier)
    return nodes[::-1]


@fast_dataclass
class TailEstimate:
    """First-order estimate of the Zeno point from an impact, compared by identity.

    Attributes:
        impact_time: Time of the impact [s].
        resting: State just after a hypothetical plastic impact, ``(n_x,)``.
        speed: Gap rate just after the impact.
        time: Zeno time, from the same origin [s].
        state: Zeno state, ``(n_x,)``.
        gap_acceleration: Gap acceleration at the impact.
        beside: The switches of dry friction in the flight before the impact.
    """

    impact_time: float
    resting: Vector
    speed: float
    time: float
    state: Vector
    gap_acceleration: float
    beside: frozenset[int] = frozenset()


@fast_dataclass
class ZenoLimit:
    """The Zeno point of an impact sequence.

    Attributes:
        time: Zeno time [s].
        state: Zeno state, ``(n_x,)``, on the stop.
        error: Estimated error of time and state for exact impacts, relative to ``1 + |t|`` and ``1
            + |x|``, with the 1 in the problem's scales. It is the difference from the limit
            computed from the impacts up to the previous node.
        path: The states on the stop after the last impact, if they are known, with times since that
            impact. The omitted flights lie above them.
    """

    time: float
    state: Vector
    error: float
    path: tuple[Step, ...] = ()


def estimate_tail(
    dynamics: HybridDynamics, time: float, state_plus: Vector, speed: float
) -> TailEstimate | None:
    """Return the first-order Zeno point seen from an impact, or ``None`` if contact cannot persist.

    Args:
        dynamics: The system.
        time: Time of the impact [s].
        state_plus: State just after it.
        speed: Exact gap rate just after the impact. The state determines it only to rounding.
    """
    return tail_from(dynamics.resting(state_plus), dynamics.restitution, time, speed)


def tail_from(
    resting: ContactProjection, restitution: float, time: float, speed: float
) -> TailEstimate | None:
    """Return the same from the state after an impact moved onto the stop.

    Elastic impacts (:math:`e = 1`) have no Zeno point, and the result is ``None``.

    Args:
        resting: That state.
        restitution: :math:`e`.
        time: Time of the impact [s].
        speed: Gap rate just after it, exactly.
    """
    if not resting.gap_acceleration < 0.0 or restitution == 1.0:
        return None
    remaining = tail_time(speed, resting.gap_acceleration, restitution)
    return TailEstimate(
        impact_time=time,
        resting=resting.state,
        speed=speed,
        time=time + remaining,
        state=resting.state + remaining * resting.rate,
        gap_acceleration=resting.gap_acceleration,
    )


def join(
    estimates: Sequence[TailEstimate], last: TailEstimate, beside: frozenset[int]
) -> list[TailEstimate]:
    r"""Return the estimates of a sequence with that of one more impact.

    A part with dry friction that every impact moves changes the ratio of the speeds. The estimate
    is then the line through the impact and the previous one, at speed zero. All estimates of a
    sequence have the same switches in their flights, so they lie on one curve.

    .. math:: x_\infty \approx x_1 + \frac{w_1}{w_0 - w_1}\,(x_1 - x_0)

    Args:
        estimates: Those so far.
        last: The estimate without switches. Its speed is below theirs.
        beside: The switches of dry friction in the flight before the impact.
    """
    if not estimates:
        return [last]
    before = estimates[-1]
    known = list(estimates) if before.beside == beside else []
    if beside:
        share = last.speed / (before.speed - last.speed)
        last = replace(
            last,
            time=last.impact_time + share * (last.impact_time - before.impact_time),
            state=last.resting + share * (last.resting - before.resting),
            beside=beside,
        )
    return [*known, last]


def extrapolate(dynamics: HybridDynamics, estimates: Sequence[TailEstimate]) -> ZenoLimit:
    """Return the Zeno point from the tail estimates of a sequence of impacts at falling speeds.

    Args:
        dynamics: The system.
        estimates: One an impact, at least one. With a single one the error is unknown: infinite,
            or zero if the impact was plastic.
    """
    limit = combine(estimates, dynamics.own)
    error = limit.error + law_error(dynamics, estimates, limit)
    return ZenoLimit(time=limit.time, state=dynamics.on_stop(limit.state), error=error)


def combine(
    estimates: Sequence[TailEstimate], own: CharacteristicScales = UNIT_SCALES
) -> ZenoLimit:
    """Return the extrapolated limit before its projection onto the stop.

    The error estimate is the difference from the limit computed from the impacts up to the previous
    node. It is the error of that limit, and so larger than the error of this limit. Omitting the
    fastest node would not give an error estimate: if the boundary layer of the current is longer
    than the last flights, that node has almost zero weight.

    Args:
        estimates: As for `extrapolate`.
        own: Characteristic scales of the problem.
    """
    speeds = [estimate.speed for estimate in estimates]
    chosen = spread_nodes(speeds)
    time, state = _limit(tuple([estimates[k] for k in chosen]))
    if len(chosen) == 1:
        error = 0.0 if speeds[-1] == 0.0 else math.inf
    else:
        earlier = spread_nodes(speeds[: chosen[-2] + 1])
        time_before, state_before = _limit(tuple([estimates[k] for k in earlier]))
        # A few plain numbers: as arrays they would cost twice as much.
        sizes = own.states(len(state)).tolist()
        told = zip(state.tolist(), state_before.tolist(), sizes, strict=True)
        change = [abs(x - before) / (size + abs(x)) for x, before, size in told]
        error = max(abs(time - time_before) / (own.time + abs(time)), *change)
    return ZenoLimit(time=time, state=state, error=error)


@lru_cache(maxsize=8)
def _limit(nodes: tuple[TailEstimate, ...]) -> tuple[float, Vector]:
    """Return time and state of the limit of a polynomial through these nodes.

    It is cached: the limit from an impact is compared with the limit from the next impact.
    """
    weights = limit_weights([node.speed for node in nodes])
    time = sum([weight * node.time for weight, node in zip(weights, nodes, strict=True)])
    # In the order of the nodes: whoever sums in another order gets other last digits.
    state = weights[0] * nodes[0].state
    for weight, node in zip(weights[1:], nodes[1:], strict=True):
        state = state + weight * node.state
    state.flags.writeable = False
    return time, state
