"""What a page says of orbits of every kind, and how it is put together, from made-up numbers."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.orbits import shot_orbit
from tests.support.periods_by_hand import arc, impact, system, zeno
from zeno_orbits.orbits import EventSequence
from zeno_orbits.report.page import Bundle, page_of, words
from zeno_orbits.report.terminal import print_summary
from zeno_orbits.simulation import Execution, Mode, Release
from zeno_orbits.verification import CHECKS, OrbitCertificate

GOOD = OrbitCertificate(
    tolerance=2e-9,
    residuals={"closure": 1e-9, "first_impact": 3e-10},
    margins={"first_impact_speed": 2.5, "release_transversality": 1.25},
    energies={"input_work": 8.0, "copper_loss": -4.0, "energy_gain": 3e-13},
    multipliers=(0.25 + 0j,),
    multiplier_error=1e-6,
    delta_sweep=(),
    delta_order=3.0,
    integration_error=1e-12,
    zeno_error=1e-13,
    period=2.0,
    n_periods=3,
    model="derived",
)


def _orbit(*hits: float, **parts: Any) -> Any:
    named = {
        "problem": "toy",
        "period": 2.0,
        "has_phases": True,
        "events": [SimpleNamespace(name="impact stop", time=time) for time in hits],
        "impacts": [SimpleNamespace(time=time) for time in hits],
        "section": "release stop",
        "parameters": {"restitution": 0.25},
        "gains": {},
        "certificate": {},
        "versions": {},
    }
    return SimpleNamespace(**{**named, **parts})


HITS = [impact(0.5, (0.0, -4.0, 0.0)), impact(0.75, (0.0, -2.0, 0.0))]
LIMIT = zeno(1.25, (0.0, 0.0, 0.0), tail=0.125)
RELEASE = Release(time=2.0, state=np.zeros(3))
FLIGHT = arc(Mode.FREE, [0.0, 0.5], [(0, 0, 0), (0, -4, 0)])
REST = arc(Mode.LOCKED, [1.25, 2.0], [(0, 0, 0), (0, 0, 0)])


def _execution(*events: Any, arcs: Any = (FLIGHT, REST)) -> Execution:
    return Execution(state_names=("a", "b", "c"), arcs=tuple(arcs), events=events)


def _subject(**parts: Any) -> Any:
    named = {
        "orbit": _orbit(0.5, 0.75),
        "certificate": GOOD,
        "execution": _execution(*HITS, LIMIT, RELEASE),
        "trade": None,
        "pushes": None,
        "recovery": None,
        "comparison": None,
        "problem_file": "",
        "file": "orbit.json",
        "command": ("zeno-orbits", "report"),
        "problem": SimpleNamespace(
            name="toy", gap_unit="m", energy_unit="J", gains=(), parameters=()
        ),
    }
    return SimpleNamespace(**{**named, **parts})


# Sentences.


def test_a_period_with_a_zeno_point_is_told_by_its_numbers() -> None:
    told = words.story(_orbit(0.5, 0.75), GOOD, _execution(*HITS, LIMIT, RELEASE))
    assert told.startswith("In the model the motion repeats every 2 s.")
    for said in ("again after 0.5 s", "is 4 times slower than", "occur within 0.75 s"):
        assert said in told
    assert "stays in contact for 0.75 s" in told


@pytest.mark.parametrize(
    ("hits", "e", "many"),
    [((0.5, 0.75), 0.25, True), ((0.5, 0.75), 0.0, False), ((0.5,), 0.25, True)],
)
def test_one_hit_takes_all_speed_if_the_stop_is_plastic_and_not_if_the_file_lists_one_hit(
    hits: tuple[float, ...], e: float, many: bool
) -> None:
    orbit = _orbit(*hits, parameters={"restitution": e})
    told = words.story(orbit, GOOD, _execution(*HITS, LIMIT))
    assert ("It bounces" in told) is many
    assert ("it is the Zeno point" in told) is not many


def test_an_orbit_without_a_restitution_has_a_plastic_stop() -> None:
    orbit, at_once = _orbit(0.5, 0.75, parameters={}), replace(LIMIT, tail=0.0)
    assert "it is the Zeno point" in words.story(orbit, GOOD, _execution(HITS[0], at_once))
    # Its restitution may be a number, or a law with other parameters: 2 m/s after 4 m/s.
    assert "is 2 times slower than" in words.story(orbit, GOOD, _execution(*HITS, LIMIT))


def test_other_numbers_of_zeno_points_are_counted() -> None:
    told = words.story(_orbit(0.5), GOOD, _execution(*HITS))
    assert "rebounds 2 times per period" in told
    told = words.story(_orbit(0.5), GOOD, _execution(*HITS, LIMIT, LIMIT, LIMIT))
    assert "resolves 2 impacts" in told
    assert "3 times infinitely many" in told
    plastic = _orbit(0.5, parameters={"restitution": 0.0})
    told = words.story(plastic, GOOD, _execution(*HITS, LIMIT, LIMIT, LIMIT))
    assert "infinitely many" not in told
    assert "Each impact stops the part" in told


def test_a_false_orbit_is_told_as_what_its_file_says() -> None:
    refused = replace(GOOD, trouble="It is late")
    assert words.story(_orbit(0.5), refused, None).startswith("The file states this")
    assert words.story(_orbit(0.5), GOOD, None) == "In the model the motion repeats every 2 s."


def test_a_headline_says_what_is_known() -> None:
    assert words.headline(replace(GOOD, trouble="It is late")).startswith("Not verified")
    has = "Verified: the model has this orbit within the tolerance 2e-09"
    assert f"{has}, and small disturbances of it decay" in words.headline(GOOD)
    assert "but unstable" in words.headline(replace(GOOD, multipliers=(1.5 + 0j,)))
    assert "undecided" in words.headline(replace(GOOD, multipliers=(1.0 + 0j,)))


def test_a_small_push_is_told_by_the_largest_multiplier() -> None:
    assert "multiplied by about 0.25 per period" in words.stability(GOOD)
    assert "factor is about 2.5 per period" in words.stability(
        replace(GOOD, multipliers=(0.5 + 0j, -2.5 + 0j))
    )
    # One multiplier inside the unit circle: disturbances along its direction decay.
    assert "except along some directions" in words.stability(
        replace(GOOD, multipliers=(0.5 + 0j, -2.5 + 0j))
    )
    assert "determine its state" in words.stability(replace(GOOD, multipliers=()))
    unknown = replace(GOOD, multipliers=(), multiplier_error=math.inf)
    assert "not accurate enough" in words.stability(unknown)


TOO_STRONG = ("conserved", "keeps it", "settles", "the machine has", "machine leave", "proved")
"""Words that no sentence about a verification may contain: it concerns a model, to first order."""


def test_no_sentence_claims_more_than_a_verification_computes() -> None:
    unstable = replace(GOOD, multipliers=(1.5 + 0j, 0.5 + 0j))
    undecided = replace(GOOD, multipliers=(1.0 + 0j,))
    point = replace(GOOD, multipliers=())
    told = [*(check.plainly for check in CHECKS.values()), *(law[2] for law in words.LAWS)]
    for certificate in (GOOD, unstable, undecided, point):
        told += [words.headline(certificate), words.stability(certificate)]
        told.append(words.story(_orbit(0.5, 0.75), certificate, _execution(*HITS, LIMIT)))
        told.append(words.story(_orbit(0.5), certificate, _execution(*HITS, LIMIT, LIMIT)))
    for sentence in told:
        assert not any(word in sentence for word in TOO_STRONG), sentence
    for certificate in (unstable, undecided):
        assert "and small disturbances of it decay" not in words.headline(certificate)
    assert all("first order" in words.stability(one) for one in (GOOD, unstable))


@pytest.mark.parametrize(
    ("multiplier", "told"),
    [(0.5, "Found: stable "), (-1.5, "Found: unstable "), (1.0, ", of unknown stability")],
)
def test_an_orbit_whose_stability_is_unknown_is_not_called_unstable(
    multiplier: float, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    orbit = shot_orbit("vibrating_table")
    certificate = replace(GOOD, multipliers=(complex(multiplier),))
    print_summary(zo.load_problem("vibrating_table"), orbit, certificate)
    page = " ".join(capsys.readouterr().out.split())
    assert told in page
    assert ("stable Zeno" in page) is (abs(multiplier) != 1.0)
    assert ("unstable" in page) is (abs(multiplier) > 1.0)


@pytest.mark.parametrize(
    ("low", "high", "unit", "cautions"),
    [
        (-1.0, 3.2, "rad", 1),
        (-3.2, 1.0, "rad", 1),
        (-3.1, 3.1, "rad", 0),
        (-math.pi, math.pi, "rad", 0),
        (-9.0, 9.0, "rad/s", 0),
    ],
)
def test_only_an_angle_beyond_half_a_turn_gets_a_caution(
    low: float, high: float, unit: str, cautions: int
) -> None:
    swing = arc(Mode.FREE, [0.0, 1.0], [(0.0, low), (0.0, high)])
    problem: Any = SimpleNamespace(state_names=("x", "phi"), state_units=("m", unit))
    found = words.cautions(problem, _execution(arcs=[swing]))
    assert len(found) == cautions
    for caution in found:
        assert caution.startswith(f"phi runs from {low:g} to {high:g} rad")
    assert words.cautions(problem, None) == []


# Tables.


def test_everything_that_a_certificate_names_has_its_words() -> None:
    assert list(words.ENERGIES) == [
        *("input_work", "copper_loss", "other_loss", "impact_loss", "energy_gain"),
    ]


# The page as a whole.

LIBRARY = "plot = <the library>"
BUNDLE = Bundle(
    version="9.9",
    packed=base64.b64encode(gzip.compress(LIBRARY.encode())).decode(),
)


def _page(**parts: Any) -> str:
    problem = SimpleNamespace(
        name="toy",
        title="a <toy> of three states",
        source="a & b",
        gap_unit="m",
        energy_unit="J",
        gains=(),
        parameters=(),
        portraits=(("a", "b"),),
        outputs=(),
        drawing=None,
        state_names=("a", "b", "c"),
        state_units=("m", "m/s", "rad"),
        symbols=dict[str, Any],
        model=lambda _: SimpleNamespace(n_q=1),
        values=lambda parameters: SimpleNamespace(parameters={"restitution": 0.25, **parameters}),
    )
    shape = EventSequence.parsed(parts.pop("shape", "zeno"))
    named = {
        "problem": problem,
        "orbit": _orbit(0.5, 0.75, shape=shape, kind=shape.kind, values=lambda _: None),
        "dynamics": system(restitution=0.25, gap_acceleration=lambda _: -8.0),
        "date": "",
        "proof": (),
        "content": "",
        "trouble": "",
    }
    return page_of(_subject(**{**named, **parts}), BUNDLE)


@pytest.mark.parametrize(
    ("certificate", "kind", "mark"),
    [
        (GOOD, "passed", "✓"),
        (replace(GOOD, multipliers=(1.0 + 0j,)), "unsure", "!"),
        (replace(GOOD, trouble="It is late", multipliers=(2.0 + 0j,)), "refused", "✗"),
    ],
)
def test_the_banner_has_the_colour_and_the_sign_of_its_answer(
    certificate: OrbitCertificate, kind: str, mark: str
) -> None:
    page = _page(certificate=certificate)
    assert f'<div class="banner {kind}"' in page
    assert f'<span aria-hidden="true">{mark}</span> {words.headline(certificate)}' in page


@pytest.mark.parametrize(
    ("shape", "what"),
    [
        ("zeno", "Zeno periodic orbit"),
        ("plastic", "Simple periodic orbit"),
        ("impact", "Periodic orbit without a Zeno point"),
    ],
)
def test_a_page_is_titled_by_its_problem_and_by_what_it_shows(shape: str, what: str) -> None:
    page = _page(shape=shape)
    # Texts of a problem are no HTML.
    assert f"<title>A &lt;toy&gt; of three states: {what}</title>" in page
    assert "<h1>A &lt;toy&gt; of three states</h1>" in page
    assert f">{what} of the problem toy</p>" in page
    assert "Source of the problem: a &amp; b." in page


def test_scripts_are_those_whose_digests_the_page_allows() -> None:
    page = _page()
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    allowed = [
        "'sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() + "'"
        for text in (*scripts, LIBRARY)
    ]
    assert len(scripts) == 1
    assert f"script-src {' '.join(allowed)};" in page
    folder = Path(words.__file__).parent
    assert scripts[0] == (folder / "page.js").read_text(encoding="utf-8")
    assert f"<style>{(folder / 'page.css').read_text(encoding='utf-8')}</style>" in page
    assert f'id="library">{BUNDLE.packed}<' in page


def test_the_data_of_the_plots_is_compact_and_finite() -> None:
    page = _page()
    [data] = re.findall(r'id="data">(.*?)</script>', page, re.DOTALL)
    assert json.loads(data)["stability"] == {"re": [0.25], "im": [0.0]}
    assert '"re":[0.25],"im":[0.0]' in data
    odd = replace(GOOD, multipliers=(complex(0.25, math.nan),))
    with pytest.raises(ValueError, match="not JSON compliant"):
        _page(certificate=odd)


def test_what_is_known_of_the_error_is_told_and_what_is_not_is_not() -> None:
    sizes = dict.fromkeys(
        ("first_impact", "impact_sequence", "closure", "period", "release"), 3.1e-10
    )
    sure = replace(GOOD, residuals=sizes, integration_error=0.0, multipliers=())
    assert "right to about 3e-10 (relative" in _page(certificate=sure)
    assert "right to about" not in _page(certificate=GOOD)


def test_a_page_shows_as_many_pictures_of_a_zeno_point_as_there_are_flights() -> None:
    hop = arc(Mode.FREE, [0.5, 0.75], [(0, 2, 0), (0, -2, 0)])
    page = _page(execution=_execution(*HITS, LIMIT, RELEASE, arcs=[FLIGHT, hop, REST]))
    assert 'id="plot-gaps-0"' in page
    assert "A single impact" not in page
    page = _page(execution=_execution(HITS[0], LIMIT, RELEASE))
    assert 'id="plot-gaps-0"' not in page
    assert "A single impact leads to the Zeno point" in page
    for execution in (_execution(*HITS), None):
        page = _page(execution=execution)
        assert 'id="plot-zeno-0"' not in page


def test_commands_stand_one_a_line_and_the_file_is_inside() -> None:
    page = _page(content='{"a": "b"}', command=("zeno-orbits", "report", "my file.json"))
    [shown] = re.findall(r"<pre[^>]*><code>(.*?)</code></pre>", page, re.DOTALL)
    assert len(shown.splitlines()) == 3
    assert shown.splitlines()[-1] == "zeno-orbits report &#39;my file.json&#39;"
    [inside] = re.findall(r"application/json;base64,([^\"]*)", page)
    assert base64.b64decode(inside).decode() == '{"a": "b"}'


def test_a_caution_stands_on_the_page() -> None:
    swing = arc(Mode.FREE, [0.0, 0.5], [(0, 0, 0), (0, -4, 4)])
    assert "Caution: c runs from" in _page(execution=_execution(*HITS, arcs=[swing]))
    assert "Caution" not in _page()


def test_a_page_holds_no_space_that_its_template_alone_is_laid_out_with() -> None:
    page = _page()
    assert page.endswith("</html>\n")
    style = re.compile(r"<(style|script|pre).*?</\1>", re.DOTALL)
    lines = style.sub("", page).splitlines()
    assert not [line for line in lines if line != line.lstrip()]
    # A line of nothing but instructions leaves no line behind.
    template = (Path(words.__file__).parent / "page.html").read_text(encoding="utf-8")
    blank = sum(not line.strip() for line in template.splitlines())
    assert sum(not line for line in lines) <= blank + template.count("{% call")


# The motion of a subject.


def test_every_law_has_the_number_that_the_theory_gives_it() -> None:
    pages = (Path(__file__).parents[2] / "docs").glob("theory_*.md")
    theory = "".join(page.read_text(encoding="utf-8") for page in pages)
    titles = dict(re.findall(r"^### \((\d+\.\d+)\) (.*)$", theory, re.MULTILINE))
    told = {
        "Newton's law of an impact": "Reset map",
        "The Zeno point": "Gap acceleration and Theorem 1",
        "The release": "Release",
        "The energy balance": "Energy balance",
        "The time that all later flights take": "Zeno limit",
        "The return map": "Release section, return map, multipliers",
        "A residual": "Residuals of a certificate",
    }
    for (number, _, meaning), (begin, title) in zip(words.LAWS, told.items(), strict=True):
        assert meaning.startswith(begin)
        assert titles[number] == title
