"""Controllers: PI on a first-order plant against the closed form, windup, bang-bang, hold, refusals."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.linalg import expm

from cosim import Command, Controller, Measurement
from cosim.base.frames import Array, Pose, Wrench
from cosim.devices.feedback import BangBang, FeedbackLoop, ProportionalIntegral
from cosim.devices.zero_order_hold import ZeroOrderHold
from cosim.errors import InputError, InstabilityError

GAIN, TAU_s, PERIOD_s = 2.0, 0.5, 0.02
PI = ProportionalIntegral(1.5, 6.0, PERIOD_s, -math.inf, math.inf)


def seen(**changes: object) -> Measurement:
    at_rest = Measurement(
        time_s=0.0, flange=Pose(), flange_twist=np.zeros(6), flange_wrench=Wrench(),
        flange_jacobian=np.zeros((6, 0)), joint_position=np.zeros(0), joint_velocity=np.zeros(0),
        joint_torque=np.zeros(0), contact_force_N={}, body_pose={}, setpoint=0.5, tip_position=np.zeros(3),
        tip_direction=np.array([0.0, 0.0, 1.0]), tip_twist=np.zeros(6), bending_angle_rad=0.2,
        pressure_Pa=(0.0,), volume_m3=(1e-4,), gas_kg=(None,), cable_tension_N={"a": 3.0, "b": 0.0},
        cable_length_m={"a": 0.21, "b": 0.31}, cable_unstretched_m={"a": 0.2, "b": 0.3},
    )  # fmt: skip
    return replace(at_rest, **changes)  # type: ignore[arg-type]


def closed_loop(law: ProportionalIntegral, setpoint: float, samples: int) -> tuple[Array, Array]:
    """Return samples of a plant tau dy/dt = K u - y under the law, and its outputs."""
    decay, state, y = math.exp(-PERIOD_s / TAU_s), law.begin(0.0), 0.0
    values, outputs = np.zeros(samples), np.zeros(samples)
    for k in range(samples):
        state = law.next(state, setpoint - y)
        values[k], outputs[k] = y, state.output
        y = decay * y + (1.0 - decay) * GAIN * state.output
    return values, outputs


def test_pi_on_a_first_order_plant_follows_the_sampled_closed_form() -> None:
    # z = (y, I): y+ = d y + (1 - d) K (k_p e + I + k_i h e), I+ = I + k_i h e, e = r - y
    found, _ = closed_loop(PI, 1.0, 200)
    decay = math.exp(-PERIOD_s / TAU_s)
    step, total = PI.integral_gain_per_s * PERIOD_s, PI.proportional_gain + PI.integral_gain_per_s * PERIOD_s
    plant = (1.0 - decay) * GAIN
    matrix = np.array([[decay - plant * total, plant], [-step, 1.0]])
    source = np.array([plant * total, step])
    # z_k = (1 - A^k) z_inf
    final = np.linalg.solve(np.eye(2) - matrix, source)
    expected = [(final - np.linalg.matrix_power(matrix, k) @ final)[0] for k in range(200)]
    assert found == pytest.approx(np.array(expected), abs=1e-12)
    assert found[-1] == pytest.approx(1.0, abs=1e-6)


def test_fast_sampling_approaches_the_continuous_loop() -> None:
    # tau y'' + (1 + K k_p) y' + K k_i y = K k_i r + K k_p r': overshoot of the continuous loop, by its matrix
    a = np.array([[-(1.0 + GAIN * 1.5) / TAU_s, GAIN / TAU_s], [-6.0, 0.0]])
    b = np.array([GAIN * 1.5 / TAU_s, 6.0])
    final = -np.linalg.solve(a, b)
    times = PERIOD_s * np.arange(200)
    exact = np.array([(final - expm(a * t) @ final)[0] for t in times])
    found, _ = closed_loop(PI, 1.0, 200)
    # a hold delays by half a period on average: 10 ms of a slope that starts at K k_p / tau = 6
    assert np.abs(found - exact).max() < 1.1 * 0.5 * PERIOD_s * 6.0


def test_a_saturated_integral_does_not_wind_up() -> None:
    limited = replace(PI, output_max=0.52, output_min=0.0)
    found, output = closed_loop(limited, 1.0, 400)
    assert output.max() == 0.52
    # with y at most K u_max = 1.04 and a sane integral there is hardly an overshoot
    assert found.max() < 1.005
    assert found[-1] == pytest.approx(1.0, abs=1e-4)
    # while out of reach, and after a long time there, it comes back at once
    state = limited.begin(0.0)
    for _ in range(1000):
        state = limited.next(state, 1.0)
    assert state.output == 0.52
    assert limited.next(state, -0.4).output < 0.52


def test_pi_takes_over_without_a_jump() -> None:
    law = replace(PI, output_max=5.0)
    assert law.next(law.begin(3.0), 0.0).output == 3.0
    assert law.next(law.begin(7.0), 0.0).output == 5.0


def test_bang_bang_goes_by_its_increment_within_its_limits() -> None:
    law = BangBang(0.1, band=0.02, output_max=0.25)
    state, outputs = law.begin(0.0), []
    # the band is 0.01 to either side
    for error in (0.5, 0.5, 0.5, 0.5, 0.009, -0.009, -0.011, -0.5, -0.5, -0.5):
        state = law.next(state, error)
        outputs.append(state.output)
    assert outputs == pytest.approx([0.1, 0.2, 0.25, 0.25, 0.25, 0.25, 0.15, 0.05, 0.0, 0.0])


def test_a_loop_commands_tension_or_length_of_its_cables() -> None:
    law = BangBang(0.1)
    tension = FeedbackLoop("bending_angle_rad", law, "cable_tension_N", ("a",))
    state, command = tension.act(tension.start(seen()), seen())
    assert dict(command.cable_tension_N) == {"a": pytest.approx(3.1)}  # from where it was
    length = FeedbackLoop("tip_height_m", law, "cable_shortening_m", ("a", "b"))
    state2, command = length.act(length.start(seen()), seen(cable_unstretched_m={"a": 9.0, "b": 9.0}))
    # z = 0 is below 0.5: shorter, counted from the lengths at the start
    assert dict(command.cable_length_m) == {"a": pytest.approx(0.1), "b": pytest.approx(0.2)}
    assert (state.unstretched_m, state2.unstretched_m) == ((), (0.2, 0.3))
    with pytest.raises(InputError, match="needs a setpoint"):
        tension.act(state, seen(setpoint=None))


@dataclass(frozen=True)
class Counting(Controller[int]):
    """Counts how often it is asked, and commands the count, or whatever it is given."""

    commands: Command | None = None

    def start(self, seen: Measurement) -> int:
        return 0

    def act(self, state: int, seen: Measurement) -> tuple[int, Command]:
        return state + 1, self.commands or Command(cable_tension_N={"b": state + 1.0})


def test_a_command_is_held_between_samples_and_resumes_from_a_saved_state() -> None:
    hold = ZeroOrderHold("c", Counting(), 3, ("a", "b"))
    hold.start(seen())
    values = [hold.tick(seen).tension_N for _ in range(7)]
    assert values == [(None, 1.0)] * 3 + [(None, 2.0)] * 3 + [(None, 3.0)]
    again = ZeroOrderHold("c", Counting(), 3, ("a", "b"))
    again.state = hold.state
    expected = [hold.tick(seen) for _ in range(5)]
    assert [again.tick(seen) for _ in range(5)] == expected
    assert expected[-1].tension_N == (None, 4.0)


@pytest.mark.parametrize(
    ("command", "error", "text"),
    [
        (Command(cable_tension_N={"c": 1.0}), InputError, "of 'c'; there are: a, b"),
        (Command(cable_tension_N={"a": -1.0}), InputError, "at least 0"),
        (Command(cable_length_m={"a": float("nan")}), InstabilityError, "is nan"),
        (Command({"a": 1.0}, {"a": 0.1}), InputError, "both tension and length of cable 'a'"),
        (Command(pump_pressure_Pa={"main": 1e3}), InputError, "there are: none"),
    ],
)
def test_impossible_commands_are_named(command: Command, error: type[Exception], text: str) -> None:
    hold = ZeroOrderHold("c", Counting(command), 1, ("a", "b"))
    hold.start(seen())
    with pytest.raises(error, match=text):
        hold.tick(seen)
