"""Attached soft robots share a process: with others, with threads, with Ctrl-C, with what a loop changes."""

from __future__ import annotations

import gc
import random
import signal
import sys
import threading
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

import cosim
from cosim.errors import InputError
from cosim.soft.solve import tick_work

LIGHT_MOUNT = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="mount" pos="0 0 0.5">
      <joint name="aside" type="slide" axis="1 0 0"/>
      <geom type="box" size="0.1 0.1 0.05" mass="0.3" contype="0" conaffinity="0"/>
      <site name="tool" pos="0 0 -0.05" euler="180 0 0"/>
    </body>
  </worldbody>
  <actuator><position joint="aside" kp="400" kv="20"/></actuator>
</mujoco>
"""
BALL = "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
RIGID: dict[str, Any] = {"fidelity": "rigid", "contact.enabled": False}
FILM: dict[str, Any] = {"solver.damping_per_s": 5.0, "start.pressure_Pa": 3e3, "contact.enabled": False}


class Environment:
    """A light mount that carries inertia of its soft robot, and moves aside."""

    def __init__(self, overrides: dict[str, Any] = RIGID) -> None:
        spec = mujoco.MjSpec.from_string(LIGHT_MOUNT)
        self.soft = cosim.attach(spec, "tool", "square_core", overrides=overrides)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.data.ctrl[0] = 0.02

    def before(self) -> None:
        self.soft.before(self.model, self.data)

    def mj_step(self) -> None:
        mujoco.mj_step(self.model, self.data)

    def after(self) -> None:
        self.soft.after(self.model, self.data)

    def take(self, count: int) -> Environment:
        for _ in range(count):
            self.soft.step(self.model, self.data)
        return self

    @property
    def place(self) -> tuple[Any, ...]:
        """What the steps have led to, as it is."""
        return (*self.data.qpos.tolist(), *self.data.qvel.tolist(), *self.soft.tip_position.tolist())


def check_plain_mujoco() -> None:
    """Check that a model without soft robot compiles, and that a free ball falls."""
    model = mujoco.MjModel.from_xml_string(BALL)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 10)
    assert data.qvel[2] == pytest.approx(-9.81 * data.time)


def test_a_hundred_environments_in_one_process_go_as_one_alone() -> None:
    """Whichever order their loops have; each mount carries inertia, by one callback that then leaves."""
    alone = Environment().take(4)
    assert alone.soft.ledger.algorithmic_mass
    environments = [Environment() for _ in range(100)]
    orders: list[Callable[[Environment], None]] = [Environment.before, Environment.mj_step, Environment.after]
    for tick in range(4):
        if tick % 2:
            for environment in environments:
                environment.take(1)
        else:
            for part in orders:
                for environment in environments:
                    part(environment)
            environments.reverse()
    assert {environment.place for environment in environments} == {alone.place}
    assert mujoco.get_mjcb_control() is None


@pytest.mark.parametrize("overrides", [RIGID, FILM], ids=["rigid", "film"])
def test_threads_with_an_environment_each_go_as_one_alone(overrides: dict[str, Any]) -> None:
    count = 60 if overrides is RIGID else 20
    alone = Environment(overrides).take(count).place
    environments = [Environment(overrides) for _ in range(4)]
    failed: list[BaseException] = []

    def go(environment: Environment) -> None:
        try:
            environment.take(count)
        except BaseException as error:
            failed.append(error)

    threads = [threading.Thread(target=go, args=(environment,)) for environment in environments]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failed == []
    assert [environment.place for environment in environments] == [alone] * 4


def interrupted(seconds: float, act: Callable[[], None]) -> bool:
    """Do something, with Ctrl-C after some time; return whether that came before it had ended."""

    def interrupt(*_given: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        try:
            signal.setitimer(signal.ITIMER_REAL, seconds)
            act()
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
    except KeyboardInterrupt:
        return True
    finally:
        signal.signal(signal.SIGALRM, before)
    return False


def test_ctrl_c_at_any_moment_leaves_a_run_as_it_was_or_one_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of 200 is followed by the other ticks: equal to those alone, unless an InputError says so."""
    monkeypatch.setattr(sys, "unraisablehook", lambda *_given: None)  # where it meets a deletion
    environment, ticks = Environment(FILM), 6
    soft, model, data = environment.soft, environment.model, environment.data
    environment.take(2)
    start, places, moments = soft.save(), [environment.place], random.Random(1)
    for _ in range(ticks):
        places.append(environment.take(1).place)
    first, interrupts, refused = soft.save().tick - ticks, 0, 0

    def go_on() -> None:
        while soft.tick < first + ticks:
            if soft.tick % 2:
                soft.step(model, data)
            else:
                environment.before()
                environment.mj_step()
                environment.after()
            assert environment.place == places[soft.tick - first]
            _ = soft.ledger  # ends the row of ticks

    for _ in range(2000):
        soft.restore(start)
        if not interrupted(moments.uniform(1e-4, 0.02), go_on):
            continue
        interrupts += 1
        try:
            go_on()
        except InputError as error:
            assert "reset(model, data) or restore(saved)" in str(error)  # noqa: PT017  # most raise nothing
            refused += 1
        check_plain_mujoco()
        if interrupts == 200:
            break
    assert interrupts == 200
    assert refused > 0
    soft.restore(start)
    assert environment.take(ticks).place == places[-1]
    assert not data.xfrc_applied.any()


def test_an_error_between_before_and_after_is_the_loops_alone() -> None:
    """The next environment, plain models, and the data itself once the soft robot is gone go on as ever."""
    environment, other = Environment().take(2), Environment()
    environment.before()
    with pytest.raises(InputError, match="called twice"):
        environment.before()
    check_plain_mujoco()
    assert other.take(3).place == Environment().take(3).place
    environment.soft.reset(environment.model, environment.data)
    assert not environment.data.xfrc_applied.any()
    environment.before()
    assert environment.data.xfrc_applied.any()
    data = environment.data
    del environment
    gc.collect()
    assert not data.xfrc_applied.any()
    check_plain_mujoco()


def disable_gravity(environment: Environment) -> None:
    environment.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_GRAVITY


def disable_actuation(environment: Environment) -> None:
    environment.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION


def set_option(name: str, value: Any) -> Callable[[Environment], None]:
    return lambda environment: setattr(environment.model.opt, name, value)


CHANGES: dict[str, tuple[Callable[[Environment], None], str]] = {
    "gravity": (
        set_option("gravity", [0.0, 0.0, 0.0]),
        r"model\.opt\.gravity is \(0\.0, 0\.0, 0\.0\), and was",
    ),
    "no gravity": (disable_gravity, r"model\.opt\.gravity is"),
    "timestep": (set_option("timestep", 0.004), r"model\.opt\.timestep is 0\.004, and was 0\.002"),
    "integrator": (set_option("integrator", mujoco.mjtIntegrator.mjINT_RK4), "RK4"),
    "no actuation": (disable_actuation, "do not disable actuation"),
    "reset": (lambda each: mujoco.mj_resetData(each.model, each.data), r"after mj_resetData .*reset\(model"),
    "step": (Environment.mj_step, "each mj_step needs"),
    "callback": (lambda _each: None, "MuJoCo did not call"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_a_loop_changes_between_ticks_is_refused_by_name(name: str) -> None:
    environment, (change, words) = Environment().take(3), CHANGES[name]
    change(environment)

    def step() -> None:
        environment.before()
        if name == "callback":
            mujoco.set_mjcb_control(None)
        environment.mj_step()
        environment.after()

    with pytest.raises(InputError, match=words):
        step()
    if name in ("reset", "step", "callback"):
        mujoco.mj_resetData(environment.model, environment.data)
        environment.data.ctrl[0] = 0.02
        environment.soft.reset(environment.model, environment.data)
        assert environment.take(3).place == Environment().take(3).place
    check_plain_mujoco()


def test_another_integrator_without_stages_may_be_chosen_later() -> None:
    changed = Environment()
    changed.soft.reset(changed.model, changed.data)
    changed.model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec = mujoco.MjSpec.from_string(LIGHT_MOUNT.replace("implicitfast", "Euler"))
    soft = cosim.attach(spec, "tool", "square_core", overrides=RIGID)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[0] = 0.02
    soft.step(model, data, 5)
    assert changed.take(5).data.qpos.tolist() == data.qpos.tolist()


def test_a_callback_of_the_loop_is_called_and_its_errors_are_its_own() -> None:
    """It is called for all data, after the mass matrix is ready, and is there as before afterwards."""
    alone, environment, seen = Environment().take(4).place, Environment(), []

    def control(_model: Any, data: Any) -> None:
        seen.append(float(data.time))
        if data.time > 0.0075:
            raise ValueError("of the loop")

    mujoco.set_mjcb_control(control)
    try:
        assert environment.take(4).place == alone
        assert mujoco.get_mjcb_control() is control
        count = len(seen)
        assert count >= 4
        with pytest.raises(ValueError, match="of the loop"):
            environment.take(1)
        assert mujoco.get_mjcb_control() is control
    finally:
        mujoco.set_mjcb_control(None)
    with pytest.raises(InputError, match="broken off"):
        environment.take(1)
    check_plain_mujoco()


LED = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body name="hand" mocap="true" pos="0 0 1"><site name="tool" euler="180 0 0"/></body>
  </worldbody>
</mujoco>
"""


def test_a_motion_too_fast_for_a_tick_ends_by_name_and_keeps_the_state_before_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A hand that jumps by 100 mm in 2 ms tears at the film: some 400 to 1000 new tangents unless bounded."""
    monkeypatch.setattr(tick_work, "TICK_ITERATIONS_MAX", 100)
    spec = mujoco.MjSpec.from_string(LED)
    pieces = {"start.pressure_Pa": 3e3, "contact.enabled": False}
    soft = cosim.attach(spec, "tool", "square_core", overrides=pieces)
    model = spec.compile()
    data = mujoco.MjData(model)
    soft.step(model, data, 5)
    saved, film, place = soft.save(), soft.film, data.mocap_pos.copy()
    data.mocap_pos[0, 2] -= 0.1
    with pytest.raises(cosim.TickWorkError, match=r"bound of a tick, 100 .*Spread the command") as caught:
        soft.step(model, data)
    assert 100 < caught.value.iterations < 200
    np.testing.assert_array_equal(soft.film, film)
    with pytest.raises(InputError, match=r"restore\(saved\)"):
        soft.step(model, data)
    soft.restore(saved)
    assert np.array_equal(data.mocap_pos, place)
    soft.step(model, data, 5)
    np.testing.assert_allclose(soft.film, film, rtol=0.0, atol=1e-4)  # it hangs still
