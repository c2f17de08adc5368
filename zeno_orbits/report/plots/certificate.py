# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""A certificate: residuals against the tolerance, and Floquet multipliers in the unit circle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from zeno_orbits.report.plots.panels import is_wide, panels_of
from zeno_orbits.report.plots.style import COLUMN_WIDTH, FULL_WIDTH, INK, PALETTE, TEXT
from zeno_orbits.verification import RESIDUALS, OrbitCertificate

_PASSED, _FAILED = PALETTE[:2]


def plot_certificate(
    certificate: OrbitCertificate, *, width: float = FULL_WIDTH, axes: Sequence[Axes] = ()
) -> Figure:
    """Return the residuals of a certificate and the Floquet multipliers in the unit circle.

    Args:
        certificate: The certificate.
        width: Width of the picture [in].
        axes: Two panels to draw into, by default on a new figure.
    """
    wide, height = is_wide(width), 0.17 * len(certificate.residuals) + 0.4
    panels = panels_of(
        width,
        2,
        height=(height,) if wide else (height, 2.6),
        columns=2 if wide else 1,
        widths=(3, 2) if wide else None,
        axes=axes,
    )
    residuals, multipliers = panels
    _draw_residuals(residuals, certificate)
    _draw_multipliers(multipliers, certificate.multipliers)
    return panels.finished()


def plot_multipliers(
    values: Sequence[complex], *, width: float = COLUMN_WIDTH, axes: Sequence[Axes] = ()
) -> Figure:
    """Return Floquet multipliers in the unit circle.

    Args:
        values: The multipliers.
        width: Width of the picture [in].
        axes: One panel to draw into, by default on a new figure.
    """
    panels = panels_of(width, 1, height=0.8 * width, axes=axes)
    _draw_multipliers(panels.axes[0], values)
    return panels.finished()


def _draw_residuals(ax: Axes, certificate: OrbitCertificate) -> None:
    """Draw one row per residual in causal order. Zero and nonfinite values are words, not bars."""
    names = [name for name in RESIDUALS if name in certificate.residuals]
    sizes = [certificate.residuals[name] for name in names]
    shown = [size for size in (*sizes, certificate.tolerance) if math.isfinite(size) and size > 0.0]
    left, right = 0.1 * min(shown), 30 * max(shown)
    for row, size in enumerate(sizes):
        passed = size <= certificate.tolerance
        colour = _PASSED if passed else _FAILED
        label = "residual, passed" if passed else "residual, failed"
        if size in shown:
            look: dict[str, Any] = {"lw": 4.0, "solid_capstyle": "butt"}
            ax.plot([left, size], [row, row], color=colour, label=label, **look)
        else:
            words = "0" if size == 0.0 else "never reached"
            ax.text(1.3 * left, row, words, color=colour, size=TEXT - 1, va="center")
    ax.axvline(certificate.tolerance, color=INK, lw=1.0, ls="--", label="tolerance")
    ax.set(xscale="log", xlim=(left, right), xlabel="relative residual [1]")
    ax.set_yticks(range(len(names)), labels=[name.replace("_", " ") for name in names])
    ax.set_ylim(len(names) - 0.5, -0.5)


def _draw_multipliers(ax: Axes, values: Sequence[complex]) -> None:
    ax.add_patch(Circle((0.0, 0.0), 1.0, fill=False, ec=INK, lw=0.8, ls=(0, (3, 2))))
    for value in values:
        inside = abs(value) < 1.0
        ax.plot(
            value.real,
            value.imag,
            ls="",
            marker="o" if inside else "X",
            ms=6.0,
            mec=INK,
            mfc=_PASSED if inside else _FAILED,
            label="multiplier inside the circle" if inside else "multiplier outside the circle",
        )
    reach = 1.15 * max([1.0, *(abs(value) for value in values)])
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    ax.set(xlabel="real part [1]", ylabel="imaginary part [1]")
    ax.grid(visible=True, lw=0.4, alpha=0.5)
