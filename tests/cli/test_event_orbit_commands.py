"""Commands on machines with several stops or switches: what they print, write and refuse."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import zeno_orbits as zo
from tests.support.commands import NO, YES, ask, assert_refused
from tests.support.orbits import event_orbit, shot_orbit
from zeno_orbits.verification import verifier

pytestmark = pytest.mark.usefixtures("here")


@pytest.mark.slow
def test_simulate_names_stops_and_switches() -> None:
    answer = ask("simulate", "kneed_walker", "--until", "1.2")
    assert answer.code == YES
    for words in ("impact knee", "Zeno point knee +-", "switch heel strike", "2 switches"):
        assert words in answer.out
    events = ask("simulate", "kneed_walker", "--until", "1.2", "--json").data["events"]
    assert {event["event"] for event in events} == {"impact", "zeno_point", "switch", "release"}
    assert events[0]["stop"] == "knee"
    assert [one for one in events if one["event"] == "switch"][-1]["switch"] == "heel strike"


@pytest.mark.slow
def test_simulate_writes_samples_and_a_picture() -> None:
    answer = ask("simulate", "clapper", "--until", "8", "-o", "data.csv", "--plot", "states.png")
    assert answer.code == YES
    assert Path("data.csv").stat().st_size > 1000
    assert Path("states.png").stat().st_size > 1000
    assert "contact at lower" in answer.out


def test_search_writes_a_file_that_verify_passes() -> None:
    answer = ask("search", "hopper", "-o", "hopper.json")
    assert answer.code == YES
    assert "Found: stable orbit `switch kink 2" in answer.out
    assert "Written: hopper.json" in answer.out
    checked = ask("verify", "hopper.json", "--margins")
    assert checked.code == YES
    assert "switch_transversality" in checked.out
    certificate = ask("verify", "hopper.json", "--json").data
    assert certificate["passed"]
    assert certificate["events"][-1] == "impact stop"
    assert "shape" not in certificate


def test_verify_prints_the_error_of_an_orbit_of_any_machine() -> None:
    zo.write_orbit(event_orbit("hopper"), "hopper.json")
    zo.write_orbit(shot_orbit("vibrating_table"), "table.json")
    for file in ("hopper.json", "table.json"):
        error = ask("verify", file, "--accuracy", "1e-9", "--json").data["error"]
        assert 0.0 < error < 1e-9
        assert "error" not in ask("verify", file, "--json").data


@pytest.mark.slow
def test_plot_draws_the_pictures_that_an_orbit_has() -> None:
    zo.write_orbit(event_orbit("hopper"), "hopper.json")
    answer = ask("plot", "hopper.json", "-o", "pictures", "--json")
    # No impacts accumulate, and the problem has no outputs.
    assert answer.data == {"pictures": ["pictures/portraits.png", "pictures/time.png"]}
    assert all(Path(path).stat().st_size > 1000 for path in answer.data["pictures"])


@pytest.mark.slow
def test_figures_draws_the_mechanism_and_the_portraits() -> None:
    words = ("--kind", "mechanism", "--kind", "portraits", "--json")
    answer = ask("figures", "hopper", "-o", "figures", *words)
    assert answer.code == YES
    names = [f"figures/{name}" for name in ("fig3_mechanism", "fig4_portraits")]
    assert answer.data["figures"] == [f"{name}.{kind}" for name in names for kind in ("pdf", "png")]
    assert answer.data["left_out"] == {}


@pytest.mark.slow
def test_report_writes_the_page_and_returns_the_verdict() -> None:
    zo.write_orbit(event_orbit("hopper"), "hopper.json")
    answer = ask("report", "hopper.json", "-o", "page.html")
    assert answer.code == YES
    page = Path("page.html").read_text(encoding="utf-8")
    (command,) = (line for line in page.splitlines() if "zeno-orbits search hopper" in line)
    assert "--section" in command
    assert_refused(ask("report", "hopper.json", "-o", "p.html", "--proof", "a.json"), "--proof")
    data = json.loads(Path("hopper.json").read_text())
    data["start_state"]["speed"] *= 1.001
    Path("hopper.json").write_text(json.dumps(data))
    assert ask("report", "hopper.json", "-o", "page.html").code == NO


def test_an_unstable_orbit_is_written_only_if_it_is_accepted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    verify = verifier.verify

    def doubled(*args: Any, **options: Any) -> zo.OrbitCertificate:
        return replace(verify(*args, **options), multipliers=(2.0 + 0.0j,))

    monkeypatch.setattr(verifier, "verify", doubled)
    words = ("search", "hopper", "-o", "orbit.json")
    refused = ask(*words)
    assert refused.code == NO
    assert "The orbit is not stable: its spectral radius is 2." in refused.out
    assert "Try: --allow-unstable, to accept an unstable orbit." in refused.out
    assert not Path("orbit.json").exists()
    assert ask(*words, "--allow-unstable").code == YES
    assert Path("orbit.json").exists()


def test_verify_refuses_a_changed_file() -> None:
    zo.write_orbit(event_orbit("hopper"), "hopper.json")
    data = json.loads(Path("hopper.json").read_text())
    data["start_state"]["speed"] *= 1.001
    Path("hopper.json").write_text(json.dumps(data))
    answer = ask("verify", "hopper.json")
    assert answer.code == NO
    assert answer.out.startswith("Refused: `first_impact`")


@pytest.mark.slow
def test_continue_follows_an_event_sequence() -> None:
    answer = ask("continue", "hopper", "--parameter", "restitution=0.4:0.6", "-o", "family.json")
    assert answer.code == YES
    family = json.loads(Path("family.json").read_text())["families"][0]
    assert [end["kind"] for end in family["ends"]] == 2 * ["end of the range"]
    for point in family["points"]:
        # The multiplier is the square of the restitution.
        assert point["multipliers"][0][0] == pytest.approx(point["value"] ** 2, abs=1e-8)


@pytest.mark.slow
def test_a_search_takes_the_options_of_every_machine() -> None:
    words = ("search", "hopper", "--states", "--checkpoint", "kept", "-o", "hopper.json")
    answer = ask(*words)
    assert answer.code == YES
    events = json.loads(Path("hopper.json").read_text())["events"]
    table = answer.out[answer.out.index("before ") :].splitlines()[1:]
    for line, event in zip(table, events, strict=False):
        *name, height, speed = line.split()
        assert " ".join(name) == event["name"]
        state = event["state"]
        assert float(height) == pytest.approx(state["height"], rel=1e-9, abs=1e-12)
        assert float(speed) == pytest.approx(state["speed"], rel=1e-9, abs=1e-12)
    # The hopper leaves the ground after each impact.
    other = ask("search", "hopper", "--shape", "zeno", "--until", "20")
    assert other.code == NO
    assert "`zeno stop, release stop`" in other.out
    assert "Try: omit --shape" in other.out


@pytest.mark.slow
def test_starts_of_a_machine_of_events_are_kept_and_taken_up() -> None:
    words = ("search", "hopper", "--vary", "a=15:40", "--objective", "impacts", "--candidates", "2")
    words = (*words, "--n-starts", "2", "--json")
    plain = ask(*words, "--workers", "1")
    assert plain.code == YES
    # The least loss is at the least push, wherever the search starts.
    assert plain.data["search"]["value"] == pytest.approx(1.5, rel=1e-8)
    kept = ask(*words, "--workers", "2", "--checkpoint", "kept")
    again = ask(*words, "--workers", "1", "--checkpoint", "kept")
    assert plain.data == kept.data == again.data
    other = ask(*words[:3], "a=16:40", *words[4:-1], "--checkpoint", "kept")
    assert_refused(other, "--checkpoint kept", "`free.a`")


def test_a_section_of_a_machine_with_one_stop_is_chosen() -> None:
    words = ("search", "vibrating_table", "-o", "table.json")
    assert ask(*words, "--section", "zeno stop").code == YES
    assert json.loads(Path("table.json").read_text())["events"][-1]["name"] == "zeno stop"
    assert ask("verify", "table.json").code == YES


@pytest.mark.weekly
@pytest.mark.slow
def test_search_uses_the_method_that_is_asked_for() -> None:
    words = ("search", "hopper", "--vary", "a=5:40", "--objective", "impacts")
    words = (*words, "--bounds", "stop.impact_speed=2:", "--json")
    found = {name: ask(*words, "--method", name) for name in ("program", "shooting")}
    for name, answer in found.items():
        assert answer.code == YES
        assert answer.data["search"]["method"] == name
        # v^2 = 2 a s / (1 - e^2) with s = 0.1 and e = 0.5.
        assert answer.data["search"]["free"]["a"] == pytest.approx(15.0, rel=1e-6)
    assert found["program"].data["search"]["iterations"] > 0
    assert found["shooting"].data["search"]["iterations"] == 0


@pytest.mark.slow
def test_search_refuses_a_method_without_the_objective_and_an_unknown_method() -> None:
    words = ("search", "hopper", "--vary", "a=5:40", "--objective", "contraction")
    assert_refused(ask(*words, "--method", "program"), "--method", "shooting or auto")
    assert_refused(ask(*words, "--method", "prgram"), "--method", "program")


IMPACT_PAIR = ("--set", "k=0", "--set", "c=0", "--set", "restitution=0.9", "--set", "omega=2")


@pytest.mark.slow
def test_search_ranks_attractors_that_coexist_and_prints_where_it_looked() -> None:
    words = ("search", "clapper", *IMPACT_PAIR, "--set", "A=4", "--candidates", "3")
    answer = ask(*words, "-o", "best.json")
    assert answer.code == YES
    assert "rank  score  period [s]  spectral radius" in answer.out
    looked = "1 start and 24 initial states at the values of the best orbit led to 2 orbits."
    assert f"1 fewer than requested: {looked}" in answer.out
    assert "Asked for" not in answer.out
    data = ask(*words, "--json").data
    assert [one["orbit"]["certificate"]["passed"] for one in data["candidates"]] == [True, True]
    assert data["candidates"][0]["orbit"]["start_state"] == data["start_state"]
    assert data["failures"] == []
    assert looked in data["notes"][0]
    assert zo.read_orbit("best.json").start_state == data["start_state"]


@pytest.mark.weekly
@pytest.mark.slow
def test_orbits_that_are_not_stable_are_not_ranked() -> None:
    # From A = 4.1 the least loss belongs to an orbit that repels.
    words = ("search", "clapper", *IMPACT_PAIR[:4], "--set", "restitution=0.7")
    words = (*words, "--set", "omega=1.5", "--set", "A=4.1", "--vary", "A=3.65:4.2")
    words = (*words, "--objective", "impacts", "--candidates", "2")
    data = ask(*words, "--n-starts", "1", "--json").data
    radii = [
        max(math.hypot(*mu) for mu in one["orbit"]["floquet_multipliers"])
        for one in data["candidates"]
    ]
    assert radii
    assert max(radii) < 1.0
    scores = [one["score"] for one in data["candidates"]]
    assert scores == sorted(scores)
    # The impacts of one period lose the work of the force in this period.
    for one in data["candidates"]:
        worked = one["orbit"]["certificate"]["energies"]["input_work"]
        assert one["score"] == pytest.approx(worked, rel=1e-9)


@pytest.mark.slow
def test_search_finds_gains_that_keep_a_bound_and_writes_their_orbit() -> None:
    answer = ask(
        *("search", "hopper", "--vary", "a=5:40", "--objective", "impacts"),
        *("--bounds", "stop.impact_speed=2:", "-o", "hopper.json"),
    )
    assert answer.code == YES
    # The loss is the work a s of the push, and v^2 = 2 a s / (1 - e^2).
    assert "Asked for the least energy lost in impacts in a period: 1.5" in answer.out
    assert "stop.impact_speed" in answer.out
    assert "Written: hopper.json" in answer.out
    orbit = zo.read_orbit("hopper.json")
    assert orbit.parameters["a"] == pytest.approx(15.0, rel=1e-6)
    assert orbit.certificate["asked"][0]["kept"]


@pytest.mark.slow
def test_search_finds_the_least_energy_from_a_known_orbit() -> None:
    assert ask("search", "limited_pendulum", "--set", "Kp=2.4", "-o", "known.json").code == YES
    words = ("search", "limited_pendulum", "--near", "known.json", "--set", "Kp=2.4")
    words = (*words, "--vary", "Kd=-1.1:-0.9")
    answer = ask(*words, "--objective", "energy", "--bounds", "theta2=:1.9", "-o", "best.json")
    assert answer.code == YES
    assert "Asked for the least electrical energy per period: " in answer.out
    best = zo.read_orbit("best.json")
    assert best.gains["Kp"] == 2.4
    assert best.certificate["asked"][0]["quantity"] == "theta2"
    again = ask("search", "limited_pendulum", "--near", "best.json", "--json").data
    assert again["period"] == pytest.approx(best.period, rel=1e-12)
    refused = ask("search", "hopper", "--near", "best.json")
    assert_refused(refused, "--near best.json", "must be an orbit of `hopper`")
    refused = ask(*words, "--start", "theta1=1")
    assert_refused(refused, "--start", "known orbit")


@pytest.mark.slow
def test_search_of_one_stop_takes_the_worst_case_of_the_energy() -> None:
    words = ("search", "motor_pendulum", "--set", "Kp=2.5", "--vary", "Kd=-1.1:-0.9")
    answer = ask(*words, "--objective", "energy", "--uncertain", "R=2.95:3.05")
    assert answer.code == YES
    assert "in the worst case for R = 2.95 to 3.05" in answer.out
    asked = re.search(r"for R = 2.95 to 3.05: (\S+)\.\s", answer.out)
    worst = re.search(r"Worst case: (\S+) at", answer.out)
    assert asked is not None
    assert worst is not None
    assert asked[1] == worst[1]
    assert "Worst case: " in answer.out


@pytest.mark.slow
def test_search_says_no_if_no_orbit_keeps_a_bound() -> None:
    words = ("search", "hopper", "--vary", "a=5:40", "--bounds", "stop.impact_speed=9:")
    told = ask(*words, "--json")
    assert told.code == NO
    assert told.data["found"] is False
    assert told.data["search"]["asked"][0]["kept"] is False
    assert "`stop.impact_speed` leaves its bounds 9: by" in told.data["search"]["detail"]


@pytest.mark.parametrize(
    "options",
    [
        (["--objective", "impacts=roof"], "--objective", "`roof`"),
        (["--objective", "energy"], "--objective", "lacks a source of energy"),
        (["--objective", "peak=hight"], "--objective", "Did you mean `height`"),
        (["--bounds", "hight=:1"], "--bounds", "Did you mean `height`"),
        (["--bounds", "roof.impact_speed=1:"], "--bounds", "stop.impact_speed"),
        (["--bounds", "stop.impacts=:1"], "--bounds", "bound a speed"),
        (["--uncertain", "s=0.1:0.2"], "--uncertain", "energy, peak, impacts or bounce"),
        (["--objective", "impacts", "--uncertain", "w=1:2"], "--uncertain", "`w`"),
        (["--objective", "bounce"], "--objective", "`bounce_time` does not occur"),
        (["--set", "a=50"], "--set", "[5, 40]"),
    ],
)
def test_search_refuses_objectives_and_bounds_without_a_meaning(
    options: tuple[list[str], str, str],
) -> None:
    words, option, reason = options
    assert_refused(ask("search", "hopper", "--vary", "a=5:40", *words), option, reason)


@pytest.mark.slow
def test_search_of_one_stop_accepts_objectives_and_bounds_about_impacts() -> None:
    words = ("search", "vibrating_table", "--vary", "A=0.012:0.017")
    answer = ask(*words, "--objective", "impacts", "--bounds", "stop.impact_time=0.13:")
    assert answer.code == YES
    assert "Asked for the least energy lost in impacts in a period" in answer.out
    bound = ask(*words, "--bounds", "stop.impact_speed=:0.4", "-o", "table.json")
    assert bound.code == YES
    assert ask("verify", "table.json").code == YES
    assert_refused(ask(*words, "--objective", "impacts=roof"), "--objective", "`roof`")
    shape = ask(*words, "--objective", "impacts", "--shape", "zeno", "-o", "shaped.json")
    assert shape.code == YES
    assert json.loads(Path("shaped.json").read_text())["shape"] == "zeno"


@pytest.mark.slow
def test_objectives_about_impacts_refuse_a_machine_without_them() -> None:
    # A ball that is dropped on the ground comes to rest.
    ball = ("search", "bouncing_ball", "--vary", "restitution=0.4:0.6", "--objective", "impacts")
    told = ask(*ball)
    assert told.code == NO
    assert "comes to rest" in told.out
    assert told.err == ""
    # An oscillator whose force does not lift it off its stop.
    still = ("search", "impact_oscillator", "--vary", "A=0.01:0.02", "--objective", "impacts")
    words = " ".join(ask(*still, "--until", "60").out.split())
    assert "the motion strikes no stop and passes no switch." in words
    stop = ("search", "relay", "--vary", "U=20:24", "--objective", "bounce=roof")
    assert_refused(ask(*stop), "--objective bounce=roof", "closed, open")


def test_a_waveform_whose_times_leave_the_period_is_refused_in_one_line() -> None:
    words = ("search", "relay_soft", "--objective", "impacts", "--vary", "t1=0.001:0.0015")
    assert_refused(ask(*words, "--set", "t2=0.05"), "`times`", "0.02 s is not above `t2` = 0.05 s")


def test_a_search_for_impacts_without_anything_to_vary_is_refused() -> None:
    # The levels and times of `relay` are parameters, and none is varied.
    words = ("--objective", "Add --vary NAME=LOW:HIGH")
    assert_refused(ask("search", "relay", "--objective", "impacts"), *words)


def test_commands_for_machines_with_one_stop_refuse_the_problem_and_its_orbit() -> None:
    zo.write_orbit(event_orbit("hopper"), "hopper.json")
    assert_refused(ask("zeno-condition", "relay"), "`relay`", "has 2 stops")
    region = ("plot", "hopper.json", "-o", "pictures", "--kind", "region")
    assert_refused(ask(*region), "--kind region", "one stop")
    assert_refused(ask("plot", "hopper.json", "--kind", "zeno"), "--kind zeno")
    for kind in ("graph", "region", "beside"):
        answer = ask("figures", "hopper.json", "-o", "figures", "--kind", kind)
        assert_refused(answer, "one stop", "`hopper`")
    assert_refused(ask("verify", "hopper.json", "--rigorous"), "--rigorous", "one stop")


@pytest.mark.slow
def test_rig_of_an_orbit_of_events_writes_a_recording_with_its_contacts() -> None:
    zo.write_orbit(event_orbit("hopper"), "hopper.json")
    words = ("rig", "hopper.json", "--part", "contact.stiffness=1e5", "--cycles", "2")
    told = ask(*words, "--rate", "1000", "-o", "run.csv", "--json")
    assert told.code == YES
    assert len(told.data["contacts"]) == 2
    recording = zo.read_recording("run.csv")
    assert recording.names == ("height", "contact")
    assert set(recording.signal("contact").values) == {0.0, 1.0}
    assert_refused(ask("rig", "hopper.json", "--noise", "-1", "-o", "run.csv"), "--noise")
    assert_refused(ask("rig", "motor_pendulum", "--rate", "100"), "--rate", "controller")
    assert_refused(ask("rig", "hopper", "--until", "1", "--rate", "0.1"), "--rate")


def test_continue_refuses_values_beside_an_orbit_file_and_an_orbit_of_another_problem() -> None:
    zo.write_orbit(event_orbit("hopper"), "hopper.json")
    words = ("continue", "hopper", "--parameter", "s=0.05:0.2", "--near", "hopper.json")
    assert_refused(ask(*words, "--set", "a=10"), "--near", "--set")
    other = ("continue", "clapper", "--parameter", "d=0.5:2", "--near", "hopper.json")
    assert_refused(ask(*other), "`clapper`", "`hopper`")
    outside = ("continue", "hopper", "--parameter", "s=0.2:0.4", "--set", "s=0.1")
    assert_refused(ask(*outside), "s = 0.1")
