"""The section of the report page about a recording."""

from __future__ import annotations

import base64
import re
from functools import cache
from pathlib import Path

import pytest

import zeno_orbits as zo
from tests.support.commands import YES, ask, assert_refused
from tests.support.orbits import event_orbit
from zeno_orbits.errors import InputError
from zeno_orbits.experiment import RecordedSignal


@cache
def _recording(gain: float) -> zo.Recording:
    """Return ten steps of the compass walker, with the torque another one by a factor."""
    problem = zo.load_problem("compass_walker")
    orbit = event_orbit("compass_walker")
    motion = zo.simulate(problem, until=5.0, start=orbit.start_state, gains=dict(orbit.gains))
    found = zo.sample_execution(problem, motion, gains=dict(orbit.gains), rate=200.0, noise=1e-3)
    others = tuple(
        RecordedSignal(name=one.name, unit=one.unit, values=gain * one.values)
        if one.name == "dhip"
        else one
        for one in found.signals
    )
    return zo.Recording(source=found.source, problem=found.problem, time=found.time, signals=others)


def _section(page: str) -> str:
    assert '<a href="#recording"' in page
    section = page[page.index('<section id="recording"') :]
    return section[: section.index("</section>")]


@pytest.mark.slow
def test_the_section_states_the_verdict_and_the_quantities_of_compare() -> None:
    orbit, recording = event_orbit("compass_walker"), _recording(1.0)
    section = _section(zo.report_page(orbit, recording=recording))
    found = zo.compare(orbit, recording)
    assert found.agrees
    assert "The recording shows" in section
    assert "highest of hip" in section
    picture = re.search(r'src="data:image/svg\+xml;base64,([^"]+)"', section)
    assert picture
    assert b"<svg" in base64.b64decode(picture[1])


@pytest.mark.slow
def test_a_recording_of_another_motion_is_called_that() -> None:
    section = _section(zo.report_page(event_orbit("compass_walker"), recording=_recording(-1.0)))
    assert "does not show an orbit of this machine" in section
    assert "`dhip` looks like its sign reversed" in section


def test_without_a_recording_there_is_no_section() -> None:
    assert 'id="recording"' not in zo.report_page(event_orbit("compass_walker"))


def test_a_part_of_no_recording_is_refused() -> None:
    with pytest.raises(InputError, match="`t_start` needs a recording"):
        zo.report_page(event_orbit("compass_walker"), t_start=1.0)


@pytest.mark.slow
def test_the_command_names_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    zo.write_orbit(event_orbit("compass_walker"), "walk.json")
    zo.write_recording(_recording(1.0), "walk.csv")
    words = ("report", "walk.json", "-o", "page.html", "--recording", "walk.csv")
    answer = ask(*words, "--t-start", "1")
    assert answer.code == YES
    page = Path("page.html").read_text(encoding="utf-8")
    assert "The recording shows" in _section(page)
    assert "walk.csv" in page[page.index('<section id="reproduce"') :]
    assert_refused(
        ask("report", "walk.json", "-o", "p.html", "--recording", "none.csv"), "none.csv"
    )
    assert not Path("p.html").exists()
