"""The report of an orbit: what the page says, that it harms nobody, how a browser shows it."""

from __future__ import annotations

import base64
import html
import json
import math
import os
import re
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from html.parser import HTMLParser
from io import StringIO
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

from tests.support import browser as browsers
from tests.support.browser import Browser, need_browser
from tests.support.commands import examples
from tests.support.disturbances import pushes_of, recovery_of
from tests.support.orbits import changed
from tests.support.report_pages import commands_in, plotted
from zeno_orbits import write_orbit
from zeno_orbits.cli import main
from zeno_orbits.errors import StepSizeError
from zeno_orbits.model import HybridDynamics, Problem, load_problem
from zeno_orbits.orbits import Orbit, read_orbit
from zeno_orbits.precision import TimedSetting, WorkPrecision, read_work_precision
from zeno_orbits.report.page import Subject, load_bundle, page_of, words
from zeno_orbits.search import orbit_at_gains
from zeno_orbits.verification import RESIDUALS, OrbitCertificate, verify

YES, NO, MISUSE = 0, 1, 2
ONE = ("--periods", "1")
"""Enough to see what a page says."""
EVIL = "</script><script>window.taken = 1</script><img src=x onerror='window.taken = 1'>\"'&"


def ask(*arguments: str | Path) -> tuple[int, str, str]:
    """Run a command and return its exit code, its output and its errors."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as ending:
            code = int(ending.code or 0)
    return code, out.getvalue(), err.getvalue()


def trade_of(problem: str) -> WorkPrecision:
    """Return a small trade: two engines, one of them beaten, and a trial that failed."""
    trials = (
        TimedSetting(
            sweep="engine", name="fast", value=1e-6, seconds=1e-3, error=1e-7, n_impacts=9
        ),
        TimedSetting(
            sweep="engine", name="slow", value=1e-6, seconds=2e-3, error=1e-6, n_impacts=9
        ),
        TimedSetting(
            sweep="cut", name="cut", value=1e-2, seconds=math.inf, error=math.inf, trouble="no"
        ),
    )
    return WorkPrecision(
        problem=problem, work="3 s", truth="exact", truth_error=1e-20, trials=trials
    )


@pytest.fixture(scope="module")
def subject(
    orbit: Orbit, problem: Problem, machine: HybridDynamics, certificate: OrbitCertificate
) -> Subject:
    return Subject(
        orbit=orbit,
        problem=problem,
        dynamics=machine,
        certificate=certificate,
        trade=trade_of("motor_pendulum"),
        pushes=pushes_of(orbit),
        recovery=recovery_of(orbit, problem),
        content=json.dumps(orbit.as_json()),
        command=("zeno-orbits", "report", "orbit.json", "-o", "report.html"),
    ).followed()


@pytest.fixture(scope="module")
def page(subject: Subject) -> str:
    return page_of(subject, load_bundle())


@pytest.fixture
def orbit_file(orbit: Orbit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An orbit file in the working folder."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "orbit.json"
    write_orbit(orbit, path)
    return path


class _Reader(HTMLParser):
    """Collects the words of a page and its scripts, and sees that elements are closed."""

    EMPTY = ("meta", "link", "img", "br", "input")

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.scripts = 0
        self.words = ""
        self.ids: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.ids += [str(value) for name, value in attrs if name == "id"]
        self.scripts += tag == "script"
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"script", "style"} & set(self.open):
            self.words += data


# ---------------------------------------------------------------------------- what it says


def test_the_page_is_well_formed_and_names_nothing_twice(page: str) -> None:
    reader = _Reader(page)
    assert reader.open == []
    assert len(reader.ids) == len(set(reader.ids))
    # The data, the packed library and the page's own script.
    assert reader.scripts == 3


def test_the_page_says_all_that_is_known_of_the_orbit(page: str, subject: Subject) -> None:
    text = _Reader(page).words
    orbit, problem, certificate = subject.orbit, subject.problem, subject.certificate
    for quantity in (*problem.gains, *problem.parameters):
        value = {**orbit.gains, **orbit.parameters}[quantity.name]
        row = f"{quantity.name}{value:.12g}{quantity.unit}{quantity.meaning}"
        assert row in text
    assert all(f"{name}: {RESIDUALS[name]}" in text for name in certificate.residuals)
    assert all(f"{name}{value:.6g}" in text for name, value in certificate.margins.items())
    assert f"{orbit.period:.10g}" in text
    assert certificate.verdict() in text
    assert "numpy" in text
    assert "What accuracy costs" in text


def test_every_event_of_the_period_stands_on_the_page(page: str, subject: Subject) -> None:
    text = _Reader(page).words
    assert subject.execution is not None
    for impact in subject.execution.impacts:
        assert f"{impact.time:.12g}impact{-impact.approach_rate:.6g}" in text
    assert f"{subject.execution.zeno_points[0].time:.12g}Zeno point" in text


@pytest.mark.slow
def test_the_page_has_the_problem_for_its_heading_a_date_and_its_contents(
    page: str, subject: Subject
) -> None:
    title = subject.problem.title
    heading = f"<h1>{title[0].upper()}{title[1:]}</h1>"
    assert heading in page
    assert "checked on" not in page
    assert "checked on 2026-02-03" in page_of(replace(subject, date="2026-02-03"), load_bundle())
    sections = re.findall(r'<section id="([^"]+)"', page)
    assert re.findall(r'<li><a href="#([^"]+)">', page) == sections
    assert len(sections) == 11


def test_no_table_repeats_the_title_that_it_stands_under(page: str) -> None:
    for section in re.findall(r"<section.*?</section>", page, re.DOTALL):
        (title,) = re.findall(r"<h2[^>]*>([^<]*)</h2>", section)
        assert title not in re.findall(r"<(?:caption|th)[^>]*>([^<]*)<", section)


@pytest.mark.parametrize(("turns", "cautions"), [(0.0, 0), (1.0, 1)])
def test_an_angle_that_passes_a_turn_gets_a_caution(
    subject: Subject, turns: float, cautions: int
) -> None:
    execution = subject.execution
    assert execution is not None
    turned = np.array([2.0 * math.pi * turns, 0.0, 0.0, 0.0, 0.0])
    arc = execution.arcs[0]
    moved = replace(
        arc,
        start_state=arc.start_state + turned,
        end_state=arc.end_state + turned,
        trajectory=None,
    )
    found = words.cautions(subject.problem, replace(execution, arcs=(moved,)))
    assert len(found) == cautions
    assert all("theta1 runs from" in caution for caution in found)


@pytest.mark.slow
def test_a_long_sequence_of_hits_is_cut_in_its_middle(
    page: str, subject: Subject, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zeno_orbits.report.page.tables._MOST_EVENTS", 4)
    assert subject.execution is not None
    short = page_of(subject, load_bundle())
    assert f"and {len(subject.execution.events) - 4} more" in _Reader(short).words
    assert len(short) < len(page)
    # As many as there may be are all shown.
    monkeypatch.setattr(
        "zeno_orbits.report.page.tables._MOST_EVENTS", len(subject.execution.events)
    )
    assert " more" not in _Reader(page_of(subject, load_bundle())).words


@pytest.mark.slow
@pytest.mark.parametrize(("points", "said"), [(0, "rebounds 10 times"), (2, "2 times infinitely")])
def test_a_period_with_another_number_of_zeno_points_has_its_own_words(
    subject: Subject, points: int, said: str
) -> None:
    execution = subject.execution
    assert execution is not None
    zeno = execution.zeno_points[0]
    others = tuple(event for event in execution.events if event is not zeno)
    changed = replace(execution, events=(*others, *((zeno,) * points)))
    told = words.story(subject.orbit, subject.certificate, changed)
    assert len(execution.impacts) == 10
    assert said in told
    page_of(replace(subject, execution=changed), load_bundle())


@pytest.mark.slow
def test_the_page_is_the_same_for_the_same_orbit(page: str, subject: Subject) -> None:
    assert page_of(subject, load_bundle()) == page


def test_the_page_weighs_less_than_three_megabytes(page: str) -> None:
    # The library alone is 4.8 MB as it comes; it travels packed.
    assert 1e6 < len(page.encode()) < 3e6


def test_the_page_names_no_other_place(page: str) -> None:
    # Outside the packed library nothing is linked but data inside the page itself.
    addresses = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert addresses
    reader = _Reader(page)
    places = {address[1:] for address in addresses if address.startswith("#")}
    # Links inside the page lead somewhere: to a section, or a law.
    assert {"theory-2.7", "theory-3.4", "reproduce"} < places
    assert places <= set(reader.ids)
    assert all(address.startswith(("data:", "#")) for address in addresses)
    assert "http" not in re.sub(r"http-equiv", "", page)


def test_the_file_inside_the_page_is_the_orbit(page: str, subject: Subject) -> None:
    found = re.search(r'href="data:application/json;base64,([^"]+)"', page)
    assert found is not None
    assert base64.b64decode(found.group(1)).decode() == subject.content


def test_every_margin_and_energy_has_words(certificate: OrbitCertificate) -> None:
    assert set(certificate.margins) <= set(words.MARGINS)
    assert set(certificate.energies) <= set(words.ENERGIES)


@pytest.mark.slow
def test_the_commands_on_the_page_find_the_orbit_again(
    subject: Subject, page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for command in commands_in(page):
        assert ask(*command[1:])[0] == YES
    again = read_orbit(tmp_path / "orbit.json")
    assert again.parameters == subject.orbit.parameters
    assert again.period == pytest.approx(subject.orbit.period, rel=1e-9)


@pytest.mark.slow
def test_numbers_that_differ_from_the_problem_stand_in_the_command(subject: Subject) -> None:
    other = {**subject.orbit.parameters, "R": 2.5, "K_emf": 0.02}
    moved = replace(subject, orbit=replace(subject.orbit, parameters=other))
    words_of = commands_in(page_of(moved, load_bundle()))[0]
    # `K_emf` is derived, but not as it stands here; what follows from `R` is left out.
    assert [word for word in words_of if "=" in word] == [
        *("Kp=2.5", "Kd=-1.0", "R=2.5", "K_emf=0.02"),
    ]


# ---------------------------------------------------------------------------- hostile texts


@pytest.fixture(scope="module")
def hostile(subject: Subject) -> Subject:
    """The orbit with HTML in every text that a problem, a file or a person can put into a page."""
    problem = subject.problem
    orbit = replace(
        subject.orbit,
        problem=EVIL,
        versions={EVIL: EVIL},
        certificate={"asked": [{"quantity": EVIL, "lower": None, "upper": 1.0}]},
    )
    problem_file = replace(
        problem,
        name=EVIL,
        title=EVIL,
        source=EVIL,
        outputs=tuple(replace(output, name=EVIL) for output in problem.outputs),
        parameters=tuple(replace(one, meaning=EVIL) for one in problem.parameters),
        gains=tuple(replace(one, meaning=EVIL) for one in problem.gains),
    )
    named = replace(trade_of(EVIL), work=EVIL, truth=EVIL)
    trials = tuple(replace(trial, name=EVIL) for trial in named.trials)
    pushes = pushes_of(subject.orbit, directions=({EVIL: 1.0},), lost=1.0)
    pushed = tuple(replace(push, unit=EVIL, beyond=EVIL) for push in pushes.pushes)
    recovery = replace(recovery_of(subject.orbit, problem), extents={EVIL: 1.0}, units={EVIL: EVIL})
    return replace(
        subject,
        orbit=orbit,
        problem=problem_file,
        trade=replace(named, trials=trials),
        pushes=replace(pushes, pushes=pushed),
        recovery=recovery,
        certificate=replace(subject.certificate, trouble=EVIL),
        file=EVIL,
        problem_file=EVIL,
        content=EVIL,
        command=(EVIL,),
    )


@pytest.mark.slow
def test_texts_that_are_html_stay_texts(hostile: Subject) -> None:
    page = page_of(hostile, load_bundle())
    reader = _Reader(page)
    assert reader.scripts == 3
    assert reader.open == []
    assert "<img" not in page
    # Title, heading, problem, source, meanings, bounds, versions, trade, file: all there, as text.
    assert reader.words.count(EVIL) > 20


# ---------------------------------------------------------------------------- the command


@pytest.mark.slow
def test_report_writes_a_page_and_says_yes(orbit_file: Path) -> None:
    code, out, _ = ask("report", orbit_file, "-o", "report.html", *ONE)
    assert code == YES
    assert "Verified" in out
    assert "Written: report.html" in out
    page = Path("report.html").read_text(encoding="utf-8")
    assert 'class="banner passed"' in page
    assert 'id="trade"' not in page


@pytest.mark.slow
def test_every_example_of_the_help_runs(orbit_file: Path, orbit: Orbit, problem: Problem) -> None:
    made = {
        "trade.json": trade_of("motor_pendulum"),
        "pushes.json": pushes_of(orbit),
        "recovery.json": recovery_of(orbit, problem),
    }
    for name, one in made.items():
        Path(name).write_text(json.dumps(one.as_json()))
    assert ask("simulate", "motor_pendulum", "--until", "40", "-o", "run.csv")[0] == YES
    shown = examples("report")
    assert len(shown) > 1
    pages: list[str] = []
    for line in shown:
        assert orbit_file.exists()
        assert line[0] == "report"
        assert ask(*line)[0] == YES
        pages.append(Path("report.html").read_text(encoding="utf-8"))
    assert any('id="trade"' in page for page in pages)
    assert any('id="disturbances"' in page for page in pages)


@pytest.mark.slow
def test_report_as_json_tells_where_the_page_is_and_its_weight(orbit_file: Path) -> None:
    code, out, _ = ask("report", orbit_file, "-o", "report.html", "--json", *ONE)
    assert code == YES
    data = json.loads(out)
    assert data["passed"]
    assert data["page"] == "report.html"
    assert data["bytes"] == Path("report.html").stat().st_size


@pytest.mark.slow
def test_a_false_orbit_gets_a_page_that_says_so_and_a_no(orbit_file: Path) -> None:
    orbit = read_orbit(orbit_file)
    write_orbit(replace(orbit, period=1.01 * orbit.period), orbit_file)
    code, out, _ = ask("report", orbit_file, "-o", "report.html", *ONE)
    assert code == NO
    assert "Refused" in out
    page = Path("report.html").read_text(encoding="utf-8")
    assert 'class="banner refused"' in page
    assert "Not verified: do not rely on these values." in page
    assert "✗ no" in page
    assert page.index("Not verified") < page.index("What happens")


@pytest.mark.slow
def test_a_page_of_a_file_whose_name_is_not_utf_8(orbit_file: Path) -> None:
    name = os.fsdecode(b"orbit\xff.json")
    orbit_file.rename(orbit_file.with_name(name))
    code, _, err = ask("report", orbit_file.with_name(name), "-o", "report.html", *ONE)
    assert (code, err) == (YES, "")
    assert r"orbit\udcff.json" in Path("report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("change", [{"theta2": -1e-3}, {"dtheta2": -1e-3}, {"theta1": 1e200}])
@pytest.mark.slow
def test_an_orbit_that_starts_where_no_motion_can_is_false_and_no_misuse(
    change: dict[str, float], orbit_file: Path
) -> None:
    orbit = read_orbit(orbit_file)
    start = {**orbit.release_state, **change}
    write_orbit(changed(orbit, release_state=start), orbit_file)
    code, out, _ = ask("report", orbit_file, "-o", "report.html", "--periods", "1")
    assert code == NO
    assert "Refused: `release`" in out
    assert "Not verified" in Path("report.html").read_text(encoding="utf-8")


def test_an_orbit_that_cannot_be_followed_gets_a_page_without_pictures(
    orbit_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> NoReturn:
        raise StepSizeError("The step size fell to nothing", time=0.5, state=(0.0,))

    monkeypatch.setattr("zeno_orbits.verification.integration.simulate", fail)
    monkeypatch.setattr("zeno_orbits.report.motion.simulate", fail)
    code, _, _ = ask("report", orbit_file, "-o", "report.html", *ONE)
    assert code == NO
    page = Path("report.html").read_text(encoding="utf-8")
    assert "The motion could not be followed" in page
    assert "The step size fell to nothing (at t = 0.5 s)" in page
    assert 'id="plot-series"' not in page
    assert 'class="banner refused"' in page


def test_an_unstable_orbit_is_not_called_stable(
    certificate: OrbitCertificate,
) -> None:
    unstable = replace(certificate, multipliers=(1.5 + 0j,))
    assert "unstable" in words.headline(unstable)
    assert "Small disturbances grow" in words.stability(unstable)
    unknown = replace(certificate, multipliers=(), multiplier_error=math.inf)
    assert "undecided" in words.headline(unknown)
    assert "not accurate enough" in words.stability(unknown)
    assert "small disturbances of it decay" in words.headline(certificate)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("-o", "missing/report.html"), "must be in a writable folder"),
        (("-o", "orbit.json"), "must be another file than the one that is read"),
        (("-o", "report.pdf"), "-o report.pdf: must name a web page, such as report.html."),
        (("-o", "r.html", "--tolerance", "2"), "--tolerance: must lie in (0, 1)"),
        (("-o", "r.html", "--trade", "nowhere.json"), "is not an output of `work-precision -o`"),
        (("-o", "r.html", "--trade", "orbit.json"), "is not an output of `work-precision -o`"),
        (("-o", "r.html", "--trade", "ball.json"), "must be of the problem `motor_pendulum`"),
        ((), "Missing: -o/--output"),
    ],
)
def test_misuse_is_one_line_and_writes_nothing(
    orbit_file: Path, arguments: tuple[str, ...], said: str
) -> None:
    Path("ball.json").write_text(json.dumps(trade_of("bouncing_ball").as_json()))
    before = {path.name: path.read_bytes() for path in orbit_file.parent.iterdir()}
    code, out, err = ask("report", orbit_file, *arguments)
    assert (code, out) == (MISUSE, "")
    assert said in err
    assert err.count("\n") == 1
    assert {path.name: path.read_bytes() for path in orbit_file.parent.iterdir()} == before


def test_a_trade_file_reads_back(tmp_path: Path) -> None:
    trade = trade_of("motor_pendulum")
    path = tmp_path / "trade.json"
    path.write_text(json.dumps(trade.as_json(), allow_nan=False))
    assert read_work_precision(path) == trade


# ---------------------------------------------------------------------------- the data


def test_the_plots_show_what_was_simulated(subject: Subject, page: str) -> None:
    data = plotted(page)
    execution = subject.execution
    assert execution is not None
    zeno = execution.zeno_points[0]
    series = data["series"]
    assert series["zeno"] == zeno.time
    assert series["impacts"] == [impact.time for impact in execution.impacts]
    # The rounding of the data: eight digits of a portrait, of values below 20.
    for k, pair in enumerate(subject.problem.portraits):
        at = [subject.problem.state_names.index(name) for name in pair]
        drawn = data["portraits"][k]
        assert [*drawn["zeno"]["x"], *drawn["zeno"]["y"]] == pytest.approx(zeno.state[at], abs=1e-6)
    first = data["portraits"][0]["arcs"][0]
    assert first["x"][0] == pytest.approx(subject.orbit.release_state["theta1"], abs=1e-7)


def test_the_closeup_goes_on_where_the_simulation_ends(page: str) -> None:
    (zeno,) = plotted(page)["zeno"]
    flights = [arc for arc in zeno["arcs"] if arc["kind"] == "free" and arc["t"][0] < 0.0]
    # The first flight that is left out begins where the last one that was simulated ends: its time
    # is that of the tail, 2 w/(a (1 - e)) to first order in w, and w is 2e-6 there.
    assert zeno["tail"][0]["t"][0] == pytest.approx(flights[-1]["t"][-1], rel=1e-5)
    ratios = [b["t"][0] / a["t"][0] for a, b in zip(zeno["tail"], zeno["tail"][1:], strict=False)]
    # Rounding to eight digits.
    assert ratios == pytest.approx([0.2] * len(ratios), rel=1e-7)
    assert zeno["decades"] >= 9


# ---------------------------------------------------------------------------- in a browser


@pytest.fixture(scope="module")
def page_file(page: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of the pendulum as a file."""
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(page, encoding="utf-8")
    return path


@pytest.fixture
def opened(browser: Browser, page_file: Path) -> Browser:
    """The browser with the page just opened in it, on a wide screen."""
    browser.emulate(1100)
    browser.complaints()
    browser.requests()
    browser.open(page_file)
    return browser


@pytest.fixture
def shown(browser: Browser, page_file: Path) -> Browser:
    """The browser with the page in it, whatever was done to it before."""
    if browser.driver.current_url != page_file.as_uri():
        browser.open(page_file)
    browser.emulate(1100)
    return browser


def range_of(browser: Browser, plot: str, axis: str = "xaxis") -> tuple[float, float]:
    """Return what an axis of a plot shows."""
    low, high = browser.run(f"return document.getElementById('plot-{plot}').layout.{axis}.range")
    return low, high


def press(browser: Browser, plot: str, step: str) -> None:
    """Press a button of a plot as a reader does."""
    button = browser.driver.find_element(
        "css selector", f'button[data-plot="{plot}"][data-zoom="{step}"]'
    )
    browser.run("arguments[0].scrollIntoView({block: 'center'})", button)
    button.click()


PLOTS = (
    *("portrait-0", "portrait-1", "series", "zeno-0", "gaps-0", "speeds-0", "stability", "trade"),
    *("pushes-0", "pushes-1"),
)


def test_the_page_opens_without_a_word_in_the_console(opened: Browser) -> None:
    assert opened.run("return document.documentElement.dataset.plots") == "ready"
    assert opened.complaints() == []


def test_nothing_leaves_the_page(opened: Browser, page_file: Path) -> None:
    for step in ("in", "in", "out", "all"):
        press(opened, "zeno-0", step)
    # Data that is in the page already is asked of nobody.
    asked = [address for address in opened.requests() if not address.startswith("data:")]
    assert asked == [page_file.as_uri()]


def test_the_ear_for_requests_and_complaints_hears_them(browser: Browser, tmp_path: Path) -> None:
    path = tmp_path / "chatty.html"
    path.write_text(
        "<html data-plots='ready'><link rel='icon' href='data:,'>"
        "<img src='http://127.0.0.1:9/a.png'><script>console.error('ouch')</script>"
    )
    browser.complaints()
    browser.requests()
    browser.open(path)
    assert any("ouch" in message for message in browser.complaints())
    assert "http://127.0.0.1:9/a.png" in browser.requests()


@pytest.mark.slow
def test_the_page_itself_forbids_requests_and_other_scripts(opened: Browser) -> None:
    opened.run(
        "const made = document.createElement('script'); made.textContent = 'window.taken = 1';"
        "document.head.append(made);"
        "document.body.insertAdjacentHTML('beforeend', '<b onclick=\"window.taken = 1\">b</b>');"
        "document.body.lastElementChild.click();"
        "fetch('http://127.0.0.1:9/').catch(() => { window.refused = 1; })"
    )
    assert opened.run("return window.taken") is None
    assert any("Content Security Policy" in message for message in opened.complaints())
    assert not [address for address in opened.requests() if address.startswith("http")]


@pytest.mark.parametrize("plot", PLOTS)
def test_every_plot_is_there_and_shows_something(shown: Browser, plot: str) -> None:
    drawn = shown.run(
        "const place = document.getElementById(arguments[0]);"
        "const marks = place.querySelectorAll('path.js-line, path.point');"
        "const box = place.querySelector('svg.main-svg').getBoundingClientRect();"
        "return [marks.length, box.width, box.height,"
        "  [...place.querySelectorAll('text.xtitle, text.ytitle')].map((t) => t.textContent)]",
        f"plot-{plot}",
    )
    marks, width, height, titles = drawn
    assert marks > 0
    assert width > 300
    assert height > 300
    # Every axis says its unit.
    assert titles
    assert all(re.search(r"\[.+\]$", title) for title in titles), titles


@pytest.mark.slow
def test_the_zoom_goes_by_decades_into_the_zeno_point(
    opened: Browser, subject: Subject, page: str
) -> None:
    decades = plotted(page)["zeno"][0]["decades"]
    press(opened, "zeno-0", "in")
    widths = []
    for _ in range(decades):
        low, high = range_of(opened, "zeno-0")
        bottom, top = range_of(opened, "zeno-0", "yaxis")
        assert low < 0.0 < high
        assert bottom < 0.0 < top
        widths.append(high - low)
        press(opened, "zeno-0", "in")
    ratios = [widths[k + 1] / widths[k] for k in range(len(widths) - 1)]
    assert ratios == pytest.approx([0.1] * len(ratios), rel=1e-9)
    # At the bottom the button rests, and the way back leads to the whole period.
    button = 'button[data-plot="zeno-0"][data-zoom="in"]'
    assert opened.driver.find_element("css selector", button).get_attribute("disabled")
    press(opened, "zeno-0", "all")
    low, high = range_of(opened, "zeno-0")
    assert high - low == pytest.approx(subject.orbit.period, rel=1e-3)
    assert opened.complaints() == []


@pytest.mark.slow
def test_at_every_depth_flights_are_seen(opened: Browser, page: str) -> None:
    for _ in range(plotted(page)["zeno"][0]["decades"]):
        press(opened, "zeno-0", "in")
        low, high = range_of(opened, "zeno-0")
        bottom, top = range_of(opened, "zeno-0", "yaxis")
        inside = opened.run(
            "const [low, high] = arguments; let most = 0;"
            "for (const one of document.getElementById('plot-zeno-0').data)"
            "  one.x.forEach((x, i) => {"
            "    if (x > low && x < high) most = Math.max(most, one.y[i]);"
            "  });"
            "return most",
            *(low, high),
        )
        # The highest point seen fills the window but for its rim.
        assert 0.5 * (top - bottom) < inside < top


@pytest.mark.slow
def test_the_states_over_time_zoom_too(opened: Browser, subject: Subject) -> None:
    start, end = range_of(opened, "series")
    press(opened, "series", "in")
    low, high = range_of(opened, "series")
    assert high - low == pytest.approx((end - start) / 10, rel=1e-9)
    assert (low + high) / 2 == pytest.approx(subject.orbit.zeno_time, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("width", "scheme"), [(390, "dark"), (1100, "light")])
def test_the_page_fits_its_screen_and_follows_its_colours(
    browser: Browser, page_file: Path, width: int, scheme: str
) -> None:
    browser.emulate(width, scheme=scheme)
    browser.open(page_file)
    wide, narrow = browser.run(
        "return [document.documentElement.scrollWidth, document.documentElement.clientWidth]"
    )
    assert wide <= narrow
    paper, plot = browser.run(
        "return [getComputedStyle(document.body).backgroundColor,"
        " document.getElementById('plot-series').layout.paper_bgcolor]"
    )
    red = int(re.findall(r"\d+", paper)[0])
    assert (red < 128) == (scheme == "dark")
    assert int(plot[1:3], 16) == red


@pytest.mark.slow
def test_a_plot_follows_when_the_scheme_changes(opened: Browser) -> None:
    opened.emulate(1100, scheme="dark")
    from selenium.webdriver.support.ui import WebDriverWait

    script = "return document.getElementById('plot-series').layout.paper_bgcolor"
    WebDriverWait(opened.driver, 10).until(lambda _: opened.run(script) == "#151515")


@pytest.mark.slow
def test_in_print_the_page_is_light_and_has_no_buttons(shown: Browser) -> None:
    shown.emulate(720, media="print", scheme="dark")
    looks = shown.run(
        "return [getComputedStyle(document.body).backgroundColor,"
        " getComputedStyle(document.querySelector('.buttons')).display]"
    )
    assert looks == ["rgb(255, 255, 255)", "none"]


@pytest.mark.slow
def test_hostile_texts_do_nothing_in_a_browser(
    browser: Browser, hostile: Subject, tmp_path: Path
) -> None:
    path = tmp_path / "hostile.html"
    path.write_text(page_of(hostile, load_bundle()), encoding="utf-8")
    browser.emulate(1100)
    browser.complaints()
    browser.open(path)
    assert browser.run("return window.taken") is None
    assert browser.run("return document.querySelectorAll('img').length") == 0
    # Not even the policy had anything to forbid.
    assert browser.complaints() == []


@pytest.mark.parametrize(
    ("name", "parameters"),
    [("forced_oscillator", {}), ("motor_pendulum", {"restitution": 0.0})],
)
@pytest.mark.slow
def test_pages_of_other_orbits_open_too(
    browser: Browser, tmp_path: Path, name: str, parameters: dict[str, float]
) -> None:
    problem = load_problem(name)
    orbit = orbit_at_gains(problem, problem.values(parameters=parameters)).unwrap()
    dynamics = problem.dynamics(orbit.values(problem))
    certificate = verify(orbit, problem)
    subject = Subject(orbit=orbit, problem=problem, dynamics=dynamics, certificate=certificate)
    path = tmp_path / "report.html"
    path.write_text(page_of(subject.followed(), load_bundle()), encoding="utf-8")
    browser.emulate(1100)
    browser.complaints()
    browser.open(path)
    assert browser.run("return document.documentElement.dataset.plots") == "ready"
    press(browser, "zeno-0", "in")
    low, high = range_of(browser, "zeno-0")
    assert low < 0.0 < high
    # A single impact is no sequence: nothing to see on logarithmic axes.
    alone = problem.values(parameters=parameters).parameters["restitution"] == 0.0
    logarithmic = browser.run(
        "return document.querySelectorAll('#plot-gaps-0, #plot-speeds-0').length"
    )
    assert logarithmic == (0 if alone else 2)
    assert browser.complaints() == []


def test_where_the_gate_wants_a_browser_a_missing_one_is_a_failure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(browsers, "CHROMIUM", None)
    monkeypatch.delenv(browsers.REQUIRED, raising=False)
    with pytest.raises(pytest.skip.Exception, match="no chromium"):
        need_browser()
    monkeypatch.setenv(browsers.REQUIRED, "1")
    with pytest.raises(pytest.fail.Exception, match="no chromium"):
        need_browser()


def test_every_figure_on_the_page_is_named_for_those_who_cannot_see(page: str) -> None:
    places = re.findall(r'<div[^>]*class="plot"[^>]*>', page)
    assert len(places) == len(PLOTS)
    assert all(re.search(r'role="img" aria-label="[^"]{10,}"', place) for place in places)


def _contrast(first: str, second: str) -> float:
    """Return the contrast of two colours as WCAG 2 defines it."""

    def luminance(colour: str) -> float:
        parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
        linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    light, dark = sorted((luminance(first), luminance(second)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def test_words_and_lines_stand_out_in_light_and_dark() -> None:
    style = (Path(words.__file__).parent / "page.css").read_text(encoding="utf-8")
    for block in re.findall(r":root \{(.*?)\}", style, re.DOTALL)[:2]:
        colours: dict[str, Any] = dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6})", block))
        texts = [(name, "paper") for name in ("ink", "soft", "link", "good", "bad")]
        texts += [("good", "good-paper"), ("bad", "bad-paper"), ("unsure", "unsure-paper")]
        # WCAG 2: 4.5 for text, 3 for lines.
        assert all(_contrast(colours[a], colours[b]) >= 4.5 for a, b in texts)
        lines = ("free", "locked", "law", "release")
        assert all(_contrast(colours[name], colours["paper"]) >= 3.0 for name in lines)


def test_the_sections_have_their_titles_in_the_contents_and_above_them(page: str) -> None:
    titles = [
        "What happens",
        "The motion",
        "Stability",
        "Can it be trusted?",
        "Margins",
        "What accuracy costs",
        "Parameters",
        "The theory in short",
        "How to reproduce it",
    ]
    text = html.unescape(page)
    assert re.search(r"<title>.*: Zeno periodic orbit</title>", text)
    for title in titles:
        assert len(re.findall(rf">\s*(?:\d+\.?\s*)?{re.escape(title)}\s*<", text)) >= 2, title


@pytest.mark.parametrize(("n", "many"), [(1, True), (2, True), (5, True)])
def test_an_elastic_stop_is_told_to_have_many_hits_for_any_number_in_the_file(
    subject: Subject, n: int, many: bool
) -> None:
    (phase,) = subject.orbit.phases
    orbit = subject.orbit.with_phases((replace(phase, impacts=phase.impacts[:n]),))
    text = words.story(orbit, subject.certificate, subject.execution)
    assert ("each impact is 5 times slower" in text) is many
    assert ("This one impact stops the part" in text) is not many


@pytest.mark.slow
def test_the_commands_of_a_problem_of_ones_own_name_its_file(subject: Subject, page: str) -> None:
    own = replace(subject, problem_file="mine/machine.py")
    search, check, _ = commands_in(page_of(own, load_bundle()))
    assert search[:3] == ["zeno-orbits", "search", "mine/machine.py"]
    assert check[-4:-2] == ["--problem", "mine/machine.py"]
    search, check, _ = commands_in(page)
    assert search[:3] == ["zeno-orbits", "search", "motor_pendulum"]
    assert "--problem" not in check
