"""A scene of several arms: one call steps MuJoCo for all, and each arm exchanges loads with its soft robot.
The loads of each soft robot are stored separately, because several may touch the same body.
"""

from typing import final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.rigid.build.compiled_scene import CompiledScene
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.scene import host_scene, scene
from cosim.rigid.scene.servos import finish_step


@final
class SharedScene(host_scene.HostScene):
    """A scene of several arms, for the exchange of loads with the soft robot of one arm.

    Args:
        model: of the scene.
        data: its state.
        arm: that carries the soft robot.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, arm: scene.RigidScene) -> None:
        super().__init__(model, data, (arm.mounting, None), arm.substeps)
        self._arm = arm
        self.joint_rows, self.mounted = arm.joint_rows, arm.mounted

    def contact_query(self, *, fixed_only: bool = False) -> ContactQuery:
        return self._arm.contact_query(fixed_only=fixed_only)

    def check(self) -> None:
        self._arm.check()

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self._arm.joint_names

    def begin_tick(self) -> None:
        super().begin_tick()
        self.mounted[:] = 0.0

    def add_mounted(self) -> None:
        """Add the part of the flange sensor's reading in a step that the soft robot does not explain."""
        if self._arm.carries:
            self._arm.add_mounted(self.acts, 1.0 / self._steps)

    def read_touch(self, touch: Array) -> None:
        self._arm.read_touch(touch)

    def press_with(self, others: IntArray) -> None:
        """Set the mask (bodies,) of bodies that the soft robots of other arms touch."""
        self._arm.others[:] = others

    def end_tick(self) -> None:
        self.accelerated()
        self.flange.moved()


@final
class SceneOfArms:
    """Steps several arms among objects.

    `arms` are the scenes of each arm, for planning and control; `exchanges` those for their soft robots.

    Args:
        descriptions: of the arms, each with a prefix; objects are those of the first.
        compiled: of these descriptions.
    """

    def __init__(self, descriptions: tuple[SceneDescription, ...], compiled: CompiledScene) -> None:
        self._model = model = compiled.model()
        self._data = data = mujoco.MjData(model)
        self.arms = tuple(scene.RigidScene(each, compiled, (model, data)) for each in descriptions)
        self.exchanges = tuple(SharedScene(model, data, arm) for arm in self.arms)
        for arm, exchange in zip(self.arms, self.exchanges, strict=True):
            arm.coupled = exchange
            arm.other_arms = tuple(each.prefix for each in descriptions if each is not arm.description)
        self._control = data.ctrl.reshape(-1, 3)
        self._servos = tuple(arm.servos for arm in self.arms)

    def step(self) -> None:
        """Take the rigid step of a tick, after all arms have begun the tick.

        Raises:
            InstabilityError: the state is not finite.
        """
        model, data, exchanges = self._model, self._data, self.exchanges
        data.xfrc_applied[:] = np.sum([each.load for each in exchanges], axis=0)
        data.qfrc_applied[:] = np.sum([each.torque for each in exchanges], axis=0)
        pressed = np.array([each.load.any(axis=1) for each in exchanges])
        for k, each in enumerate(exchanges):
            each.press_with(np.asarray(np.delete(pressed, k, axis=0).any(axis=0), np.int64))
        for step in range(self.arms[0].substeps):
            if step:
                self._control[:, 0] += float(model.opt.timestep) * self._control[:, 1]
            finish_step(model, data, self._servos)
            for each in exchanges:
                each.add_mounted()
            mujoco.mj_step1(model, data)
            self.arms[0].check()
            for each in exchanges:
                each.carry()
        for servos in self._servos:
            servos.end()
