"""The report page of machines with several stops or switches."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import zeno_orbits as zo
from zeno_orbits.errors import InputError


@cache
def _orbit(name: str) -> zo.EventOrbit:
    return zo.find_event_orbit(name)


@cache
def _page(name: str) -> str:
    return zo.report_page(_orbit(name))


def _curves(page: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)
    assert found
    return json.loads(found[1])


def test_the_page_tells_the_events_in_their_order_with_times_and_multipliers() -> None:
    orbit, page = _orbit("kneed_walker"), _page("kneed_walker")
    assert "Zeno periodic orbit" in page
    story = page.index("impacts accumulate at the stop “knee”")
    assert story < page.index("the switch “heel strike”")
    zeno = next(event for event in orbit.events if event.name == "zeno knee")
    assert f"{zeno.time:.10g}" in page
    # The knee is on its stop from the Zeno point to heel strike.
    assert f"{orbit.period - zeno.time:.6g}" in page
    assert "rests on the stop knee for" in page
    for name in ("impact knee", "Zeno point knee", "switch heel strike", "switch_transversality"):
        assert name in page
    assert f"{orbit.floquet_multipliers[0].real:.7f}"[:8] in page
    assert "The energy balance, pushes and work-precision studies need a machine" in page


def test_the_curves_of_the_page_are_those_of_the_orbit() -> None:
    orbit, curves = _orbit("kneed_walker"), _curves(_page("kneed_walker"))
    series = curves["series"]
    strike = orbit.events[-1]
    assert series["switches"] == pytest.approx([strike.time], abs=1e-9)
    ((start, end),) = (one for one in series["locked"] if one[1] - one[0] > 1e-3)
    zeno = next(event for event in orbit.events if event.name == "zeno knee")
    assert (start, end) == pytest.approx((zeno.time, orbit.period), abs=1e-6)
    assert {arc["on"] for arc in series["arcs"] if arc["kind"] == "locked"} == {": knee"}
    first = curves["portraits"][0]
    assert first["switch"]["x"] == pytest.approx([strike.state["q1"]], abs=1e-7)
    assert first["reset"]["x"] == pytest.approx([orbit.start_state["q1"]], abs=1e-7)
    grounds = [line for line in curves["machine"]["lines"] if line["stop"]]
    assert len(grounds) == 1


def test_each_of_two_stops_has_the_duration_of_its_contact() -> None:
    orbit, page = _orbit("clapper"), _page("clapper")
    times = {event.name: event.time for event in orbit.events}
    lower = times["release lower"] - times["zeno lower"]
    # By symmetry both stops hold the mass equally long.
    for name in ("lower", "upper"):
        place = page.index(f"rests on the stop {name} for")
        assert f"{lower:.6g}" in page[place : place + 100]
    assert "determine its state" in page


def test_an_orbit_without_zeno_point_has_a_page_without_a_zoom() -> None:
    page = _page("hopper")
    assert "Zoom into the Zeno point" not in page
    assert '<p class="small">Periodic orbit of the problem hopper' in page


def test_the_page_of_a_false_orbit_says_so() -> None:
    orbit = _orbit("hopper")
    false = replace(orbit, period=1.001 * orbit.period)
    assert "Not verified: do not rely on these values." in zo.report_page(false)


def test_studies_of_machines_with_one_stop_are_refused(tmp_path: Path) -> None:
    file, orbit = tmp_path / "study.json", _orbit("hopper")
    with pytest.raises(InputError, match="`trade` needs a machine with one stop"):
        zo.report_page(orbit, trade=file)
    with pytest.raises(InputError, match="`pushes` needs a machine with one stop"):
        zo.report_page(orbit, pushes=file)
    with pytest.raises(InputError, match="`recovery` needs a machine with one stop"):
        zo.report_page(orbit, recovery=file)
