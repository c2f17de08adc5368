r"""Returns whose impact sequence is truncated: smooth at the end where the contact phase vanishes.

The impact sequence that ends exactly at the release is the stable set of the fixed point of theory
(5.7). There the Zeno point is not differentiable, but the first `n` impacts are. A return with a
plastic reset at impact `n` differs from the true return by :math:`O(\sigma^{4n})`, theory (2.3).
The condition :math:`r_n = r_*` has an error of :math:`O((\sigma / \kappa)^n)` in the parameter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.event_returns import EventReturns
from zeno_orbits.continuation.return_maps import (
    Composed,
    DifferentiatedReturn,
    OnSection,
    ReleaseReturns,
    ReturnMap,
)
from zeno_orbits.continuation.separatrix import separatrix
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import GAP_ACCELERATION, HybridDynamics
from zeno_orbits.orbits import (
    Line,
    Margin,
    MarginKind,
    contact_view,
    contacts_of,
    differentials_of,
    first_return,
    passage_of,
    to_next_release,
)
from zeno_orbits.simulation import (
    Ending,
    EventDerivatives,
    Impact,
    Mode,
    PlasticAfter,
)


@dataclass(frozen=True, kw_only=True)
class CutReturns(OnSection):
    """Return map from release to release with a truncated impact sequence.

    Attributes:
        whole: The return map that is truncated.
        n_impacts: Number of impacts before the plastic reset.
    """

    whole: ReleaseReturns
    n_impacts: int

    @property
    def base(self) -> ReturnMap:
        """The return map with the same section and line."""
        return self.whole

    def moved_to(self, line: Line) -> CutReturns:
        """Return the same map along another line."""
        return replace(self, whole=self.whole.moved_to(line))

    def loosened(self) -> CutReturns:
        """Return the same map at a looser tolerance."""
        return replace(self, whole=self.whole.loosened())

    def follow(self, x: Vector, s: float, *, horizon: float) -> DifferentiatedReturn:
        """Return the motion from a release to the next, with the margin of the truncation only."""
        dynamics = self.whole.dynamics(s)
        settings = replace(self.whole.settings, completion=PlasticAfter(n_impacts=self.n_impacts))
        start = dynamics.on_stop(x)
        run = to_next_release(dynamics, start, horizon=horizon, settings=settings)
        release = first_return(run)
        if release is None:
            raise SimulationError("No release follows", time=horizon, state=tuple(x.tolist()))
        moving = self.line.moving
        derivatives = EventDerivatives(dynamics, moving, settings.tolerance)
        arcs = [arc for arc in run.arcs if arc.end_time <= release.time]
        first = int(arcs[0].mode is Mode.LOCKED)
        arcs = arcs[first:]
        impacts = [event for event in run.events if isinstance(event, Impact)]
        flights = [arc for arc in arcs if arc.ending is Ending.IMPACT]
        if len(flights) != len(impacts) or arcs[-1].ending is not Ending.RELEASE:
            raise SimulationError(
                "The return touches the stop without an impact",
                time=release.time,
                state=tuple(x.tolist()),
            )
        end = passage_of(arcs[-1], derivatives.passages(run, first=first)).after
        n_x = x.size
        return DifferentiatedReturn(
            time=release.time,
            end=release.state,
            by_state=end.state[:, :n_x],
            by_parameter=end.state[:, n_x:] @ self.line.slopes,
            margins={Margin(loss=MarginKind.CUT): _from_separatrix(dynamics, impacts[-1])},
        )


@dataclass(frozen=True, kw_only=True)
class CutEventReturns(OnSection):
    """Return map of an event sequence with truncated impact sequences.

    All Zeno points are truncated, since several contact phases of a symmetric orbit vanish at once.
    Far from its end, an impact sequence is changed less by the truncation.

    Attributes:
        whole: The return map that is truncated.
        n_impacts: Number of impacts before each plastic reset.
    """

    whole: EventReturns
    n_impacts: int

    @property
    def base(self) -> ReturnMap:
        """The return map with the same section and line."""
        return self.whole

    def moved_to(self, line: Line) -> CutEventReturns:
        """Return the same map along another line."""
        return replace(self, whole=self.whole.moved_to(line))

    def loosened(self) -> CutEventReturns:
        """Return the same map at a looser tolerance."""
        return replace(self, whole=self.whole.loosened())

    def follow(self, x: Vector, s: float, *, horizon: float) -> DifferentiatedReturn:
        """Return the motion to the end of the event sequence, with margins of truncations only."""
        graph, completion = self.whole.dynamics(s), PlasticAfter(n_impacts=self.n_impacts)
        found = self.whole.returned(graph, x, horizon=horizon, completion=completion)
        margins = {
            Margin(loss=MarginKind.CUT, place=contact.place): _from_separatrix(
                contact_view(graph, found, contact), contact.last_impact
            )
            for contact in contacts_of(found)
        }
        return self.whole.differentiated(graph, found, margins)


def cut_after(returns: ReturnMap, place: int, n_impacts: int) -> ReturnMap:
    """Return a map with the impact sequence of one of its returns truncated.

    Args:
        returns: Map from release to release, of one or several returns.
        place: Place of the margin of the contact phase, from 0. The return of an event sequence is
            truncated at every Zeno point.
        n_impacts: Number of its impacts before the plastic reset.
    """
    if isinstance(returns, Composed):
        maps = list(returns.maps)
        turn, inside = divmod(place, returns.base.n_places)
        maps[turn] = cut_after(maps[turn], inside, n_impacts)
        return Composed(maps=tuple(maps))
    if isinstance(returns, EventReturns):
        return CutEventReturns(whole=returns, n_impacts=n_impacts)
    if not isinstance(returns, ReleaseReturns):
        raise TypeError("Argument `returns` must be a map through Zeno points.")
    return CutReturns(whole=returns, n_impacts=n_impacts)


def _from_separatrix(dynamics: HybridDynamics, impact: Impact) -> float:
    r"""Return :math:`1 - r / r_*` after an impact.

    It is positive if the impacts accumulate before the release.
    """
    resting = dynamics.resting(impact.state_plus)
    gradient = differentials_of(dynamics, ()).contact(resting.state)[GAP_ACCELERATION]
    fall = float(gradient @ resting.rate)
    speed = dynamics.speed_after(impact.approach_rate)
    ratio = speed * fall / resting.gap_acceleration**2
    return 1 - ratio / separatrix(dynamics.restitution).ratio
