# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""The largest pushes of an orbit over its phase, one panel for each direction."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from zeno_orbits.maps import Push, Pushes
from zeno_orbits.report.plots.panels import panels_of
from zeno_orbits.report.plots.style import FULL_WIDTH, INK, PALETTE, TINTS
from zeno_orbits.simulation import Mode

_ROOM = 1.12
"""Height of a panel over the largest impulse in it."""


def plot_pushes(found: Pushes, *, width: float = FULL_WIDTH, axes: Sequence[Axes] = ()) -> Figure:
    """Return the largest impulses over the phase, negative senses below zero.

    Args:
        found: The pushes.
        width: Width of the picture [in].
        axes: Panels to draw into, one for each direction. The default is a new figure.
    """
    groups: dict[frozenset[tuple[str, float]], list[Push]] = {}
    for push in found.pushes:
        line = frozenset((name, abs(entry)) for name, entry in push.direction.items())
        groups.setdefault(line, []).append(push)
    panels = panels_of(width, len(groups), height=2.4, axes=axes)
    for ax, pushes in zip(panels, groups.values(), strict=True):
        _draw(ax, pushes)
        along = next(push.name.lstrip("+") for push in pushes if push.is_positive)
        ax.set(xlabel="phase [1]", ylabel=f"impulse along {along} [{pushes[0].unit}]")
    return panels.finished()


def _draw(ax: Axes, pushes: Sequence[Push]) -> None:
    """Draw both signs of one direction: returning pushes are filled, lost pushes are marked."""
    phases = sorted({push.phase for push in pushes})
    step = phases[1] - phases[0] if len(phases) > 1 else 1.0
    for push in pushes:
        if push.mode == Mode.LOCKED.value and push.is_positive:
            ax.axvspan(
                push.phase - step / 2,
                push.phase + step / 2,
                color=TINTS[Mode.LOCKED],
                lw=0,
                label="contact",
            )
    for positive, sense in ((True, 1.0), (False, -1.0)):
        half = [push for push in pushes if push.is_positive is positive]
        ends = [
            sense * (push.searched if math.isnan(push.largest) else push.largest) for push in half
        ]
        at = [push.phase for push in half]
        ax.bar(at, ends, width=0.8 * step, color=PALETTE[0], alpha=0.35, lw=0, label="returns")
        lost = [(push.phase, sense * push.largest) for push in half if math.isfinite(push.largest)]
        open_ = [(push.phase, sense * push.searched) for push in half if math.isnan(push.largest)]
        if lost:
            ax.plot(
                *zip(*lost, strict=True),
                ls="",
                marker="o",
                ms=4,
                color=PALETTE[1],
                label="lost beyond",
            )
        if open_:
            ax.plot(
                *zip(*open_, strict=True),
                ls="",
                marker="o",
                ms=4,
                mfc="none",
                color=INK,
                label="end of the scan",
            )
    ax.axhline(0.0, color=INK, lw=0.6)
    top = _ROOM * max(
        push.searched if math.isnan(push.largest) else push.largest for push in pushes
    )
    ax.set(xlim=(phases[0] - step / 2, phases[-1] + step / 2), ylim=(-top, top))
