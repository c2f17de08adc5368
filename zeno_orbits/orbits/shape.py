r"""The shape of a periodic orbit: the phases of its period in order (theory (3.5)).

A phase is a flight with the events that end it. With `e > 0`, impacts may accumulate, followed by a
contact phase and a release (``zeno``). Otherwise the state leaves the stop after each impact
(``impact``), without a contact phase. At a plastic stop, `e = 0`, an impact is followed by contact
(``plastic``, the *simple* orbits of [OrAmes2009]_) or by an immediate release (``impact``), in any
order.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from itertools import groupby

from zeno_orbits.errors import InputError
from zeno_orbits.work import checked, require_kinds


class PhaseKind(Enum):
    """End of the flights of a phase. The value is the name in files and commands."""

    ZENO = "zeno"
    PLASTIC = "plastic"
    IMPACT = "impact"

    @property
    def holds(self) -> bool:
        """True if a contact phase and a release follow."""
        return self is not PhaseKind.IMPACT


ZENO_ORBIT = "Zeno periodic orbit"
SIMPLE_ORBIT = "simple periodic orbit"
"""Name of an orbit whose stops are plastic, so that no impacts accumulate ([OrAmes2009]_)."""
NO_ZENO_ORBIT = "periodic orbit without a Zeno point"
_ONE_RELEASE = {"zeno": ZENO_ORBIT, "plastic": f"{SIMPLE_ORBIT} (plastic impacts)"}
"""Descriptions of the shapes with one flight, its impacts and one contact phase."""

_MOST_PHASES = 1000
"""Number of phases per period beyond which a text is treated as a typing error."""
_WANTED = "must be zeno, plastic or impact, *N for N of them, joined by commas"


@dataclass(frozen=True, slots=True, kw_only=True)
class EventSequence:
    """The phases of a period, in order. The period starts at a release if it contains a release.

    Attributes:
        phases: Kinds of the phases. After the last phase the first follows again.
    """

    phases: tuple[PhaseKind, ...]

    def __post_init__(self) -> None:
        """Reject a shape that is impossible for an orbit."""
        require_kinds(self)
        kinds = set(self.phases)
        if not kinds:
            raise InputError("Argument `shape` must have a phase, but it is empty.")
        if PhaseKind.ZENO in kinds and len(kinds) > 1:
            wanted = "must not mix zeno, whose impacts all belong to it, with other phases"
            raise InputError(f"Argument `shape` {wanted}, but it is `{self.text}`.")
        if PhaseKind.PLASTIC in kinds and self.phases[-1] is not PhaseKind.PLASTIC:
            wanted = "must end with the plastic impact after whose release the period starts"
            raise InputError(f"Argument `shape` {wanted}, but it is `{self.text}`.")

    @classmethod
    @checked
    def parsed(cls, text: str) -> EventSequence:
        """Return the shape of a text such as ``zeno``, ``zeno*2`` or ``impact*3,plastic``.

        Raises:
            InputError: If the text is not a shape.
        """
        phases: list[PhaseKind] = []
        for part in text.split(","):
            word, star, count = part.strip().partition("*")
            known = {kind.value: kind for kind in PhaseKind}
            n = int(count) if count.isascii() and count.isdigit() and len(count) < 9 else 0
            n = n if star else 1
            if word not in known or n < 1 or len(phases) + n > _MOST_PHASES:
                raise InputError(f"Argument `shape` {_WANTED}, but it is `{text}`.")
            phases += n * [known[word]]
        return cls(phases=tuple(phases))

    @property
    def text(self) -> str:
        """The shape as text, in the format that `parsed` reads."""
        runs = [(kind, len(list(run))) for kind, run in groupby(self.phases)]
        return ",".join(kind.value if n == 1 else f"{kind.value}*{n}" for kind, n in runs)

    @property
    def kind(self) -> str:
        """Name of an orbit of this shape in the theory (3.5)."""
        if PhaseKind.ZENO in self.phases:
            return ZENO_ORBIT
        return SIMPLE_ORBIT if PhaseKind.PLASTIC in self.phases else NO_ZENO_ORBIT

    @property
    def described(self) -> str:
        """The kind with the shape, unless one flight and one contact phase form the period."""
        return _ONE_RELEASE.get(self.text, f"{self.kind} (shape {self.text})")

    @property
    def n_phases(self) -> int:
        """Number of phases."""
        return len(self.phases)

    @property
    def n_releases(self) -> int:
        """Number of releases, and of contact phases. The period starts at the last, if any."""
        return sum(kind.holds for kind in self.phases)

    @property
    def shorter(self) -> tuple[EventSequence, ...]:
        """The shapes of which several periods form this shape."""
        n = self.n_phases
        parts = [self.phases[:k] for k in range(1, n) if n % k == 0]
        return tuple(
            EventSequence(phases=part) for part in parts if part * (n // len(part)) == self.phases
        )

    @checked
    def at_restitution(self, restitution: float) -> EventSequence:
        """Return the shape with accumulations for a positive restitution, else plastic impacts."""
        held = PhaseKind.PLASTIC if restitution == 0.0 else PhaseKind.ZENO
        return EventSequence(phases=tuple(held if kind.holds else kind for kind in self.phases))

    @checked
    def agreed(self, wanted: EventSequence | None) -> EventSequence:
        """Return this shape if it agrees with the requested shape.

        Raises:
            InputError: If the shapes differ, apart from accumulations and plastic impacts.
        """
        if wanted is None or [k.holds for k in wanted.phases] == [k.holds for k in self.phases]:
            return self
        message = f"must be the shape `{self.text}` of the orbit to start from"
        raise InputError(f"Argument `shape` {message}, but it is `{wanted.text}`.")

    def require_one_release(self) -> None:
        """Reject a shape with several phases, or without a release.

        Raises:
            InputError: If the shape has several phases, or does not have a release.
        """
        if self.text not in _ONE_RELEASE:
            wanted = "must have one Zeno point and one release per period"
            raise InputError(f"Argument `orbit` {wanted}, but its shape is `{self.text}`.")


ONE_ZENO = EventSequence(phases=(PhaseKind.ZENO,))
"""One flight, one accumulation of impacts, one contact phase."""
