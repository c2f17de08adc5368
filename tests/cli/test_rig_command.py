"""The command `rig`: what it prints, what it writes, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.commands import MISUSE, NO, YES, Answer, ask
from zeno_orbits import write_orbit
from zeno_orbits.experiment import Source, read_recording
from zeno_orbits.orbits import Orbit
from zeno_orbits.report.terminal import progress

QUICK = ("--only", "friction", "--part", "contact.stiffness=1e5", "--part", "contact.exponent=1")


@pytest.fixture
def file(tmp_path: Path, orbit: Orbit) -> Path:
    """The reference orbit in a file."""
    path = tmp_path / "orbit.json"
    write_orbit(orbit, path)
    return path


def refused(answer: Answer, message: str) -> bool:
    """Return True if a command was misused and says so in one line."""
    lines = answer.err.splitlines()
    return answer.code == MISUSE and len(lines) == 1 and message in lines[0] and not answer.out


@pytest.mark.slow
def test_a_machine_is_printed_beside_the_orbit_as_simulated(file: Path) -> None:
    answer = ask("rig", file, *QUICK, "--cycles", "2")
    assert answer.code == YES
    too_few = "2 cycles, too few to decide whether it has settled."
    assert f"Simulated, not measured: {too_few}" in answer.out
    for row in ("first impact", "Zeno point, or end of", "period", "1.813713"):
        assert row in answer.out


@pytest.mark.slow
def test_json_holds_the_numbers_of_orbit_and_machine_and_says_simulated(
    file: Path, orbit: Orbit, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "_PATIENCE", 0.0)
    answer = ask("rig", file, *QUICK, "--cycles", "2", "--json")
    assert answer.code == YES
    assert answer.data["source"] == "simulated"
    assert answer.data["orbit"]["period"] == orbit.period
    # Friction slows the machine by milliseconds.
    assert answer.data["mean"]["period"] == pytest.approx(orbit.period, abs=0.02)
    assert answer.data["mean"]["period"] != orbit.period
    assert "simulating the machine" in answer.err


@pytest.mark.weekly
@pytest.mark.slow
def test_a_machine_that_dies_away_is_not_called_settled(file: Path) -> None:
    # With readings that never arrive it swings without a voltage.
    clocked = ("rig", file, "--only", "controller", "--cycles", "8")
    unfed = ask(*clocked, "--part", "controller.delay=100")
    assert unfed.code == NO
    assert "8 cycles, and the machine has not settled: " in unfed.out
    fed = ask(*clocked)
    assert fed.code == YES
    assert "8 settled cycles." in fed.out


@pytest.mark.weekly
@pytest.mark.slow
def test_what_the_computer_reads_is_written_as_a_recording(file: Path, tmp_path: Path) -> None:
    written = tmp_path / "run.csv"
    answer = ask("rig", file, "--cycles", "1", "--seed", "4", "-o", written)
    assert answer.code == YES
    assert f"Written: {written}" in answer.out.replace("\n", "")
    recording = read_recording(written)
    assert recording.source is Source.SIMULATED
    assert recording.problem == "motor_pendulum"
    assert recording.notes["seed"] == "4"
    assert recording.names == ("theta1", "theta2", "current", "contact")
    # A cycle at 1 kHz.
    assert np.diff(recording.time) == pytest.approx(1e-3)
    assert len(recording.time) == pytest.approx(1814, abs=40)
    again = tmp_path / "again.csv"
    ask("rig", file, "--cycles", "1", "--seed", "4", "-o", again)
    assert again.read_bytes() == written.read_bytes()


def test_a_problem_runs_from_a_start_and_lists_its_contacts(tmp_path: Path) -> None:
    written = tmp_path / "run.csv"
    answer = ask(
        *("rig", "bouncing_ball", "--set", "restitution=0.5", "--part", "contact.stiffness=1e6"),
        *("--until", "1.5", "-o", written, "--json"),
    )
    assert answer.code == YES
    contacts = answer.data["contacts"]
    rates = [contact["approach_rate"] for contact in contacts]
    assert rates[0] == pytest.approx(-np.sqrt(2 * 9.81), rel=1e-6)
    # Half as fast each time, but for the weight during a contact of 3 to 4 ms: 0.04 of 4.4 m/s.
    assert rates[1] / rates[0] == pytest.approx(0.5, abs=0.04 / 4.4)
    assert contacts[-1]["end"] == 1.5
    recording = read_recording(written)
    assert recording.names == ("height", "contact")
    assert recording.source is Source.SIMULATED


@pytest.mark.slow
def test_parts_are_left_out_and_numbers_changed(file: Path) -> None:
    def period(*options: str) -> float:
        return float(ask("rig", file, "--cycles", "1", "--json", *options).data["mean"]["period"])

    bare = period("--only", "contact")
    assert period("--only", "contact", "--part", "contact.stiffness=1e6") != bare
    every = [("--without", name) for name in ("friction", "gears", "bridge", "controller")]
    assert period(*(word for pair in every for word in pair)) == bare
    assert period("--only", "friction") != bare


def test_exact_pulses_ask_for_a_bridge(file: Path) -> None:
    answer = ask("rig", file, "--only", "friction", "--exact-pwm")
    assert refused(answer, "--exact-pwm: needs a bridge, which the machine lacks.")


@pytest.mark.slow
def test_exact_pulses_tell_nearly_what_their_mean_tells() -> None:
    """A tenth of a second; a dead time and a ripple later the same within a per mille."""
    common = ("rig", "motor_pendulum", "--only", "bridge", "--until", "0.4", "--json")
    at = ("--start", "theta1=0.3", "--start", "theta2=0.02", "--start", "dtheta2=-1")
    mean, exact = ask(*common, *at), ask(*common, *at, "--exact-pwm")
    first, other = mean.data["contacts"][0], exact.data["contacts"][0]
    assert other["start"] == pytest.approx(first["start"], rel=1e-3)
    assert other != first


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("--part", "contact.stiffness=-1"),
            "--part contact.stiffness=-1: must be greater than 0, but it is -1.",
        ),
        (("--part", "contact.softness=1"), "Known: contact.stiffness"),
        (("--part", "contact.stiffness"), "--part: must be NAME=VALUE"),
        (("--part", "friction.knee.coulomb=1"), "`friction` must name one of theta1, theta2"),
        (("--set", "Kp=2"), "--set Kp=2: must not be given with an orbit, which has its own."),
        (("--until", "3"), "--until 3: must not be given with an orbit, whose periods"),
        (("--start", "theta1=2"), "--start theta1=2: must not be given with an orbit"),
        (("--until", "0"), "--until 0: must not be given with an orbit"),
        (("--only", "sensors"), "--only sensors: must name the controller with the sensors"),
        (("--seed", "-1"), "--seed: must be a whole number of at least 0, but it is `-1`."),
        (("--only", "motor"), "--only: unknown name `motor`. Known: friction, gears"),
        (
            ("-o", "no/such/folder/run.csv"),
            "-o no/such/folder/run.csv: must be in a writable folder",
        ),
    ],
)
def test_misuse_is_one_line(file: Path, arguments: tuple[str, ...], message: str) -> None:
    assert refused(ask("rig", file, *arguments), message)


def test_the_orbit_that_is_read_is_not_written_over(file: Path) -> None:
    before = file.read_bytes()
    other = "must be another file than the one that is read"
    assert refused(ask("rig", file, "-o", file), other)
    assert file.read_bytes() == before


def test_files_that_are_no_orbits_and_problems_that_are_none_are_refused(tmp_path: Path) -> None:
    assert refused(ask("rig", tmp_path / "no.json"), "no.json` cannot be read")
    assert refused(ask("rig", "no_scene"), "unknown problem")
    ball = ("rig", "bouncing_ball")
    assert refused(ask(*ball, "--cycles", "2"), "--cycles 2: must come with an orbit")
    assert refused(ask(*ball, "--until", "0"), "--until 0: must be a positive number, but it is 0.")
    plastic = ask("rig", "motor_pendulum", "--set", "restitution=0", "--only", "contact")
    assert refused(plastic, "restitution=0: must be greater than 0 for a compliant contact")


@pytest.mark.slow
def test_a_machine_without_such_cycles_is_a_no_and_leaves_no_file(
    file: Path, tmp_path: Path
) -> None:
    written = tmp_path / "run.csv"
    stuck = ("--only", "friction", "--part", "friction.theta1.coulomb=0.5")
    answer = ask("rig", file, *stuck, "--cycles", "1", "-o", written)
    assert answer.code == NO
    assert "cycles with a lasting contact, but 9 were expected" in answer.err
    assert not written.exists()


MACHINES = Path(__file__).parents[1] / "support" / "machines"


@pytest.mark.slow
def test_cycles_of_a_machine_are_the_orbits_and_its_default_stop_is_stiff(tmp_path: Path) -> None:
    file, path, data = MACHINES / "juggler.py", tmp_path / "orbit.json", tmp_path / "data.csv"
    assert ask("search", file, "-o", path).code == YES
    answer = ask("rig", path, "--problem", file, "--json", "-o", data)
    assert answer.code == YES
    # The clock fixes the period; the highest gap is 65 mm, a thousandth of it is the stop's share.
    assert answer.data["mean"]["period"] == pytest.approx(2 * np.pi / 15.0, rel=1e-9)
    assert 0.0 < answer.data["penetration"] < 1e-3 * 0.0651
    assert not answer.data["warnings"]
    assert ask("compare", path, data, "--problem", file).code == YES


@pytest.mark.slow
def test_a_soft_stop_is_warned_of_and_cycles_that_scatter_are_none(tmp_path: Path) -> None:
    file, path = MACHINES / "juggler.py", tmp_path / "orbit.json"
    assert ask("search", file, "-o", path).code == YES
    soft = ask("rig", path, "--problem", file, "--part", "contact.stiffness=1e5")
    assert soft.code == NO
    assert "the stop gives way by" in soft.out
    assert "none of the orbit's kind" in soft.out
    assert "10 settled cycles" not in soft.out
    start = ask("rig", file, "--until", "1", "--part", "contact.stiffness=1e5")
    assert "the stop gives way by" in start.out


@pytest.mark.slow
def test_a_machine_of_micrometres_and_microseconds_is_printed_with_prefixes(
    tmp_path: Path,
) -> None:
    # The juggler a million times smaller and a thousand times faster, in SI units.
    text = (MACHINES / "juggler.py").read_text(encoding="utf-8")
    text = text.replace("default=0.075", "default=0.075e-6").replace(
        '"omega", 15.0', '"omega", 15e3'
    )
    file, path = tmp_path / "small.py", tmp_path / "orbit.json"
    file.write_text(text, encoding="utf-8")
    assert ask("search", file, "-o", path).code == YES
    answer = ask("rig", path, "--problem", file, "--cycles", "2")
    assert answer.code == YES
    row = next(line for line in answer.out.splitlines() if line.startswith("period"))
    assert row.split()[1] == "us"
    assert float(row.split()[2]) == pytest.approx(2 * np.pi / 15e3 * 1e6, rel=1e-6)
    assert "0.000" not in row


@pytest.mark.slow
def test_many_contacts_are_summed_up_by_stop_and_listed_on_request() -> None:
    words = ("rig", "bouncing_ball", "--set", "restitution=0.9", "--until", "7.6")
    words = (*words, "--part", "contact.stiffness=1e5")
    short, whole, data = (ask(*words, *more) for more in ((), ("--events",), ("--json",)))
    contacts = data.data["contacts"]
    assert len(contacts) > 16
    assert len(short.out.splitlines()) < 10
    assert "--events prints every contact." in short.out
    (line,) = (one for one in short.out.splitlines() if one.startswith("stop  ") and "." in one)
    _, count, first, last, fastest, _ = line.split()
    assert int(count) == len(contacts)
    assert float(first) == pytest.approx(contacts[0]["start"], rel=1e-6)
    assert float(last) == pytest.approx(contacts[-1]["end"], rel=1e-6)
    assert float(fastest) == pytest.approx(min(one["approach_rate"] for one in contacts), rel=1e-6)
    assert len(whole.out.splitlines()) > len(contacts)
