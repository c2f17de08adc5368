# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""Animation of a mechanism with its phase portraits: GIF, and MP4 if ffmpeg is installed."""

from __future__ import annotations

import io
import math
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.report.motion import GROUND, STOP, MachineMotion, frame_of, machine_motion
from zeno_orbits.report.paths import drawn_paths
from zeno_orbits.report.plots.looks import Looks, looks_of, mark_switches
from zeno_orbits.report.plots.mechanism import label_lengths
from zeno_orbits.report.plots.panels import Panels
from zeno_orbits.report.plots.style import (
    ARCS,
    FULL_WIDTH,
    INK,
    JUMP,
    TEXT,
    mark_completion,
)
from zeno_orbits.report.symbols import label_of
from zeno_orbits.simulation import Execution
from zeno_orbits.work import scratch_folder

_RATE = 25
"""Frames per second of display [1/s]."""
_FEWEST, _MOST = 40, 250
"""Smallest and largest number of frames of an animation: two to ten seconds for any period."""
_DOTS = 160
"""Of the animation, an inch."""
_FEW_DOTS = 100
"""The same for the larger picture of a machine that advances."""
_COLOURS = 63
_KEPT = 63
"""Palette index that keeps the colour of the previous frame."""
_TRAIL = 0.12
"""Part of the period that is drawn as a trail of the moving points."""
_PORTRAITS = 2
"""Largest number of legible portraits next to a mechanism."""
_TALL = 3.8
"""Height of the picture [in]."""
_LOW = 2.4
"""Height of portraits below a machine that advances [in]."""
_BETWEEN = 0.7
"""Height of the titles and labels between them [in]."""
_STILL = (STOP, GROUND)
"""Lines that are drawn in ink."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Film:
    """The pictures of an animation.

    Attributes:
        frames: In order, all of one size.
        rate: Pictures a second [1/s].
    """

    frames: tuple[Image.Image, ...]
    rate: int


def film_of(
    problem: Problem,
    values: ParameterValues,
    execution: Execution,
    period: float,
    *,
    periods: int = 1,
) -> Film:
    """Return periods of a mechanism in motion with its first two phase portraits.

    A machine that advances has its panel above the portraits, at the width of the picture.

    Args:
        problem: The problem, which must have a drawing.
        values: Parameter values of the problem.
        execution: The periods, from the start of one.
        period: Period [s].
        periods: Number of periods to show.

    Raises:
        InputError: If the problem lacks a drawing.
    """
    one = int(np.clip(round(period * _RATE), _FEWEST, _MOST))
    count = min(periods * one, max(_MOST, one))
    duration = periods * period
    motion = machine_motion(problem, values, execution, duration, n=count)
    times, states, lines = motion.times, motion.states, motion.lines
    pairs = [
        [problem.state_names.index(name) for name in pair]
        for pair in problem.portraits[:_PORTRAITS]
    ]
    figure, machine, portraits = _panels(motion, len(pairs))
    canvas, looks = FigureCanvasAgg(figure), looks_of(execution)
    parts = _draw_machine(machine, motion)
    points = [
        _draw_portrait(ax, problem, execution, looks, pair)
        for ax, pair in zip(portraits, pairs, strict=True)
    ]
    slower = count / _RATE / duration
    if abs(slower - 1.0) > 0.1:
        words = "slower" if slower > 1.0 else "faster"
        portraits[0].set_title(f"shown {max(slower, 1 / slower):.2g} times {words}", size=TEXT)
    shown = (*portraits, machine)
    Panels(figure=figure, axes=shown, width=FULL_WIDTH, is_own=True).finished()
    machine.set_title("Zeno model", size=TEXT)
    # The layout runs once, and twice for parts that depend on the first run: only the mechanism may
    # move.
    canvas.draw()
    canvas.draw()
    figure.set_layout_engine("none")
    digits = max(0, 2 - math.floor(math.log10(period)))
    frames: list[Image.Image] = []
    for k, time in enumerate(times.tolist()):
        mode, closed = motion.modes[k], motion.closed[k]
        colour = looks.colour(closed) if closed else ARCS[mode]["color"]
        for name, part in parts.items():
            part.set_data(*lines[name][k].T)
            part.set_color(INK if name in _STILL else colour)
        start = _trail_start(execution, times, k)
        for (dot, trail), pair in zip(points, pairs, strict=True):
            dot.set_data(*states[[k]][:, pair].T)
            dot.set_markerfacecolor(colour)
            trail.set_data(*states[start : k + 1, pair].T)
        machine.set_title(
            f"Zeno model at {time:.{digits}f} s: {looks.mode(mode, closed)}", size=TEXT
        )
        canvas.draw()
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[:, :, :3].copy()))
    return Film(frames=tuple(frames), rate=_RATE)


def gif_of(film: Film) -> bytes:
    """Return a film as a GIF that runs round and round, all pictures in the same colours."""
    wide, high = film.frames[0].size
    # Colours of all parts of the film: a palette of the first picture alone may lack some.
    sheet = Image.new("RGB", (wide, 4 * high))
    for k in range(4):
        sheet.paste(film.frames[k * len(film.frames) // 4], (0, k * high))
    # Colours are chosen by coverage: a small mark keeps its colour next to large areas, and white
    # stays white.
    palette = sheet.quantize(_COLOURS, method=Image.Quantize.MAXCOVERAGE)
    shown = [
        np.asarray(frame.quantize(palette=palette, dither=Image.Dither.NONE))
        for frame in film.frames
    ]
    frames = [Image.fromarray(shown[0], mode="P")]
    # Pixels that have not changed are kept, which compresses well.
    for before, after in pairwise(shown):
        frames.append(Image.fromarray(np.where(after == before, _KEPT, after).astype(np.uint8)))
    for frame in frames:
        frame.putpalette(palette.getpalette() or [])
    found = io.BytesIO()
    frames[0].save(
        found,
        format="GIF",
        save_all=True,
        append_images=frames[1:],
        duration=1000 // film.rate,
        loop=0,
        optimize=False,
        transparency=_KEPT,
        disposal=1,
    )
    return found.getvalue()


def has_ffmpeg() -> bool:
    """Return True if ffmpeg, which makes the MP4, is installed."""
    return shutil.which("ffmpeg") is not None


def mp4_of(film: Film) -> bytes:
    """Return a film as MP4 (H.264), made by ffmpeg.

    Raises:
        ZenoOrbitsError: If ffmpeg fails. The message contains the last line of its output.
    """
    wide, high = film.frames[0].size
    with scratch_folder() as folder:
        path = folder / "film.mp4"
        command = ["ffmpeg", "-loglevel", "error", "-y"]
        command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{wide}x{high}"]
        command += ["-r", str(film.rate), "-i", "-", "-an", "-c:v", "libx264"]
        # Sides must be even for the widest-read pixel format.
        command += ["-vf", "crop=trunc(iw/2)*2:trunc(ih/2)*2", "-pix_fmt", "yuv420p"]
        command += ["-fflags", "+bitexact", "-movflags", "+faststart", str(path)]
        try:
            subprocess.run(
                command,
                input=b"".join(frame.tobytes() for frame in film.frames),
                check=True,
                capture_output=True,
            )
        except (OSError, subprocess.CalledProcessError) as error:
            said: bytes = getattr(error, "stderr", b"") or b""
            why = said.decode(errors="replace").strip().splitlines()[-1:] or [str(error)]
            raise ZenoOrbitsError(f"ffmpeg made no film ({why[0]})") from error
        return path.read_bytes()


def _panels(motion: MachineMotion, n: int) -> tuple[Figure, Axes, list[Axes]]:
    """Return a figure, the panel of the machine, and the panels of the portraits."""
    if not motion.renamed:
        figure = Figure(figsize=(FULL_WIDTH, _TALL), layout="constrained", dpi=_DOTS)
        grid = figure.add_gridspec(n, 2)
        portraits = [figure.add_subplot(grid[k, 1]) for k in range(n)]
        return figure, figure.add_subplot(grid[:, 0]), portraits
    (left, right), (low, high) = frame_of(motion, square=False)
    heights = (FULL_WIDTH * (high - low) / (right - left), _LOW)
    tall = sum(heights) + _BETWEEN
    figure = Figure(figsize=(FULL_WIDTH, tall), layout="constrained", dpi=_FEW_DOTS)
    grid = figure.add_gridspec(2, n, height_ratios=heights)
    portraits = [figure.add_subplot(grid[1, k]) for k in range(n)]
    return figure, figure.add_subplot(grid[0, :]), portraits


def _draw_machine(ax: Axes, motion: MachineMotion) -> dict[str, Any]:
    """Prepare the axes of the machine and return its lines, to be moved."""
    lines, (across, upwards) = motion.lines, frame_of(motion, square=not motion.renamed)
    ax.set(xlim=across, ylim=upwards)
    ax.set_aspect("equal")
    label_lengths(ax)
    ax.grid(visible=True, lw=0.4, alpha=0.5)
    looks: dict[str, dict[str, Any]] = {name: {"lw": 3.5} for name in lines}
    looks |= {name: {"lw": 2.0} for name in _STILL if name in lines}
    points = [name for name, corners in lines.items() if corners.shape[1] == 1]
    # Lines that exchange their names look alike, so the second of them is paler.
    exchanged = [name for name in motion.renamed if name not in points]
    looks |= {name: {"lw": 3.5, "alpha": 0.45} for name in exchanged[1::2]}
    looks |= {name: {"marker": "o", "ms": 6, "mec": INK, "mfc": "white"} for name in points}
    # The stop is drawn first, and the points last.
    order = sorted(lines, key=lambda name: (name in points, name not in _STILL))
    return {name: ax.plot([], [], solid_capstyle="round", **looks[name])[0] for name in order}


def _draw_portrait(
    ax: Axes, problem: Problem, execution: Execution, looks: Looks, pair: Sequence[int]
) -> tuple[Any, Any]:
    """Draw the whole orbit, and return the moving point and its trail."""
    for path in drawn_paths(execution):
        thin: dict[str, Any] = looks.path(path) | {"lw": 1.0}
        ax.plot(*path.states[:, list(pair)].T, **thin)
    for impact in execution.impacts:
        ends = np.array([impact.state_minus, impact.state_plus])[:, list(pair)]
        ax.plot(*ends.T, **JUMP)
    mark_switches(ax, execution, looks, pair)
    mark_completion(ax, execution, pair)
    ax.set(xlabel=label_of(problem, pair[0]), ylabel=label_of(problem, pair[1]))
    trail = ax.plot([], [], color=INK, lw=2.2, alpha=0.45)[0]
    dot = ax.plot([], [], ls="", marker="o", ms=7, mec=INK, mew=1.0, zorder=6)[0]
    return dot, trail


def _trail_start(execution: Execution, times: Vector, k: int) -> int:
    """Return the first picture of the moving point's trail: no earlier than its last jump."""
    jumps = (*execution.impacts, *execution.switches)
    jumped = max((one.time for one in jumps if one.time <= times[k]), default=0.0)
    return max(k - round(_TRAIL * len(times)), int(np.searchsorted(times, jumped)))
