"""The Zeno limits of many impact sequences at once: `zeno.combine` in rows, theory (15)."""

from __future__ import annotations

import numpy as np

from zeno_orbits.arrays import Rows, Vector
from zeno_orbits.simulation.zeno_limit import N_NODES, NODE_RATIO

_FIRST_LENGTH = 32
"""Impacts of a sequence that there is room for at first; the room doubles when it is full."""


class Tails:
    """First-order Zeno points of the impact sequence that each lane is in.

    Attributes:
        count: Impacts of the sequence so far, ``(n_lanes,)``.
        speed: Gap rate after each, falling, ``(n_lanes, n)``.
    """

    def __init__(self, n_lanes: int, unit: Vector) -> None:
        """Make room.

        Args:
            n_lanes: For how many.
            unit: Size of a time and of each state, ``(n_x + 1,)``.
        """
        self._unit = unit
        self.count = np.zeros(n_lanes, dtype=np.intp)
        self.speed = np.zeros((n_lanes, _FIRST_LENGTH))
        self._point = np.zeros((n_lanes, _FIRST_LENGTH, len(unit)))

    def clear(self, lanes: Rows) -> None:
        """Forget the sequences of some lanes."""
        self.count[lanes] = 0

    def last_speed(self, lanes: Rows) -> Vector:
        """Return the speeds after the last impacts; infinite where there were none."""
        count = self.count[lanes]
        return np.where(count > 0, self.speed[lanes, np.maximum(count - 1, 0)], np.inf)

    def append(self, lanes: Rows, speed: Vector, time: Vector, state: Vector) -> None:
        """Add an impact and the Zeno point to first order that it tells.

        Args:
            lanes: The lanes, ``(n,)``.
            speed: Gap rates after the impacts, ``(n,)``.
            time: Zeno times [s], ``(n,)``.
            state: Zeno states, ``(n, n_x)``.
        """
        at = self.count[lanes]
        if len(at) and int(at.max()) >= self.speed.shape[1]:
            self.speed = np.concatenate([self.speed, np.zeros_like(self.speed)], axis=1)
            self._point = np.concatenate([self._point, np.zeros_like(self._point)], axis=1)
        self.speed[lanes, at] = speed
        self._point[lanes, at, 0] = time
        self._point[lanes, at, 1:] = state
        self.count[lanes] += 1

    def limits(self, lanes: Rows, leaders: Rows) -> tuple[Vector, Vector, Vector]:
        """Return times, states and estimated relative errors of the Zeno limits.

        Args:
            lanes: Which lanes, ``(n,)``.
            leaders: The lane that says from which impacts each is extrapolated, ``(n,)``.
        """
        nodes = self._nodes(leaders, self.count[leaders] - 1)
        limit = self._limit(lanes, nodes)
        alone = nodes[:, 1] < 0
        earlier = self._nodes(leaders, np.where(alone, nodes[:, 0], nodes[:, 1]))
        before = self._limit(lanes, earlier)
        change = np.abs(limit - before) / (self._unit + np.abs(limit))
        error = np.where(alone, np.where(self.last_speed(lanes) == 0.0, 0.0, np.inf), 0.0)
        return limit[:, 0], limit[:, 1:], np.maximum(error, change.max(axis=1))

    def _nodes(self, lanes: Rows, last: Rows) -> Rows:
        """Return the impacts to extrapolate from, the slowest first, -1 where there are no more."""
        nodes = np.empty((len(lanes), N_NODES), dtype=np.intp)
        nodes[:, 0] = last
        longest = int(last.max(initial=0)) + 1
        speed = self.speed[lanes, :longest]
        within = np.arange(longest) <= last[:, None]
        rows = np.arange(len(lanes))
        for k in range(1, N_NODES):
            wanted = speed[rows, nodes[:, k - 1]] / NODE_RATIO
            faster = np.sum(within & (speed >= wanted[:, None]), axis=1) - 1
            more = (nodes[:, k - 1] >= 0) & (wanted > 0.0) & (faster >= 0)
            nodes[:, k] = np.where(more, faster, -1)
        return nodes

    def _limit(self, lanes: Rows, nodes: Rows) -> Vector:
        """Return times and states at speed zero of the polynomials through the nodes."""
        used = nodes >= 0
        picked = np.maximum(nodes, 0)
        speed = np.where(used, self.speed[lanes[:, None], picked], np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = speed[:, :1] / speed
            weight = share / share.sum(axis=1, keepdims=True)
            for k in range(N_NODES):
                other = speed[:, k : k + 1]
                factor = np.where(np.isfinite(other), other / (other - speed), 1.0)
                factor[:, k] = 1.0
                weight = weight * factor
        weight = np.where(used, weight, 0.0)
        weight[nodes[:, 1] < 0] = np.eye(N_NODES)[0]
        point = self._point[lanes[:, None], picked]
        return np.einsum("nk,nkj->nj", weight, point)
