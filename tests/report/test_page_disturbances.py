"""The section on disturbances of the report page, held against the files that it is made of."""

from __future__ import annotations

import base64
import html
import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.commands import YES, ask, assert_refused
from tests.support.disturbances import pushes_of, recovery_of
from tests.support.report_pages import commands_in
from zeno_orbits.model import HybridDynamics
from zeno_orbits.report import Subject, load_bundle, page_of
from zeno_orbits.report.plots import plot_pushes
from zeno_orbits.report.terminal import print_pushes

ONE = ("--periods", "1")
EVIL = "</script><script>window.taken = 1</script><img src=x>\"'&"


@pytest.fixture(scope="module")
def subject(
    orbit: zo.Orbit,
    problem: zo.Problem,
    machine: HybridDynamics,
    certificate: zo.OrbitCertificate,
) -> Subject:
    """The pendulum without a motion, which the section does not need."""
    return Subject(orbit=orbit, problem=problem, dynamics=machine, certificate=certificate)


@pytest.fixture
def folder(
    orbit: zo.Orbit, problem: zo.Problem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """The working folder, with the files of an orbit, of its pushes and of its recovery."""
    monkeypatch.chdir(tmp_path)
    zo.write_orbit(orbit, tmp_path / "orbit.json")
    write(pushes_of(orbit), "pushes.json")
    write(recovery_of(orbit, problem), "recovery.json")
    return tmp_path


def write(found: zo.Pushes | zo.Recovery, name: str) -> None:
    Path(name).write_text(json.dumps(found.as_json(), allow_nan=False))


def section_of(page: str) -> str:
    """Return the section on disturbances, or an empty text."""
    found = re.search(r'<section id="disturbances".*?</section>', page, re.DOTALL)
    return found[0] if found else ""


def rows_of(section: str, caption: str) -> list[dict[str, str]]:
    """Return the rows of the table with a caption, heading to cell."""
    found = re.search(rf"<caption>{caption}</caption>(.*?)</table>", section, re.DOTALL)
    assert found is not None, caption
    cells = re.compile(r"<t[hd][^>]*>(.*?)</t[hd]>", re.DOTALL)
    rows = [cells.findall(row) for row in re.findall(r"<tr>(.*?)</tr>", found[1], re.DOTALL)]
    return [
        dict(zip(map(html.unescape, rows[0]), map(html.unescape, r), strict=True)) for r in rows[1:]
    ]


def drawn_in(page: str) -> list[dict[str, Any]]:
    """Return the data of the pictures of pushes."""
    found = re.search(r'id="data">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return json.loads(found[1])["pushes"]


LEAST = "Least push per direction over all phases"
EXTENTS = "Largest difference from the orbit inside the ball, to first order"


# ---------------------------------------------------------------------------- its values


@pytest.mark.parametrize("seed", fast(2, range(5)))
@pytest.mark.parametrize("lost", [0.3, 0.9])
def test_the_least_push_of_each_row_is_the_minimum_over_the_file(
    subject: Subject, seed: int, lost: float
) -> None:
    directions = ({"theta1": 1.0}, {"theta2": 1.0}, {"theta1": 0.5, "theta2": -2.0})
    pushes = pushes_of(subject.orbit, seed=seed, lost=lost, directions=directions)
    listed = pushes.as_json()["pushes"]
    rows = rows_of(section_of(page_of(replace(subject, pushes=pushes), load_bundle())), LEAST)
    names = ["+theta1", "-theta1", "+theta2", "-theta2"]
    names += ["+0.5*theta1 -2*theta2", "-0.5*theta1 +2*theta2"]
    assert [row["direction"] for row in rows] == names
    signed = [{key: s * v for key, v in d.items()} for d in directions for s in (1.0, -1.0)]
    for row, direction in zip(rows, signed, strict=True):
        along = [one for one in listed if one["direction"] == direction]
        found = [one for one in along if one["largest"] is not None]
        assert row["unit"] == "N m s"
        if not found:
            shortest = min(one["searched"] for one in along)
            assert (row["least push"], row["phase [1]"]) == (
                f"none lost up to {shortest:.4g}",
                "all",
            )
            continue
        least = min(found, key=lambda one: one["largest"])
        assert row["least push"] == f"{least['largest']:.6g}"
        assert row["phase [1]"] == f"{least['phase']:.4g}"
        assert row["error"] == f"{least['error']:.1g}"
        assert row["after a larger push"] == least["beyond"]
        assert row["the part is"] == {"free": "off", "locked": "on"}[least["mode"]] + " the stop"


def test_the_points_of_the_pictures_are_those_of_the_file(subject: Subject) -> None:
    directions = ({"theta1": 1.0, "theta2": 1.0}, {"theta1": 1.0, "theta2": -1.0}, {"theta2": 1.0})
    pushes = pushes_of(subject.orbit, directions=directions)
    page = page_of(replace(subject, pushes=pushes), load_bundle())
    panels = drawn_in(page)
    assert [panel["label"] for panel in panels] == [
        "impulse along <i>θ</i><sub>1</sub> + <i>θ</i><sub>2</sub> [N m s]",
        "impulse along <i>θ</i><sub>1</sub> - <i>θ</i><sub>2</sub> [N m s]",
        "impulse along <i>θ</i><sub>2</sub> [N m s]",
    ]
    listed = pushes.as_json()["pushes"]
    for panel, direction in zip(panels, directions, strict=True):
        lost, kept = [], []
        for one in listed:
            for sense in (1.0, -1.0):
                if one["direction"] == {name: sense * entry for name, entry in direction.items()}:
                    size = one["searched"] if one["largest"] is None else one["largest"]
                    point = (one["phase"], sense * size, one["beyond"])
                    (kept if one["largest"] is None else lost).append(point)
        assert len(lost) + len(kept) == 10
        shown = panel["lost"]
        assert sorted(zip(shown["x"], shown["y"], shown["beyond"], strict=True)) == sorted(lost)
        shown = panel["kept"]
        assert sorted(zip(shown["x"], shown["y"], strict=True)) == sorted(p[:2] for p in kept)
        assert panel["contact"] == [0.0, 0.8]
        assert panel["range"] == pytest.approx([-0.1, 0.9])
    assert [f'id="plot-pushes-{k}"' in page for k in range(4)] == [True, True, True, False]


def test_the_figure_of_pushes_has_the_same_points(orbit: zo.Orbit) -> None:
    directions = ({"theta1": 1.0, "theta2": 1.0}, {"theta1": 1.0, "theta2": -1.0})
    pushes = pushes_of(orbit, directions=directions)
    figure = plot_pushes(pushes)
    assert [ax.get_ylabel() for ax in figure.axes] == [
        f"impulse along $\\theta_{{1}}$ {sign} $\\theta_{{2}}$ [N m s]" for sign in "+-"
    ]
    for ax, direction in zip(figure.axes, directions, strict=True):
        wanted: dict[str, list[tuple[float, float]]] = {"lost beyond": [], "end of the scan": []}
        for one in pushes.pushes:
            sense = one.direction["theta1"]
            if one.direction["theta2"] == sense * direction["theta2"]:
                lost = math.isfinite(one.largest)
                label = "lost beyond" if lost else "end of the scan"
                wanted[label].append((one.phase, sense * (one.largest if lost else one.searched)))
        for line in ax.lines:
            if line.get_label() in wanted:
                points = zip(line.get_xdata(), line.get_ydata(), strict=True)
                assert sorted(points) == sorted(wanted.pop(str(line.get_label())))
        assert not wanted


@pytest.mark.parametrize("lost", [0.0, 0.3, 1.0])
def test_the_summary_of_pushes_counts_the_losses_and_names_sizes_that_return(
    orbit: zo.Orbit, capsys: pytest.CaptureFixture[str], lost: float
) -> None:
    directions = ({"theta1": 1.0}, {"theta1": 1.0, "theta2": -2.0})
    pushes = pushes_of(orbit, directions=directions, lost=lost)
    print_pushes(pushes)
    last = capsys.readouterr().out.splitlines()[-1]
    listed = pushes.as_json()["pushes"]
    losses = [one for one in listed if one["largest"] is not None]
    assert f"Rows with a lost impulse: {len(losses)} of {len(listed)}" in last
    assert all(f"{one['beyond']} 1" in last for one in losses)
    assert ("(" in last) == bool(losses)
    for direction, name in zip(directions, ("theta1", "theta1 - 2 theta2"), strict=True):
        (told,) = re.findall(rf"([\d.]+) N m s along {re.escape(name)}(?: and|\.)", last)
        sizes = [
            one["searched"] if one["largest"] is None else one["largest"]
            for one in listed
            if {key: abs(v) for key, v in one["direction"].items()}
            == {key: abs(v) for key, v in direction.items()}
        ]
        # The size is rounded down to three digits.
        assert 0.99 * min(sizes) < float(told) <= min(sizes)


def test_every_push_of_the_file_is_a_row(subject: Subject) -> None:
    pushes = pushes_of(subject.orbit)
    section = section_of(page_of(replace(subject, pushes=pushes), load_bundle()))
    rows = rows_of(section, "Largest pushes")
    for row, one in zip(rows, pushes.as_json()["pushes"], strict=True):
        largest = "none lost" if one["largest"] is None else f"{one['largest']:.6g}"
        assert (row["largest"], row["searched"]) == (largest, f"{one['searched']:.4g}")
        assert (row["phase [1]"], row["mode"]) == (f"{one['phase']:.4f}", one["mode"])
    assert "7 impulses scanned in each direction and sense." in section
    assert "simulated for 77.5 s at most" in section
    least = min((one for one in pushes.pushes if one.largest > 0), key=lambda one: one.largest)
    assert f"Least push: {least.largest:.6g} N m s along {least.name}" in section


def test_the_recovery_stands_on_the_page(subject: Subject) -> None:
    recovery = recovery_of(subject.orbit, subject.problem)
    section = section_of(page_of(replace(subject, recovery=recovery), load_bundle()))
    assert f"decays to 2 % in 6 periods ({6 * subject.orbit.period:.6g} s)" in section
    assert "Factor 0.4375 per period, spectral radius 0.375" in section
    assert "Ball whose samples return into it: radius 0.25 (scaled, no unit)." in section
    # Two tests share the doubt of 10 %: the second one has a sixth of it.
    share = 1.0 - (0.1 / 6.0) ** (1.0 / 130.0)
    told = f"130 samples return: with confidence 90 %, at most {100 * share:.2g} % of the ball"
    assert told in section
    assert rows_of(section, EXTENTS) == [
        # 0.25 (3 / 5.75)^(1/2) and 0.5 (2 / 5.75)^(1/2), by the inverse of the norm.
        {"state": "theta1", "extent": "0.1806", "unit": "rad"},
        {"state": "dtheta1", "extent": "0.2949", "unit": "rad/s"},
    ]
    assert "Least push" not in section
    assert 'id="plot-pushes-0"' not in section


@pytest.mark.parametrize(
    ("radius", "size", "told"),
    [
        (0.0, 2, "The smallest ball fails the test."),
        (math.inf, 2, "All samples of every ball of the search return into it."),
        (math.inf, 0, "The section of the orbit is a single point."),
    ],
)
def test_a_ball_without_an_extent_is_one_sentence(
    subject: Subject, radius: float, size: int, told: str
) -> None:
    recovery = recovery_of(subject.orbit, subject.problem, radius=radius, size=size)
    section = section_of(page_of(replace(subject, recovery=recovery), load_bundle()))
    assert told in section
    assert "<table>" not in section
    assert "samples return:" not in section


def test_without_a_loss_the_page_says_so(subject: Subject) -> None:
    page = page_of(replace(subject, pushes=pushes_of(subject.orbit, lost=0.0)), load_bundle())
    section = section_of(page)
    assert "No impulse of the scan is lost." in section
    assert all(row["least push"].startswith("none lost up to ") for row in rows_of(section, LEAST))
    assert all(panel["lost"]["x"] == [] for panel in drawn_in(page))


def test_the_section_is_there_only_with_something_to_show(subject: Subject) -> None:
    page = page_of(subject, load_bundle())
    assert section_of(page) == ""
    assert "#disturbances" not in page
    with_it = page_of(replace(subject, pushes=pushes_of(subject.orbit)), load_bundle())
    sections = re.findall(r'<section id="([^"]+)"', with_it)
    assert sections.index("disturbances") == sections.index("stability") + 1
    assert re.findall(r'<li><a href="#([^"]+)">', with_it) == sections


def test_texts_of_pushes_that_are_html_stay_texts(subject: Subject) -> None:
    pushes = pushes_of(subject.orbit, directions=({EVIL: 1.0},))
    told = tuple(
        replace(push, unit=EVIL, beyond=EVIL if push.beyond else "") for push in pushes.pushes
    )
    recovery = recovery_of(subject.orbit, subject.problem)
    named = replace(recovery, extents={EVIL: 1.0}, units={EVIL: EVIL})
    page = page_of(
        replace(subject, pushes=replace(pushes, pushes=told), recovery=named), load_bundle()
    )
    assert page.count("<script") == 3
    assert "<img" not in page
    (panel,) = drawn_in(page)
    texts = [panel["label"], *panel["lost"]["beyond"]]
    assert all("<" not in text and html.escape(EVIL) in text for text in texts)


# ---------------------------------------------------------------------------- the command


@pytest.mark.slow
def test_report_takes_the_files_of_the_commands(folder: Path) -> None:
    files = ("--pushes", "pushes.json", "--recovery", "recovery.json")
    answer = ask("report", "orbit.json", "-o", "report.html", *files, *ONE)
    assert (answer.code, answer.err.count("Written")) == (YES, 0)
    page = (folder / "report.html").read_text(encoding="utf-8")
    data = json.loads((folder / "pushes.json").read_text())
    section = section_of(page)
    assert f"Least push: {data['least']['largest']:.6g} N m s" in section
    assert "in 6 periods" in section
    # The command of the page names its files.
    words = " ".join(commands_in(page)[-1])
    assert "--pushes pushes.json --recovery recovery.json" in words


@pytest.mark.slow
def test_the_python_function_takes_objects_and_files(
    folder: Path, orbit: zo.Orbit, problem: zo.Problem
) -> None:
    pushes, recovery = pushes_of(orbit), recovery_of(orbit, problem)
    one = zo.VerificationSettings(n_periods=1)
    by_file = zo.report_page(
        "orbit.json", pushes="pushes.json", recovery=folder / "recovery.json", settings=one
    )
    by_object = zo.report_page(orbit, pushes=pushes, recovery=recovery, settings=one)
    assert section_of(by_file) == section_of(by_object) != ""
    assert by_file == by_object
    # The orbit is inside the page, and no command is said to have written it.
    (file,) = re.findall(r'href="data:application/json;base64,([^"]+)"', by_object)
    assert base64.b64decode(file) == Path("orbit.json").read_bytes()
    assert "wrote this page." not in by_object


@pytest.mark.slow
def test_the_chain_of_commands_ends_in_the_section(folder: Path) -> None:
    few = ("--phases", "2", "--steps", "6", "-j", "1")
    assert ask("push", "orbit.json", *few, "-o", "pushes.json").code == YES
    assert ask("recovery", "orbit.json", "-o", "recovery.json").code == YES
    files = ("--pushes", "pushes.json", "--recovery", "recovery.json")
    assert ask("report", "orbit.json", "-o", "report.html", *files).code == YES
    section = section_of((folder / "report.html").read_text(encoding="utf-8"))
    listed = json.loads((folder / "pushes.json").read_text())["pushes"]
    least = min(one["largest"] for one in listed if one["largest"] is not None)
    assert f"Least push: {least:.6g} N m s" in section
    time = json.loads((folder / "recovery.json").read_text())["time"]
    assert f"({time:.6g} s)" in section


# ---------------------------------------------------------------------------- refusals

Both = dict[str, zo.Pushes | zo.Recovery]
REMEDY = {
    "pushes": "Run `zeno-orbits push -o` for this orbit.",
    "recovery": "Run `zeno-orbits recovery -o` for this orbit.",
}


@pytest.mark.parametrize("option", ["pushes", "recovery"])
@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            lambda one: replace(one, problem="motor_cart"),
            "must be of the problem `motor_pendulum`, but it is of `motor_cart`.",
        ),
        (
            lambda one: replace(one, gains={**one.gains, "Kp": 2.5000001}),
            "gain `Kp` is 2.5 in the orbit and 2.5000001 in the ",
        ),
        (
            lambda one: replace(one, gains={"Kp": 2.5}),
            "gain `Kd` is -1.0 in the orbit and missing in the ",
        ),
        (
            lambda one: replace(one, gains={**one.gains, "Ki": 1.0}),
            "gain `Ki` is missing in the orbit and 1.0 in the ",
        ),
        (
            lambda one: replace(one, parameters={**one.parameters, "restitution": 0.25}),
            "parameter `restitution` is 0.2 in the orbit and 0.25 in the ",
        ),
        (lambda one: replace(one, period=1.001 * one.period), "the period is 1.8"),
    ],
)
def test_a_file_of_another_orbit_is_one_line(
    folder: Path,
    orbit: zo.Orbit,
    problem: zo.Problem,
    option: str,
    change: Callable[[Any], Any],
    told: str,
) -> None:
    made: Both = {"pushes": pushes_of(orbit), "recovery": recovery_of(orbit, problem)}
    found = change(made[option])
    write(found, "other.json")
    answer = ask("report", "orbit.json", "-o", "report.html", f"--{option}", "other.json")
    assert_refused(answer, f"--{option} other.json: ", told, REMEDY[option])
    assert not (folder / "report.html").exists()
    # The object is refused like its file.
    arguments: dict[str, Any] = {option: found}
    with pytest.raises(zo.InputError, match=f"Argument `{option}` must be of th"):
        zo.report_page(orbit, **arguments)


def test_directions_and_states_of_another_machine_are_one_line(
    folder: Path, orbit: zo.Orbit, problem: zo.Problem
) -> None:
    turned = pushes_of(orbit, directions=({"theta3": 1.0},))
    metric = tuple(replace(push, unit="N s") for push in pushes_of(orbit).pushes)
    recovery = recovery_of(orbit, problem)
    degrees = replace(recovery, units={**recovery.units, "theta1": "deg"})
    for option, found, told in (
        ("pushes", turned, "direction `+theta3` [N m s] does not belong to the problem"),
        ("pushes", replace(pushes_of(orbit), pushes=metric), "direction `+theta1` [N s] does not"),
        ("recovery", degrees, "its states and units differ from the problem"),
    ):
        write(found, "other.json")
        answer = ask("report", "orbit.json", "-o", "report.html", f"--{option}", "other.json")
        assert_refused(answer, f"--{option} other.json: ", told)
    assert not (folder / "report.html").exists()


@pytest.mark.parametrize(
    ("option", "file", "told"),
    [
        ("pushes", "nowhere.json", "cannot be read (No such file or directory)"),
        ("pushes", "orbit.json", "entry `pushes` is missing"),
        ("pushes", "recovery.json", "entry `pushes` is missing"),
        ("recovery", "nowhere.json", "cannot be read (No such file or directory)"),
        ("recovery", "orbit.json", "entry `norm` is missing"),
        ("recovery", "pushes.json", "entry `norm` is missing"),
    ],
)
def test_a_file_of_another_kind_is_one_line(
    folder: Path, option: str, file: str, told: str
) -> None:
    answer = ask("report", "orbit.json", "-o", "report.html", f"--{option}", file)
    command = {"pushes": "push", "recovery": "recovery"}[option]
    wanted = f"--{option} {file}: must be a file of `zeno-orbits {command} -o`, but "
    assert_refused(answer, wanted, told, "Run this command again.")
    assert not (folder / "report.html").exists()


def test_the_page_does_not_replace_a_file_that_it_reads(folder: Path) -> None:
    (folder / "pushes.json").rename(folder / "pushes.html")
    answer = ask("report", "orbit.json", "-o", "pushes.html", "--pushes", "pushes.html")
    assert_refused(answer, "must be another file than the one that is read")
