# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false
# traitlets declares the attributes of a widget without types.
"""The widget: data exchange between the browser and Python. It needs the extra `explore`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from time import perf_counter
from typing import Any

import anywidget
import traitlets

from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model import Problem
from zeno_orbits.report.exploration.attractor import ExploredAttractor, attractor_at

_HERE = files("zeno_orbits.report.exploration")


class Explorer(anywidget.AnyWidget):
    """Sliders and the attractor at their values.

    Attributes:
        sliders: Name, unit, meaning, range and value of each slider.
        values: Values of the sliders by name. Assign a new mapping to move the sliders.
        view: Data that the browser draws.
        attractor: The attractor at these values.
    """

    _esm = _HERE.joinpath("explore.js").read_text(encoding="utf-8")
    _css = _HERE.joinpath("explore.css").read_text(encoding="utf-8")
    sliders: Any = traitlets.List().tag(sync=True)
    values = traitlets.Dict().tag(sync=True)
    view = traitlets.Dict().tag(sync=True)

    def __init__(
        self, problem: Problem, fixed: Mapping[str, float], sliders: Sequence[dict[str, Any]]
    ) -> None:
        """Compute the attractor at the first values.

        Args:
            problem: The problem.
            fixed: Gains and parameters that differ from their defaults.
            sliders: Name, unit, meaning, range and value of each slider.
        """
        self._problem, self._fixed = problem, fixed
        self.attractor: ExploredAttractor | None = None
        super().__init__(
            sliders=list(sliders), values={slider["name"]: slider["value"] for slider in sliders}
        )
        self._update()
        self.observe(self._update, names="values")

    def _update(self, _change: object = None) -> None:
        begun = perf_counter()
        view: dict[str, Any]
        try:
            chosen = self._problem.values(numbers={**self._fixed, **self.values})
            self.attractor = attractor_at(self._problem, chosen, near=self._last_orbit())
            view = self.attractor.view(self._problem)
        except ZenoOrbitsError as error:
            self.attractor = None
            view = {"name": str(error), "facts": [], "panels": []}
        # The browser waits for the reply to its last values before it sends new values.
        self.view = {
            **view,
            "title": self._problem.name,
            "values": dict(self.values),
            "seconds": perf_counter() - begun,
        }

    def _last_orbit(self) -> Any:
        return None if self.attractor is None else self.attractor.orbit
