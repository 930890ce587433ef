"""Sensors: what they declare is what they do, runs do not change, and controllers see what they read."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.base.frames import Array
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.sensors import SensorTable
from cosim.devices.sensor import Sensor
from cosim.errors import InputError, ScenarioError
from tests.devices import device_parts

TICK_s, SAMPLES = 0.002, 10_000
STILL = """
[[phase]]
name = "inflate"
duration_s = 0.1
pressure_Pa = 20e3
cable_tension_N = [0.3, 0.0]
"""


def read(table: SensorTable, truths: Array, seed: int = 0) -> Array:
    """Return what a sensor reads at ticks at whose ends the truth is (ticks, 3)."""
    sensor = Sensor(table, TICK_s, None)
    state = sensor.begin(truths[0], seed)
    found = [state.reading]
    for truth in truths[1:]:
        state = sensor.next(state, truth, seed)
        found.append(state.reading)
    return np.array(found)


def test_mean_variance_and_whiteness_of_10_000_samples_are_as_declared() -> None:
    sigma, bias = np.array([1e-3, 2e-3, 0.5e-3]), np.array([0.01, 0.0, -0.02])
    table = SensorTable("tip", "tip_position", noise=tuple(sigma), bias=tuple(bias), seed=3)
    truth = np.array([0.4, 0.1, 0.5])
    error = read(table, np.tile(truth, (SAMPLES, 1))) - truth
    # of n normal numbers the mean has sigma / sqrt(n), the variance sigma^2 sqrt(2 / n); 5 of these: 6e-7
    assert np.abs((error.mean(axis=0) - bias) / sigma).max() < 5.0 / np.sqrt(SAMPLES)
    assert np.abs(error.var(axis=0) / sigma**2 - 1.0).max() < 5.0 * np.sqrt(2.0 / SAMPLES)
    white = (error - bias) / sigma
    pairs = (white[1:] * white[:-1], white[:, [0, 1, 2]] * white[:, [1, 2, 0]])
    assert max(np.abs(pair.mean(axis=0)).max() for pair in pairs) < 5.0 / np.sqrt(SAMPLES)
    # another sensor, and another run, have other noise
    others = (read(replace(table, name="other"), truth[None], 0), read(table, truth[None], 1))
    assert all(np.all(other[0] - truth != error[0]) for other in others)


def test_delay_rate_and_steps_of_10_000_samples_are_as_declared() -> None:
    ticks = np.arange(SAMPLES)
    truths = np.outer(np.sin(0.01 * ticks) + 1e-3 * ticks, [1.0, -2.0, 0.5])
    table = SensorTable("tip", "tip_position", delay_s=0.05, rate_Hz=125.0, quantum=1e-3)
    found = read(table, truths)
    # 125 Hz are 4 ticks, 50 ms are 25: the sample of the last whole period, 25 ticks ago
    sampled = truths[np.maximum(ticks - 25, 0) // 4 * 4]
    assert found == pytest.approx(1e-3 * np.round(sampled / 1e-3), abs=1e-12)
    # of a noisy reading of a random truth, correlation finds the same delay
    random = np.random.default_rng(1).standard_normal((SAMPLES, 3))
    noisy = read(SensorTable("tip", "tip_position", delay_s=0.05, noise=0.5), random)
    shifts = [float((random[100 - k : SAMPLES - k] * noisy[100:]).mean()) for k in range(60)]
    assert int(np.argmax(shifts)) == 25
    assert max(shifts) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / SAMPLES))
    # a rate that is no whole number of ticks holds in the mean
    uneven = read(SensorTable("tip", "tip_position", rate_Hz=30.0), truths)
    assert np.count_nonzero(np.diff(uneven[:, 0])) == int((SAMPLES - 1) * TICK_s * 30.0 + 1e-6)


SENSORS: dict[str, dict[str, Any]] = {
    "gauge": {"kind": "pressure"},
    "winder": {"kind": "cable_length", "of": ["corner_1"]},
    "pull": {"kind": "cable_tension"},
    "force": {"kind": "flange_force"},
    "torque": {"kind": "flange_torque"},
    "tip": {"kind": "tip_position"},
    "normal": {"kind": "tip_direction"},
    "bend": {"kind": "bending_angle"},
}


def with_sensors(tmp_path: Path, *parts: str, **changes: Any) -> Scenario:
    sensors = [{"name": name, **table, **changes} for name, table in SENSORS.items()]
    return device_parts.scenario(tmp_path, *(parts or (STILL,)), overrides={"sensor": sensors})


def test_sensors_without_faults_read_the_truth_and_change_nothing(tmp_path: Path) -> None:
    plain = cosim.run(device_parts.scenario(tmp_path, STILL))
    result = cosim.run(with_sensors(tmp_path))
    assert plain.stage.sensors == ()
    assert plain.sensor_reading.shape == (len(plain.tick), 0)
    for name in ("tip_position", "chamber_pressure_Pa", "flange_force", "node_position"):
        assert np.array_equal(getattr(plain, name), getattr(result, name)), name
    columns = {
        "gauge": result.chamber_pressure_Pa, "pull": result.cable_tension_N, "force": result.flange_force,
        "torque": result.flange_torque, "tip": result.tip_position, "normal": result.tip_direction,
        "bend": result.bending_angle_rad[:, None],
    }  # fmt: skip
    for name, column in columns.items():
        reading, truth = result.sensor(name)
        assert np.array_equal(reading, truth), name
        assert truth == pytest.approx(column, rel=1e-12, abs=1e-15), name
    assert result.sensor("winder")[1][0, 0] > 0.0
    with pytest.raises(InputError, match="there is no sensor 'tap'; there are gauge, "):
        result.sensor("tap")


def test_the_joints_of_an_arm_are_read_after_every_tick() -> None:
    sensors = [
        {"name": "encoders", "kind": "joint_position", "delay_s": 0.004},
        {"name": "motors", "kind": "joint_torque"},
        {"name": "late", "kind": "joint_torque", "delay_s": 0.004},
    ]
    changes = {
        "phase": [],
        "fidelity": "rigid",
        "clock.tick_s": 0.002,
        "contact.enabled": False,
        "sensor": sensors,
    }
    here = cosim.Simulation("ur5e_hexagon_arm", overrides=changes)
    held = here.measure().joint_torque
    assert np.abs(held).max() > 10.0  # N m, of the arm's weight
    twist, rows = (0.1, 0.0, 0.0, 0.0, 0.0, 0.0), []
    for k in range(6):
        shown = here.step(cosim.Command(flange_twist=twist))
        measured = here.measure()
        rows.append(measured.joint_position)
        assert np.array_equal(measured.sensors["motors"], shown.joint_torque)
        assert np.array_equal(shown.sensor_truth[:12], [*shown.joint_position, *shown.joint_torque])
        if k < 2:  # before a sample is due, the first one is seen
            assert np.array_equal(measured.sensors["late"], held)
    assert np.array_equal(measured.sensors["encoders"], rows[-3])
    assert np.array_equal(here.measure(["encoders"]).joint_position, rows[-3])
    with pytest.raises(
        ScenarioError, match=r"sensor\.motors\.bias: has 2 entries; the sensor reads 6 values"
    ):
        cosim.Simulation("ur5e_hexagon_arm", overrides={**changes, "sensor.motors.bias": [0.1, 0.2]})


@dataclass(frozen=True)
class Listener(cosim.Controller[None]):
    heard: list[cosim.Measurement] = field(default_factory=list)

    def start(self, seen: cosim.Measurement) -> None:
        return None

    def act(self, state: None, seen: cosim.Measurement) -> tuple[None, cosim.Command]:
        self.heard.append(seen)
        return None, cosim.Command()


def test_a_controller_sees_the_sensors_that_it_names(tmp_path: Path) -> None:
    python = device_parts.PYTHON.replace("0.1", str(device_parts.TICK_s)) + 'sensors = ["tip", "gauge"]\n'
    mine, phase = Listener(), STILL.replace("cable_tension_N", 'control = ["mine"]\ncable_tension_N')
    given = with_sensors(tmp_path, python, phase, noise=1e-3, delay_s=0.012)
    result = cosim.run(given, controllers={"mine": mine})
    rows = range(len(mine.heard))
    tip, gauge, bend = (result.sensor(name)[0][: len(rows)] for name in ("tip", "gauge", "bend"))
    assert np.array_equal([each.tip_position for each in mine.heard], tip)
    assert np.array_equal([each.pressure_Pa for each in mine.heard], gauge)
    # what it does not name it sees as it is, and the reading by its name
    bent = [each.bending_angle_rad for each in mine.heard]
    assert bent == pytest.approx(result.bending_angle_rad[rows], abs=1e-12)
    assert np.array_equal([each.sensors["bend"] for each in mine.heard], bend)
    assert np.abs(tip - result.tip_position[rows]).max() > 1e-3


def test_a_feedback_loop_holds_what_its_sensor_reads(tmp_path: Path) -> None:
    pull = device_parts.PULL + "control_bending_angle_rad = { bend = 0.05 }\n"
    loop = device_parts.CONTROLLER.replace('name = "bend"', 'name = "bend"\nsensors = ["angle"]')
    sensor = '[[sensor]]\nname = "angle"\nkind = "bending_angle"\nbias = 0.02\n'
    parts = (loop, sensor, device_parts.INFLATE, pull)
    changes = {"phase.pull.settle_s": 1.2, "controller.bend.integral_gain_per_s": 8.0}
    result = cosim.run(device_parts.scenario(tmp_path, *parts, overrides=changes))
    assert result.sensor("angle")[0][-1, 0] == pytest.approx(0.05, abs=2e-4)
    assert result.bending_angle_rad[-1] == pytest.approx(0.03, abs=2e-4)


def test_a_saved_run_reads_on_as_it_would(tmp_path: Path) -> None:
    given = with_sensors(tmp_path, noise=1e-3, delay_s=0.02, rate_Hz=60.0)
    here = cosim.Simulation(given)
    here.step(7)
    here.save().write(tmp_path / "seven.npz")
    first = [here.step().sensor_reading for _ in range(12)]
    other = cosim.Simulation(given, start=tmp_path / "seven.npz")
    assert np.array_equal(first, [other.step().sensor_reading for _ in range(12)])
    assert len(np.unique(np.array(first)[:, 0])) > 3
    # without the delay the samples on their way do not fit
    with pytest.raises(InputError, match=r"the saved state has sensors with \(ticks of delay, values\)"):
        other.branch({"sensor.tip.delay_s": 0.0})
    # other seeds read other noise, the same one the same
    begun = []
    for seed in (0, 5, 5):
        here.reset()
        begun.append(here.seed_sensors(seed).sensor_reading)
    assert np.array_equal(begun[1], begun[2])
    assert np.all(begun[0] != begun[1])
    assert np.array_equal(begun[0], cosim.Simulation(given).snapshot.sensor_reading)


def test_readings_are_in_the_files_of_a_run_and_in_its_plots(tmp_path: Path) -> None:
    result = cosim.run(with_sensors(tmp_path, noise=1e-3), out=tmp_path / "run")
    again = cosim.load_run(tmp_path / "run")
    assert again.stage.sensors == result.stage.sensors
    assert np.array_equal(again.sensor("tip")[0], result.sensor("tip")[0])
    axes = result.plot("tip").axes[0]
    assert axes.get_ylabel() == "tip [mm]"
    assert [line.get_label() for line in axes.lines] == [
        f"{of} {axis}" for of in ("sensor", "truth") for axis in "xyz"
    ]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"of": ["left"]}, r"sensor\.it\.of: is for chambers and cables; kind 'tip_position' has none"),
        ({"kind": "cable_length", "of": ["corner_7"]}, r"sensor\.it\.of: no cable 'corner_7'"),
        ({"kind": "joint_torque"}, r"sensor\.it\.kind: 'joint_torque' needs an arm"),
        ({"noise": [0.1, 0.2]}, r"sensor\.it\.noise: has 2 entries; the sensor reads 3 values \(x, y, z\)"),
        ({"rate_Hz": 500.0}, r"sensor\.it\.rate_Hz: 500 is more than one sample a tick; at most 250"),
    ],
)
def test_a_wrong_sensor_is_refused_by_its_key(tmp_path: Path, change: Any, message: str) -> None:
    table = {"name": "it", "kind": "tip_position", **change}
    with pytest.raises(ScenarioError, match=message):
        device_parts.scenario(tmp_path, STILL, overrides={"sensor": [table]})


def test_controllers_name_sensors_that_read_what_they_need(tmp_path: Path) -> None:
    pull = device_parts.PULL + "control_bending_angle_rad = { bend = 0.05 }\n"
    given = device_parts.scenario(tmp_path, device_parts.CONTROLLER, device_parts.INFLATE, pull)
    sensors = [{"name": "tip", "kind": "tip_position"}]
    with pytest.raises(ScenarioError, match=r"controller\.bend\.sensors: no sensor 'tap'"):
        load_scenario(given, {"sensor": sensors, "controller.bend.sensors": ["tap"]})
    with pytest.raises(ScenarioError, match="is read by a sensor of kind 'bending_angle'; name one"):
        load_scenario(given, {"sensor": sensors, "controller.bend.sensors": ["tip"]})
    with pytest.raises(ScenarioError, match=r"sensor\.tip: acts in time: needs mode = 'dynamic'"):
        load_scenario(given, {"sensor": sensors, "controller": [], "phase": [], "mode": "quasistatic"})
