"""Cables that stretch and creep: closed forms of Kelvin-Voigt, what film and summary see of them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.base.frames import Array
from cosim.devices.cable_drive import CableDrive
from cosim.devices.orders import Order
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import Cable, base_tension, step_spring
from cosim.soft.solve.step_scheme import StepOptions
from cosim.soft.solve.time_step import Stepper
from tests.devices.device_parts import INFLATE, PULL, SHORTER, WINCH, TICK_s, scenario
from tests.soft.bodies import HANGING, held, hexagon_arm, hung

K_N_m, C_Ns_m, LENGTH_m = 2e3, 400.0, 0.3
STRAIGHT = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1], [0.0, 0.0, LENGTH_m]])
"""Eyelets of three plates."""


def drive(tick_s: float, loss_factor: float = 1.0) -> CableDrive:
    cable = Cable(np.arange(3), loss_factor, stiffness_N_m=K_N_m, damping_Ns_m=C_Ns_m)
    return CableDrive(cable, None, 0.0, tick_s)


def crept(tick_s: float) -> float:
    """Return by how much [m] a cable between held plates has crept 0.3 s after 10 N are commanded."""
    cable = drive(tick_s)
    for _ in range(round(0.3 / tick_s)):
        cable.move(None, 1.0, Order("tension", 10.0), STRAIGHT)
    return LENGTH_m - cable.off_drum_m(STRAIGHT)


def test_under_a_commanded_tension_the_drum_takes_up_the_creep() -> None:
    exact = 10.0 / K_N_m * (1.0 - math.exp(-0.3 * K_N_m / C_Ns_m))
    errors = [crept(tick_s) - exact for tick_s in (0.01, 0.005)]
    assert abs(errors[0]) < 0.02 * exact
    assert errors[1] == pytest.approx(0.5 * errors[0], rel=0.05)  # of first order in the tick
    statics = drive(math.inf)
    statics.move(None, 1.0, Order("tension", 10.0), STRAIGHT)
    assert LENGTH_m - statics.off_drum_m(STRAIGHT) == pytest.approx(10.0 / K_N_m, rel=1e-12)


@pytest.mark.parametrize("loss_factor", [1.0, 0.8])
def test_wound_at_a_speed_a_cable_between_plates_carries_its_stretch_and_its_rate(loss_factor: float) -> None:
    cable, speed, tick_s = drive(0.004, loss_factor), 0.01, 0.004
    begin = cable.off_drum_m(STRAIGHT)
    for k in range(1, 51):
        cable.move(None, 1.0, Order("length", begin - speed * k * tick_s), STRAIGHT)
        if k > 1:  # in the first one it gets taut
            wound = LENGTH_m - begin + speed * k * tick_s
            assert cable.tension_N(STRAIGHT) == pytest.approx(K_N_m * wound + C_Ns_m * speed, rel=1e-9)
    order = Order("length", begin - speed * 50 * tick_s)
    cable.move(None, 1.0, order, STRAIGHT)  # held: it carries its stretch alone
    assert cable.tension_N(STRAIGHT) == pytest.approx(K_N_m * (LENGTH_m - order.value), rel=1e-9)
    before = cable.tension_N(STRAIGHT)
    cable.begin(Order("tension", 1.0), STRAIGHT)
    assert cable.tension_N(STRAIGHT) == before  # a change of what is commanded pulls by nothing


def test_a_slack_cable_has_no_rate() -> None:
    cable = drive(0.004)
    cable.move(None, 1.0, Order("length", LENGTH_m + 0.01), STRAIGHT)
    cable.move(None, 1.0, Order("length", LENGTH_m + 0.001), STRAIGHT)  # wound at 2 m/s, still slack
    assert cable.tension_N(STRAIGHT) == 0.0


def test_the_film_feels_the_tension_of_a_creeping_cable() -> None:
    body = hexagon_arm(3)
    cables = (replace(each, stiffness_N_m=K_N_m, damping_Ns_m=C_Ns_m) for each in body.cables)
    specimen = held(body.with_other(Cable, *cables))
    state = hung(specimen, pressure_Pa=(30e3,)).state
    first, step_s = specimen.body.cables[0], 0.01
    stiffening, longer = step_spring(first, 1e-3, step_s)
    length = first.length(state.positions) - 2e-3 + longer
    wound = Loads(
        (30e3,), (0.0, 0.0), cable_length_m=(length, None), cable_stiffening=(stiffening, stiffening)
    )
    options = StepOptions()

    def end(loads: Loads) -> Array:
        return (
            Stepper(specimen.newton, specimen.clamp, options).step(state, HANGING, loads, step_s)[0].positions
        )

    one = end(wound)
    tension = base_tension(first, one, length, stiffening)
    stretch = first.length(one) - length + longer
    assert tension == pytest.approx(K_N_m * stretch + C_Ns_m * (stretch - 1e-3) / step_s, rel=1e-9)
    assert end(Loads((30e3,), (tension, 0.0))) == pytest.approx(one, abs=1e-7)


def test_a_run_winds_a_creeping_cable(tmp_path: Path) -> None:
    given, cable = scenario(tmp_path, INFLATE, PULL + SHORTER), "soft_robot.cable.corner_0"
    elastic = {f"{cable}.stiffness_N_m": 200.0}
    result = cosim.run(given, overrides={**elastic, f"{cable}.damping_Ns_m": 10.0}, error=False)
    rows = np.flatnonzero(result.phase == 1)
    stretch = np.maximum(result.cable_length_m[rows, 0] - result.cable_unstretched_m[rows, 0], 0.0)
    rate = np.diff(stretch) / TICK_s
    pull, taut = result.cable_tension_N[rows[1:], 0], stretch[1:] > 1e-4
    assert taut.sum() > 50
    assert pull[taut] == pytest.approx((200.0 * stretch[1:] + 10.0 * rate)[taut], abs=1e-6)
    # at rest it has crept to where an elastic one is
    still = cosim.run(given, overrides=elastic, error=False)
    ends = [run.summary["phases"][-1]["devices"]["bending_angle_rad"] for run in (result, still)]
    assert ends[0] == pytest.approx(ends[1], rel=0.01)
    # with a winch and no length commanded, the summary still says what is off the drum
    tight = PULL + "cable_tension_N = [0.3, 0.0]\n"
    phase = cosim.run(scenario(tmp_path, INFLATE, tight, WINCH), error=False).summary["phases"][-1]["devices"]
    assert phase["cable_unstretched_m"] == [None, None]
    assert phase["cable_length_m"][0] - phase["cable_off_drum_m"][0] == pytest.approx(0.3 / 1e4, abs=1e-9)
