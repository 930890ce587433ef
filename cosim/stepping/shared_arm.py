"""One of several arms in a scene as the carrier of its flange: the scene is stepped for all of them at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

from cosim.base.frames import Array
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.coupling.ticks import Servos
from cosim.coupling.ticks_taken import TicksTaken
from cosim.errors import InputError
from cosim.kinematics.arm import inertial_parameters
from cosim.rigid.scene.arms import SharedScene
from cosim.soft.body.loads import Loads
from cosim.stepping.arm_carrier import ArmCarrier


@final
class SharedArm(ArmCarrier):
    """An arm among others: `begin`, the step of the scene, `advance`; see `ArmCarrier`."""

    @property
    def _shared(self) -> SharedScene:
        assert isinstance(self._coupled, SharedScene), "several arms are in the scene"
        return self._coupled

    def set_configuration(self, joints: Array) -> None:
        super().set_configuration(joints)
        self._shared.flange.moved()

    def begin(self, servos: Servos) -> None:
        assert isinstance(self._coupling, StaggeredCoupling), "couple() comes before"
        self._coupling.begin(opening=False)
        self._shared.begin_tick()
        payload, feedforward = self._payload(), servos.torque[0]
        if payload is not None:
            known = inertial_parameters(payload.mass_kg, payload.center_of_mass, payload.inertia)
            feedforward = feedforward + servos.by_payload[0] @ known
        self._scene.set_control(servos.position[0], servos.velocity[0], feedforward)

    def advance(self, servos: Servos, loads: Sequence[Loads]) -> TicksTaken:
        self._shared.end_tick()
        with self._shared.lent():
            return super().advance(servos, loads)

    def save_state(self) -> Any:
        raise InputError("a run of several arms cannot be saved; run each arm alone, or start again")
