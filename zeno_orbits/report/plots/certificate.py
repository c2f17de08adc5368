# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""A certificate: residuals against the tolerance, and Floquet multipliers in the unit circle."""

from __future__ import annotations

import math

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from zeno_orbits.report.plots.style import (
    COLUMN_WIDTH,
    FULL_WIDTH,
    INK,
    LEAST_ERROR,
    PALETTE,
    add_legend,
)
from zeno_orbits.verification import RESIDUALS, OrbitCertificate

_PASSED, _FAILED = PALETTE[:2]


def plot_certificate(certificate: OrbitCertificate, *, width: float = FULL_WIDTH) -> Figure:
    """Return the residuals of a certificate and the Floquet multipliers in the unit circle.

    Args:
        certificate: The certificate.
        width: Width of the picture [in].
    """
    wide = width > 1.5 * COLUMN_WIDTH
    height = 0.17 * len(certificate.residuals) + 0.9
    figure = Figure(figsize=(width, height if wide else height + 2.6), layout="constrained")
    shape = (1, 2) if wide else (2, 1)
    ratios = {"width_ratios": (3, 2)} if wide else {"height_ratios": (height, 2.6)}
    grid = figure.add_gridspec(*shape, **ratios)
    _draw_residuals(figure.add_subplot(grid[0]), certificate)
    _draw_multipliers(figure.add_subplot(grid[1]), certificate)
    add_legend(figure, width)
    return figure


def _draw_residuals(ax: Axes, certificate: OrbitCertificate) -> None:
    """Draw a row a residual in causal order; one that is not finite reaches the frame."""
    names = [name for name in RESIDUALS if name in certificate.residuals]
    sizes = [certificate.residuals[name] for name in names]
    finite = [size for size in sizes if math.isfinite(size)]
    right = 30 * max([certificate.tolerance, *finite])
    for row, size in enumerate(sizes):
        passed = size <= certificate.tolerance
        ax.plot(
            [LEAST_ERROR, min(max(size, LEAST_ERROR), right)],
            [row, row],
            color=_PASSED if passed else _FAILED,
            lw=4.0,
            solid_capstyle="butt",
            label="residual, passed" if passed else "residual, failed",
        )
    ax.axvline(certificate.tolerance, color=INK, lw=1.0, ls="--", label="tolerance")
    ax.set(xscale="log", xlim=(LEAST_ERROR, right), xlabel="relative residual [1]")
    ax.set_yticks(range(len(names)), labels=[name.replace("_", " ") for name in names])
    ax.invert_yaxis()


def _draw_multipliers(ax: Axes, certificate: OrbitCertificate) -> None:
    ax.add_patch(Circle((0.0, 0.0), 1.0, fill=False, ec=INK, lw=0.8, ls=(0, (3, 2))))
    values = certificate.multipliers
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
