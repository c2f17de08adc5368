r"""Returns whose impacts are cut after a number: smooth where the locked arc vanishes.

The impact sequence that ends exactly at the release is the stable set of the fixed point of theory
(39). There the Zeno point has no derivative, but the first `n` impacts do. A return that goes on
from impact `n` by a plastic reset differs from the true one by :math:`O(\sigma^{4n})`, theory (11),
and the condition :math:`r_n = r_*` holds to :math:`O((\sigma / \kappa)^n)` in the parameter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.return_maps import (
    Composed,
    DifferentiatedReturn,
    Loss,
    Margin,
    OnSection,
    ReleaseReturns,
    ReturnMap,
)
from zeno_orbits.continuation.separatrix import separatrix
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import GAP_ACCELERATION, HybridDynamics
from zeno_orbits.orbits import Line, differentials_of, first_return, to_next_release
from zeno_orbits.simulation import (
    Ending,
    EventShift,
    Impact,
    Mode,
    Perturbations,
    TailEstimate,
    ZenoLimit,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class _PlasticAfter:
    """Complete at the n-th impact of a sequence, as if it were plastic."""

    n_impacts: int

    def limit(
        self, dynamics: HybridDynamics, estimates: Sequence[TailEstimate]
    ) -> ZenoLimit | None:
        """Return the impact, or nothing before it."""
        del dynamics
        last = estimates[-1]
        if len(estimates) < self.n_impacts:
            return None
        return ZenoLimit(time=last.impact_time, state=last.resting, error=0.0)


@dataclass(frozen=True, kw_only=True)
class CutReturns(OnSection):
    """From release to release with the impacts cut after a number.

    Attributes:
        whole: The return map that is cut.
        n_impacts: How many impacts are made.
    """

    whole: ReleaseReturns
    n_impacts: int

    @property
    def base(self) -> ReturnMap:
        """The return map whose section and line it has."""
        return self.whole

    def moved_to(self, line: Line) -> CutReturns:
        """Return the same map along another line."""
        return replace(self, whole=self.whole.moved_to(line))

    def loosened(self) -> CutReturns:
        """Return the same at a looser tolerance."""
        return replace(self, whole=self.whole.loosened())

    def follow(self, x: Vector, s: float, *, horizon: float) -> DifferentiatedReturn:
        """Return the motion from a release to the next; its one margin is the cut's."""
        dynamics = self.whole.dynamics(s)
        settings = replace(self.whole.settings, completion=_PlasticAfter(n_impacts=self.n_impacts))
        start = dynamics.on_stop(x)
        run = to_next_release(dynamics, start, horizon=horizon, settings=settings)
        release = first_return(run)
        if release is None:
            raise SimulationError("There is no next release", time=horizon, state=tuple(x.tolist()))
        moving = self.line.moving
        perturbations = Perturbations(
            dynamics=dynamics,
            differentials=differentials_of(dynamics, moving),
            n_parameters=len(moving),
            tolerance=settings.tolerance,
        )
        arcs = [arc for arc in run.arcs if arc.end_time <= release.time]
        if arcs[0].mode is Mode.LOCKED:
            arcs.pop(0)
        impacts = [event for event in run.events if isinstance(event, Impact)]
        flights = [arc for arc in arcs if arc.ending is Ending.IMPACT]
        if len(flights) != len(impacts) or arcs[-1].ending is not Ending.RELEASE:
            raise SimulationError(
                "The return touches the stop without an impact",
                time=release.time,
                state=tuple(x.tolist()),
            )
        here = perturbations.at_start()
        for arc, impact in zip(flights, impacts, strict=True):
            here = perturbations.struck(impact, perturbations.flown(arc, here))
        end = perturbations.released(arcs[-1], _rested(perturbations, impacts[-1], here))
        n_x = x.size
        return DifferentiatedReturn(
            time=release.time,
            end=release.state,
            by_state=end.state[:, :n_x],
            by_parameter=end.state[:, n_x:] @ self.line.slopes,
            margins={Margin(loss=Loss.CUT): _from_separatrix(dynamics, impacts[-1])},
        )


def cut_after(returns: ReturnMap, place: int, n_impacts: int) -> ReturnMap:
    """Return a map with one of its returns cut.

    Args:
        returns: From release to release, once or several times.
        place: Which return, counted from 0.
        n_impacts: How many impacts it makes.
    """
    if isinstance(returns, Composed):
        maps = list(returns.maps)
        maps[place] = cut_after(maps[place], 0, n_impacts)
        return Composed(maps=tuple(maps))
    if not isinstance(returns, ReleaseReturns):
        raise TypeError("Argument `returns` must go from release to release, but it does not.")
    return CutReturns(whole=returns, n_impacts=n_impacts)


def _rested(perturbations: Perturbations, impact: Impact, here: EventShift) -> EventShift:
    """Return how the state after a plastic end of an impact moves."""
    n_x = perturbations.n_x
    resting = perturbations.differentials.resting(impact.state_plus)[:n_x]
    state = resting[:, :n_x] @ here.state + resting[:, n_x:] @ perturbations.parameters
    return EventShift(time=here.time, state=state, rate=0.0 * here.rate)


def _from_separatrix(dynamics: HybridDynamics, impact: Impact) -> float:
    r"""Return :math:`1 - r / r_*` after an impact; positive where impacts accumulate in time."""
    resting = dynamics.resting(impact.state_plus)
    gradient = differentials_of(dynamics, ()).contact(resting.state)[GAP_ACCELERATION]
    fall = float(gradient @ resting.rate)
    speed = dynamics.speed_after(impact.approach_rate)
    ratio = speed * fall / resting.gap_acceleration**2
    return 1 - ratio / separatrix(dynamics.restitution).ratio
