"""A transcribed arc: its mesh, its stages, and one collocation step per interval."""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Array, Vector
from zeno_orbits.integrators import Collocation, radau_scheme
from zeno_orbits.model import CompiledSystem, ModeFunctions
from zeno_orbits.search.transcription.mesh import graded_mesh, stage_fractions
from zeno_orbits.search.transcription.program import ProgramBuilder
from zeno_orbits.simulation import Arc
from zeno_orbits.work import Checked

_FEW = 16
"""Number of intervals that an arc may have in addition to the steps of its simulation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TranscriptionSettings(Checked):
    """Scheme and tolerances of a transcription.

    Attributes:
        scheme: The collocation scheme of every interval.
        mesh_tolerance: Largest deviation of an interval's polynomial from the guess between its
            stages, in units of the size of each state. Ends of intervals are more accurate.
        closure_tolerance: Largest estimated error of the Zeno closure.
    """

    scheme: Collocation = field(default_factory=lambda: radau_scheme(7))
    mesh_tolerance: float = 3e-8
    closure_tolerance: float = 1e-11


@dataclass(frozen=True, slots=True, kw_only=True)
class CollocatedArc:
    """A transcribed arc.

    Attributes:
        name: ``flight 0``, ``flight 1``, ... or ``locked``.
        guess: The simulated arc.
        mesh: Ends of the intervals, as fractions of the duration, ``(n_intervals + 1,)``.
        start: State of the flow at the start of the arc, ``(n_y, 1)``.
        stages: States at the stages, ``(n_y, n_intervals * n_stages)``.
        duration: Duration of the arc [s].
        work: Electrical work over the arc [J].
    """

    name: str
    guess: Arc
    mesh: Array
    start: ca.MX
    stages: ca.MX
    duration: ca.MX
    work: ca.MX

    @property
    def end(self) -> ca.MX:
        """State of the flow at the end of the arc, ``(n_y, 1)``."""
        return self.stages[:, -1]


class ArcWriter:
    """Writes arcs into one program.

    Args:
        program: The program.
        compiled: The functions of the problem.
        settings: Scheme and mesh.
        p: Gains and parameters, as values or unknowns.
        scale: Size of each state, ``(n_x,)``.
    """

    def __init__(
        self,
        program: ProgramBuilder,
        compiled: CompiledSystem,
        settings: TranscriptionSettings,
        p: ca.MX,
        scale: Vector,
    ) -> None:
        self.program = program
        self.compiled = compiled
        self.settings = settings
        self.p = p
        self.scale = scale
        self._intervals: dict[str, ca.Function] = {}

    def collocate(
        self, name: str, guess: Arc, mode: ModeFunctions, p: ca.MX, start: ca.MX
    ) -> CollocatedArc:
        """Declare the stages of an arc and its continuity.

        Args:
            name: Name of the arc.
            guess: The simulated arc.
            mode: Flow of the arc.
            p: Parameters of the flow, ``(n_p,)``.
            start: State of the flow at the start of the arc, ``(n_y, 1)``.
        """
        scheme, n_stages = self.settings.scheme, self.settings.scheme.n_stages
        length = guess.duration
        scale = flow_scale(guess, self.scale)

        def trajectory(fractions: Vector) -> Vector:
            return guess.flow_states_at(fractions * length)

        # An interval replaces at least four steps of the simulation, unless it resolves rounding.
        mesh = graded_mesh(
            trajectory,
            scheme,
            scale=scale,
            tolerance=self.settings.mesh_tolerance,
            most=len(guess.flow_times) - 1 + _FEW,
        )
        fractions = stage_fractions(mesh, scheme)
        first = trajectory(fractions).T
        stages = self.program.variable(f"{name} stages", first, scale=scale)
        duration = self.program.variable(f"{name} duration", length, scale=length)
        n_intervals = len(mesh) - 1
        starts = ca.horzcat(start, stages[:, n_stages - 1 : -1 : n_stages])
        sizes = duration * ca.DM(np.diff(mesh)).T
        (works,) = self.program.equal_along(
            [f"continuity[{name}, interval {k}]" for k in range(n_intervals)],
            self._interval(mode),
            (starts, stages, sizes, ca.repmat(p, 1, n_intervals)),
            scale=np.repeat(scale[:, None], n_stages, axis=1),
        )
        unit = p[-1] if mode is self.compiled.flight else ca.MX(1)
        return CollocatedArc(
            name=name,
            guess=guess,
            mesh=mesh,
            start=start,
            stages=stages,
            duration=unit * duration,
            work=unit * ca.sum2(works),
        )

    def _interval(self, mode: ModeFunctions) -> ca.Function:
        """Return the function of a collocation step: its defects and its work (theory (3.2))."""
        name = mode.rate.name()
        if name not in self._intervals:
            scheme = self.settings.scheme
            n_y, n_p = mode.rate.size1_in(0), mode.rate.size1_in(1)
            n_x, n_values = self.compiled.n_x, self.p.numel()
            y, size, p = ca.SX.sym("y", n_y), ca.SX.sym("size"), ca.SX.sym("p", n_p)
            stages = ca.SX.sym("stages", n_y, scheme.n_stages)
            columns = ca.horzsplit(stages)
            rates = ca.horzcat(*(mode.rate(stage, p) for stage in columns))
            defects = stages - y - size * ca.mtimes(rates, ca.DM(scheme.matrix).T)
            powers = [self.compiled.powers(stage[:n_x], p[:n_values])[0] for stage in columns]
            work = size * ca.dot(ca.DM(scheme.weights), ca.vertcat(*powers))
            self._intervals[name] = ca.Function(
                f"{name}_interval", [y, stages, size, p], [defects, work], {"cse": True}
            )
        return self._intervals[name]


def flow_scale(arc: Arc, scale: Vector) -> Vector:
    """Return the size of each state of an arc's flow, with gap and rate in a rescaled flight."""
    states = arc.flow_states_at(np.linspace(0.0, arc.duration, 9))
    scaled = np.max(np.abs(states), axis=0)[len(scale) :]
    return np.concatenate([scale, scaled])
