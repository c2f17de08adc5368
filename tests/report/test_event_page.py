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
from tests.support.browser import Browser
from tests.support.orbits import event_orbit
from zeno_orbits.errors import InputError


@cache
def _page(name: str) -> str:
    return zo.report_page(event_orbit(name))


def _curves(page: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)
    assert found
    return json.loads(found[1])


@pytest.mark.slow
def test_the_page_tells_the_events_in_their_order_with_times_and_multipliers() -> None:
    orbit, page = event_orbit("kneed_walker"), _page("kneed_walker")
    assert "Zeno periodic orbit" in page
    story = page.index("the impacts on the stop “knee” end in contact (Zeno point)")
    assert story < page.index("the switch “heel strike”")
    zeno = next(event for event in orbit.events if event.name == "zeno knee")
    assert f"{zeno.time:.10g}" in page
    # The knee is on its stop from the Zeno point to heel strike.
    assert f"{orbit.period - zeno.time:.6g}" in page
    assert "rests on the stop knee for" in page
    for name in ("impact knee", "Zeno point knee", "switch heel strike", "switch_transversality"):
        assert name in page
    assert f"{orbit.floquet_multipliers[0].real:.7f}"[:8] in page


@pytest.mark.slow
def test_the_curves_of_the_page_are_those_of_the_orbit() -> None:
    orbit, curves = event_orbit("kneed_walker"), _curves(_page("kneed_walker"))
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


@pytest.mark.slow
def test_each_of_two_stops_has_the_duration_of_its_contact() -> None:
    orbit, page = event_orbit("clapper"), _page("clapper")
    times = {event.name: event.time for event in orbit.events}
    lower = times["release lower"] - times["zeno lower"]
    # By symmetry both stops hold the mass equally long.
    for name in ("lower", "upper"):
        place = page.index(f"rests on the stop {name} for")
        assert f"{lower:.6g}" in page[place : place + 100]
    assert "determine its state" in page


@pytest.mark.parametrize(("name", "stops"), [("clapper", ["lower", "upper"]), ("hopper", [])])
def test_the_page_zooms_into_the_zeno_point_of_every_stop(name: str, stops: list[str]) -> None:
    page, zooms = _page(name), _curves(_page(name))["zeno"]
    assert re.findall(r"Zoom into the Zeno point of (\w+)<", page) == stops
    assert len(zooms) == len(stops)
    assert [f'id="plot-zeno-{k}"' in page for k in range(3)] == [k < len(stops) for k in range(3)]
    hits = [event.name for event in event_orbit(name).events if event.name.startswith("impact")]
    for stop, zoom in zip(stops, zooms, strict=True):
        assert len(zoom["speeds"]["x"]) == hits.count(f"impact {stop}")


@pytest.mark.slow
def test_captions_name_states_as_their_axes_do() -> None:
    page = _page("kneed_walker")
    first = "d<i>q</i><sub>1</sub>/d<i>t</i> over <i>q</i><sub>1</sub>"
    assert f"<figcaption>Phase portrait, {first}, over one period.</figcaption>" in page
    assert 'aria-label="Phase portrait, dq1/dt over q1, over one period."' in page
    assert "dq1 over q1" not in page


LABELS = """
const faults = [];
document.querySelectorAll(".plot").forEach((place) => {
  const whole = place.getBoundingClientRect(), name = place.id;
  const inside = (r) => r.left >= whole.left - 1 && r.right <= whole.right + 1
    && r.top >= whole.top - 1 && r.bottom <= whole.bottom + 1;
  const texts = [...place.querySelectorAll("g.infolayer text, .xtick text, .ytick text")];
  texts.filter((one) => !inside(one.getBoundingClientRect()))
    .forEach((one) => faults.push(name + " cuts " + one.textContent));
  const titles = [...place.querySelectorAll("g.infolayer text[class*=title]")];
  titles.forEach((one, k) => titles.slice(k + 1).forEach((other) => {
    const a = one.getBoundingClientRect(), b = other.getBoundingClientRect();
    // Vertical titles of stacked panels stand side by side if their numbers differ in width.
    const beside = a.left < b.right && b.left < a.right;
    const stacked = a.height > a.width && b.height > b.width;
    if ((beside || (stacked && name === "plot-series")) && a.top < b.bottom && b.top < a.bottom)
      faults.push(name + ": " + one.textContent + " overlaps " + other.textContent);
  }));
});
document.querySelectorAll("pre, .wide").forEach((one) => {
  if (one.scrollWidth > one.clientWidth + 1)
    faults.push("scrolls by " + (one.scrollWidth - one.clientWidth) + ": " + one.textContent);
});
if (document.documentElement.scrollWidth > innerWidth) faults.push("the page scrolls");
return faults;
"""


@pytest.mark.parametrize("width", [390, 1400])
@pytest.mark.parametrize("name", ["motor_cart", "relay", "hopper"])
def test_labels_of_a_page_are_whole_and_apart_on_every_screen(
    browser: Browser, tmp_path: Path, name: str, width: int
) -> None:
    # The cart has one stop and a long name, the relay two stops, the hopper switches alone.
    page = zo.report_page(zo.find_orbit("motor_cart").unwrap()) if "cart" in name else _page(name)
    path = tmp_path / "report.html"
    path.write_text(page)
    browser.emulate(width)
    browser.open(path)
    assert browser.run(LABELS) == []
    # The check finds a title that is too long, and a command that is cut.
    browser.run(
        "const place = document.getElementById('plot-series');"
        "Plotly.relayout(place, {'yaxis.title.text': 'a long title of a short axis [rad/s]',"
        "  'yaxis2.title.text': 'another long title of a short axis [rad/s]'});"
        "const pre = document.querySelector('pre');"
        "pre.style.cssText = 'white-space: pre; overflow-x: auto; width: 300px'"
    )
    faults = browser.run(LABELS)
    assert any("overlaps" in fault for fault in faults)
    assert any(fault.startswith("scrolls") for fault in faults)


def test_an_orbit_without_zeno_point_has_a_page_without_a_zoom() -> None:
    page = _page("hopper")
    assert "Zoom into the Zeno point" not in page
    assert '<p class="small">Periodic orbit without a Zeno point of the problem hopper' in page


@pytest.mark.slow
def test_the_page_of_a_false_orbit_says_so() -> None:
    orbit = event_orbit("hopper")
    false = replace(orbit, period=1.001 * orbit.period)
    assert "Not verified: do not rely on these values." in zo.report_page(false)


@pytest.mark.slow
def test_the_page_shows_pushes_and_recovery_of_this_orbit_only(tmp_path: Path) -> None:
    orbit, file = event_orbit("hopper"), tmp_path / "recovery.json"
    recovery = zo.recovery(orbit, settings=zo.RecoverySettings(samples=5))
    file.write_text(json.dumps(recovery.as_json()))
    pushes = zo.largest_push(orbit, settings=zo.PushSettings(phases=2, steps=2))
    page = zo.report_page(orbit, recovery=file, pushes=pushes)
    section = page[page.index('<section id="disturbances"') :]
    # Its multiplier is e^2 = 1 / 4, so the fourth power is the first one below 1 %.
    assert "decays to 1 % in 4 periods" in section
    assert f"{recovery.extents['speed']:.4g}" in section
    assert pushes.least is not None
    assert f"{pushes.least.largest:.6g}" in section
    other = zo.find_orbit("hopper", parameters={"a": 21.0}).unwrap()
    with pytest.raises(InputError, match="`recovery` must be of this orbit"):
        zo.report_page(other, recovery=file)
    with pytest.raises(InputError, match="`pushes` must be of this orbit"):
        zo.report_page(other, pushes=pushes)


def test_a_work_precision_study_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="`trade` needs a machine with one stop"):
        zo.report_page(event_orbit("hopper"), trade=tmp_path / "study.json")
