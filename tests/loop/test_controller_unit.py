"""The controller as a co-simulation unit, run by FMPy beside `simulate`."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.loop.agreement import needs_compiler
from tests.loop.test_controller import PENDULUM, readings
from tests.support.commands import YES, ask
from tests.support.repelling import KD
from zeno_orbits.arrays import Vector

fmpy = pytest.importorskip("fmpy")
pytestmark = needs_compiler


class Slave:
    """A unit in FMPy."""

    def __init__(self, file: Path, folder: Path) -> None:
        slave = pytest.importorskip("fmpy.fmi3").FMU3Slave
        fmpy.extract(str(file), str(folder))
        known: Any = fmpy.read_model_description(str(folder))
        self.places = {one.name: one.valueReference for one in known.modelVariables}
        self.causalities = {one.name: one.causality for one in known.modelVariables}
        self.unit: Any = slave(
            guid=known.guid,
            unzipDirectory=str(folder),
            modelIdentifier=known.coSimulation.modelIdentifier,
            instanceName="controller",
        )
        self.unit.instantiate()

    def begin(self, start: float) -> None:
        """Go through the initialization."""
        self.unit.enterInitializationMode(startTime=start)
        self.unit.exitInitializationMode()

    def set(self, values: dict[str, float]) -> None:
        """Set readings."""
        self.unit.setFloat64([self.places[one] for one in values], list(values.values()))

    def touch(self, contact: bool) -> None:
        """Set the contact."""
        self.unit.setBoolean([self.places["contact"]], [contact])

    def get(self, *names: str) -> list[float]:
        """Return variables."""
        return list(self.unit.getFloat64([self.places[one] for one in names]))

    def step(self, time: float, size: float) -> None:
        """Take a step."""
        self.unit.doStep(currentCommunicationPoint=time, communicationStepSize=size)


@pytest.fixture(name="exported", scope="module")
def _exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The unit of the controller of the held pendulum."""
    from zeno_orbits.loop import ControllerUnit, controller_of, exported_controller_unit

    state = np.array(PENDULUM.initial_state())
    units = dict(zip(PENDULUM.state_names, PENDULUM.state_units, strict=True))
    unit = ControllerUnit(
        controller=controller_of(PENDULUM, PENDULUM.values(), state),
        state=state,
        units=units,
        generator="test",
    )
    content, reason = exported_controller_unit(unit)
    assert not reason
    file = tmp_path_factory.mktemp("unit") / "controller.fmu"
    file.write_bytes(content)
    return file


@pytest.fixture(name="slave")
def _slave(exported: Path, tmp_path: Path) -> Iterator[Slave]:
    one = Slave(exported, tmp_path / "unpacked")
    yield one
    one.unit.freeInstance()


def _sensors(x: Vector) -> dict[str, float]:
    named = zip(PENDULUM.state_names, x.tolist(), strict=True)
    return {name: value for name, value in named if name != "held_Kd"}


@pytest.mark.parametrize("periods", [4, pytest.param(100, marks=pytest.mark.slow)])
def test_the_unit_sets_what_the_machine_sets(slave: Slave, periods: int) -> None:
    run = zo.simulate(PENDULUM, until=periods * 2.1102613)
    place, last = PENDULUM.state_names.index("held_Kd"), KD
    rows = list(readings(run))
    slave.begin(rows[0][0])
    assert slave.get("held_Kd") == [KD]
    for (time, x, closed, after), (end, *_) in pairwise(rows):
        known = _sensors(x)
        slave.set(known)
        slave.touch(closed)
        slave.step(time, end - time)
        last = last if after is None else after[place]
        held, voltage = slave.get("held_Kd", "voltage")
        assert held == last
        assert voltage == -(held * known["dtheta1"] + 2.5 * known["theta1"])
    assert last != KD
    assert len({after[place] for *_, after in rows if after is not None}) >= 3


def test_a_unit_takes_readings_alone_and_refuses_nonsense(slave: Slave) -> None:
    refused = pytest.importorskip("fmpy.fmi1").FMICallException
    assert [one for one, kind in slave.causalities.items() if kind == "output"] == [
        *("held_Kd", "voltage"),
    ]
    slave.begin(0.0)
    first = slave.get("dtheta1", "held_Kd")
    for work in (
        lambda: slave.set({"dtheta1": 1.0, "theta1": float("nan")}),
        lambda: slave.set({"held_Kd": -1.5}),
        lambda: slave.set({"contact": 1.0}),
        lambda: slave.get("contact"),
        lambda: slave.unit.setBoolean([slave.places["dtheta1"]], [True]),
        lambda: slave.step(0.5, 0.1),
        lambda: slave.step(0.0, -0.1),
    ):
        with pytest.raises(refused):
            work()
    assert slave.get("dtheta1", "held_Kd") == first


def test_a_kept_state_is_taken_again(slave: Slave) -> None:
    slave.begin(0.0)
    slave.touch(True)
    slave.step(0.0, 0.05)
    slave.step(0.05, 0.05)
    kept = slave.unit.getFMUState()
    found: list[list[float]] = []
    for _ in range(2):
        slave.touch(False)
        slave.set({"dtheta1": -5.5})
        slave.step(0.1, 0.1)
        found.append(slave.get("time", "dtheta1", "held_Kd", "voltage"))
        slave.unit.setFMUState(kept)
    assert found[0] == found[1]
    # The contact of 0.05 s has persisted, so its end sets the gain.
    assert found[0][2] != KD
    assert slave.get("held_Kd") == [KD]
    slave.unit.freeFMUState(kept)
    slave.unit.reset()
    slave.begin(0.0)
    assert slave.get("held_Kd") == [KD]


@pytest.mark.slow
def test_the_command_writes_a_valid_unit(tmp_path: Path) -> None:
    validate_fmu = pytest.importorskip("fmpy.validation").validate_fmu
    out = tmp_path / "out"
    answer = ask("export", "sampled_pendulum", "--controller", "--fmu", "-o", str(out))
    assert answer.code == YES, answer.err
    assert [path.name for path in out.iterdir()] == ["sampled_pendulum_controller.fmu"]
    file = out / "sampled_pendulum_controller.fmu"
    assert validate_fmu(str(file)) == []
    before = file.read_bytes()
    shutil.rmtree(out)
    ask("export", "sampled_pendulum", "--controller", "--fmu", "-o", str(out))
    assert file.read_bytes() == before
    rows = fmpy.simulate_fmu(str(file), stop_time=0.1, output_interval=0.01)
    assert np.all(np.isfinite(rows["voltage"]))
