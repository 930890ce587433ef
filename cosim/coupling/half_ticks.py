"""The two halves of a tick in kernels: the rigid half, and what is handed over after the soft one.

The rigid half is that of a scene which steps itself, or it is read where somebody else has stepped the scene.

Per tick, servos and the wrench of the tick before act while MuJoCo steps; the soft side then takes one step
with the flange's new pose, and its wrench is handed over for the next tick. The soft side is known by its
figures alone: the wrench on the flange, centre and inertia of its mass.
"""

from typing import Any, NamedTuple

import numpy as np

from cosim.base.kernel_types import Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_matrix, small_vector
from cosim.base.numba_insides import call_native
from cosim.coupling.contact.contact_arrays import BodyLoads, fill_speed, led
from cosim.coupling.ticks import CarriedInertia, Servos, Ticks
from cosim.reduced.sections.assembly import CENTER, INERTIA, WRENCH
from cosim.rigid.scene.bodies import BEGIN, FACTORISE, NativeScene
from cosim.rigid.scene.servos import finish_step

LEVER_M = 0.1  # torques count as forces at this lever
SMALLEST_N = 1e-2  # loads below it count as this large: what is left of them is rounding
ALL_DONE, SOFT_HALF_LEFT, RIGID_SIDE_WARNS, SOFT_STEP_BEGUN, SOFT_STEP_SOLVED, LISTS_LEFT = range(6)
"""How ticks in a row ended; with all but the first and the third, the rigid half of one more is done.

A soft step that was begun, or solved for bodies that do not go where it has met them, is continued: nothing
is solved twice, and what the attempt has changed is as if Python had made it.
"""


class RigidSide(NamedTuple):
    """What moves under the last wrench.

    Args:
        scene: see `NativeScene`.
        carried: on the joints.
        bodies: that the film touches.
        mounted: (10,), parameters of a rigid mass on the flange, flange frame.
        mass_kg: of the soft side.
    """

    scene: NativeScene
    carried: CarriedInertia
    bodies: BodyLoads
    mounted: Vector
    mass_kg: float


@device_function
def _fill_payload(
    figures: Vector, mass: float, origin: Vector, axes: Matrix, mounted: Vector, out: Vector
) -> None:
    """Fill out (10,) with the `inertial_parameters` of the chain's mass and of what is mounted."""
    center, turned, inertia = small_vector(3), small_matrix(3, 3), small_matrix(3, 3)
    square = 0.0
    for r in range(3):
        center[r] = 0.0
        for i in range(3):
            center[r] += axes[i, r] * (figures[CENTER + i] - origin[i])
        square += center[r] * center[r]
        for c in range(3):
            turned[r, c] = 0.0
            for i in range(3):
                turned[r, c] += figures[INERTIA + 3 * r + i] * axes[i, c]
    for r in range(3):
        for c in range(3):
            total = -mass * center[r] * center[c] + (mass * square if r == c else 0.0)
            for i in range(3):
                total += axes[i, r] * turned[i, c]
            inertia[r, c] = total
    out[0] = mass
    for r in range(3):
        out[1 + r] = mass * center[r]
    out[4], out[5], out[6] = inertia[0, 0], inertia[0, 1], inertia[1, 1]
    out[7], out[8], out[9] = inertia[0, 2], inertia[1, 2], inertia[2, 2]
    for k in range(10):
        out[k] += mounted[k]


@device_function
def _give_back(scene: NativeScene, carried: CarriedInertia) -> None:
    """Give back what the carried inertia takes as long as the soft side answers as before."""
    joints, depth = carried.inertia.shape[0], carried.past.shape[0]
    for j in range(joints):
        for k in range(depth - 1, 0, -1):
            carried.past[k, j] = carried.past[k - 1, j]
        carried.past[0, j] = scene.acceleration[j]
    for i in range(joints):
        scene.torque[i] = 0.0
        for j in range(joints):
            for k in range(depth):
                scene.torque[i] += carried.inertia[i, j] * carried.weights[k] * carried.past[k, j]


@device_function
def load_scene(scene: NativeScene, carried: CarriedInertia, ticks: Any, k: int) -> None:
    """Let the wrench of row k act on the flange, and give back what is carried."""
    for r in range(6):
        scene.applied[r] = ticks.figures[k, WRENCH + r]
    _give_back(scene, carried)


@device_function
def _carry(scene: NativeScene, inertia: Matrix) -> None:
    """Add what the joints carry to a mass matrix that MuJoCo has computed for new positions."""
    joints = inertia.shape[0]
    for i in range(joints):
        for j in range(i + 1):
            scene.mass[scene.mass_places[i, j]] += inertia[i, j]
    if joints > 0:
        call_native(scene.steps[FACTORISE], scene.sides[0], scene.sides[1])


@device_function
def _momentum_error(scene: NativeScene, bodies: BodyLoads, handed: Vector) -> float:
    """Return how far what acts on flange or touched bodies is from what was handed over, see `interface`."""
    flange, touched, acts, center, given = 0.0, 0.0, scene.applied, scene.center, bodies.handed
    for r in range(3):
        i, m = (r + 1) % 3, (r + 2) % 3
        torque = acts[3 + r] + center[i] * acts[m] - center[m] * acts[i]
        flange = max(flange, abs(handed[r] - acts[r]), abs(handed[3 + r] - torque) / LEVER_M)
        force, torque = 0.0, 0.0
        for b in range(bodies.loaded.shape[0]):
            if bodies.loaded[b]:
                load, place = bodies.applied[b], bodies.centers[b]
                force += load[r]
                torque += load[3 + r] + (place[i] * load[m] - place[m] * load[i])
        touched = max(touched, abs(given[r] - force), abs(given[3 + r] - torque) / LEVER_M)
    return max(flange / max(handed[6], SMALLEST_N), touched / max(given[6], SMALLEST_N))


@device_function
def power_on_bodies(bodies: BodyLoads) -> float:
    """Return the power [W] of the contacts' loads on bodies."""
    power, now = 0.0, small_vector(6)
    for b in range(bodies.loaded.shape[0]):
        if bodies.loaded[b]:
            fill_speed(bodies.leads, b, now)
            for r in range(3):
                speed = led(now, bodies.leads.mass[b], r)
                power += bodies.applied[b, r] * speed + bodies.applied[b, 3 + r] * now[3 + r]
    return power


@device_function
def _add_mounted(scene: NativeScene) -> None:
    """Add to `mounted` what the flange's sensor shows of a step beyond the soft robot's wrench.

    It is read ahead of the next half step, so the axes are still those of the reading.
    """
    if scene.flange_sensor.shape[0] == 0:
        return
    force, torque = scene.flange_sensor[0], scene.flange_sensor[1]
    for r in range(3):
        scene.mounted[r] -= scene.applied[r] / scene.pace[0]
        scene.mounted[3 + r] -= scene.applied[3 + r] / scene.pace[0]
        for c in range(3):  # MuJoCo shows what the arm exerts
            scene.mounted[r] -= scene.axes[r, c] * scene.sensed[force + c] / scene.pace[0]
            scene.mounted[3 + r] -= scene.axes[r, c] * scene.sensed[torque + c] / scene.pace[0]


@device_function
def _read_touch(scene: NativeScene, bodies: BodyLoads, touch: Matrix) -> None:
    """Fill what touches each body, see `Ticks.touch`."""
    for body in range(touch.shape[0]):
        touch[body, 0] = bodies.pressing[body] if bodies.loaded[body] else 0.0
    if scene.flange_sensor.shape[0] > 0:
        touch[0, 1] = scene.sensed[scene.flange_sensor[2]]
    for o in range(scene.object_sensors.shape[0]):
        row = scene.object_sensors[o]
        touch[row[0], 1], touch[row[0], 2] = scene.others[row[0]], scene.sensed[row[1]]
        for k in range(2, row.shape[0]):
            touch[row[0], 1] += scene.sensed[row[k]]
            touch[row[0], 2] -= scene.sensed[row[k]]


@device_function
def _read_scene(scene: NativeScene, bodies: BodyLoads, ticks: Any, k: int) -> None:
    """Keep where arm and bodies are at the end of tick k, the flange's velocity, and the forces on bodies."""
    ticks.contact[k, 0] = bodies.handed[7]
    _read_touch(scene, bodies, ticks.touch[k])
    for r in range(6):
        ticks.mounted[k, r] = scene.mounted[r]
    for j in range(scene.position.shape[0]):
        ticks.joints[k, j], ticks.joint_speed[k, j] = scene.position[j], scene.speed[j]
        ticks.servo_torque[k, j] = scene.servos.torque[j]
    for body in range(scene.places.shape[0]):
        for r in range(3):
            ticks.places[k, body, r] = scene.places[body, r]
            ticks.body_force[k, body, r] = bodies.applied[body, r] if bodies.loaded[body] else 0.0
        for r in range(4):
            ticks.quaternions[k, body, r] = scene.quaternions[body, r]
    for r in range(3):
        i, m = (r + 1) % 3, (r + 2) % 3
        arm_i, arm_m = scene.origin[i] - scene.reference[i], scene.origin[m] - scene.reference[m]
        cross = arm_i * scene.velocity[m] - arm_m * scene.velocity[i]
        ticks.twist[k, r], ticks.twist[k, 3 + r] = scene.velocity[3 + r] - cross, scene.velocity[r]
        ticks.origin[k + 1, r] = scene.origin[r]
        for c in range(3):
            ticks.axes[k + 1, r, c] = scene.axes[r, c]


@device_function
def _go_on(scene: NativeScene) -> None:
    """Let servos continue through a tick of several steps, at the speed that they are asked for."""
    for j in range(scene.control.shape[0]):
        scene.control[j, 0] += scene.step_s * scene.control[j, 1]


@device_function
def _drive(scene: NativeScene, left: int) -> None:
    """Put a cell's joints on their way to where they are to be at the tick's end, so many steps from here."""
    for d in range(scene.drive_place.shape[0]):
        place, dof = scene.drive_place[d], scene.drive_dof[d]
        if left == 1:
            scene.coordinates[place], scene.speeds[dof] = scene.drive_aim[0, d], scene.drive_aim[1, d]
        else:  # MuJoCo has gone on by a step at the speed of before
            way = scene.drive_aim[0, d] - scene.coordinates[place] + scene.step_s * scene.speeds[dof]
            scene.coordinates[place] += way / left - scene.step_s * scene.speeds[dof]
            scene.speeds[dof] = way / (left * scene.step_s)


@device_function
def rigid_half(rigid: RigidSide, servos: Any, ticks: Any, k: int) -> bool:
    """Let MuJoCo step under servos and the wrench of row k; return whether it has not warned."""
    scene, carried = rigid.scene, rigid.carried
    payload = small_vector(10)
    _fill_payload(ticks.figures[k], rigid.mass_kg, ticks.origin[k], ticks.axes[k], rigid.mounted, payload)
    for j in range(scene.control.shape[0]):
        torque = servos.torque[k, j]
        for i in range(10):
            torque += servos.by_payload[k, j, i] * payload[i]
        scene.control[j, 0], scene.control[j, 1] = servos.position[k, j], servos.velocity[k, j]
        scene.control[j, 2] = torque
        ticks.joint_speed[k, j] = scene.speed[j]  # until `_read_scene`
    load_scene(scene, carried, ticks, k)
    ticks.momentum_error[k] = _momentum_error(scene, rigid.bodies, ticks.handed[k])
    power, ticks.work[k, 3] = power_on_bodies(rigid.bodies), 0.0
    for r in range(6):
        scene.mounted[r] = 0.0
    for i in range(scene.pace[0]):
        if i > 0:
            _go_on(scene)
        finish_step(scene.servos)
        _add_mounted(scene)
        _drive(scene, scene.pace[1] - i)
        call_native(scene.steps[BEGIN], scene.sides[0], scene.sides[1])
        for kind in range(scene.warnings.shape[0]):
            if scene.warnings[kind] != 0:
                return False
        _carry(scene, carried.inertia)
        # a constant force changes a body's energy by its mean speed, as its momentum changes evenly
        before, power = power, power_on_bodies(rigid.bodies)
        ticks.work[k, 3] += 0.5 * scene.step_s * (before + power)
    if scene.pace[0] > 1:  # what is given back goes by that of the whole tick
        for j in range(scene.speed.shape[0]):
            change = scene.speed[j] - ticks.joint_speed[k, j]
            scene.acceleration[j] = change / (scene.pace[0] * scene.step_s)
    _read_scene(scene, rigid.bodies, ticks, k)
    return True


@kernel
def take_rigid_half(rigid: RigidSide, servos: Servos, ticks: Ticks, k: int) -> bool:
    """Take the rigid half of a tick, see `rigid_half`."""
    return rigid_half(rigid, servos, ticks, k)


@kernel
def load_rigid_side(rigid: RigidSide, ticks: Ticks, k: int) -> None:
    """Load the rigid side for a rigid half that somebody else takes; `read_rigid_half` follows it."""
    load_scene(rigid.scene, rigid.carried, ticks, k)
    ticks.work[k, 3] = power_on_bodies(rigid.bodies)


@kernel
def read_rigid_half(rigid: RigidSide, servos: Servos, ticks: Ticks, k: int) -> bool:
    """Read what the rigid half of a tick has led to that somebody else has taken, see `rigid_half`."""
    ticks.momentum_error[k] = _momentum_error(rigid.scene, rigid.bodies, ticks.handed[k])
    tick_s = rigid.scene.pace[0] * rigid.scene.step_s
    ticks.work[k, 3] = 0.5 * tick_s * (ticks.work[k, 3] + power_on_bodies(rigid.bodies))
    _read_scene(rigid.scene, rigid.bodies, ticks, k)
    return True


@device_function
def fill_flange(ticks: Any, k: int, flange: Matrix) -> None:
    """Fill flange (4, 3), see `flange_axes`, with its pose at the end of tick k."""
    for r in range(3):
        flange[0, r] = ticks.origin[k + 1, r]
        for c in range(3):
            flange[1 + c, r] = ticks.axes[k + 1, r, c]


@kernel
def hand_over(acted: Vector, ticks: Ticks, k: int) -> None:
    """Hand over the wrench in the figures at the end of tick k, in which (6,) has acted on the flange.

    It is taken to the world's origin. Powers are those of what has acted and of the answer, see
    `LedgerEntry`.
    """
    twist, wrench, place = ticks.twist[k], ticks.figures[k + 1, WRENCH:CENTER], ticks.origin[k + 1]
    handed, size, received, given = ticks.handed[k + 1], 0.0, 0.0, 0.0
    force = moment = speed = turn = 0.0
    for r in range(6):
        received, given = received + acted[r] * twist[r], given + wrench[r] * twist[r]
    for r in range(3):
        i, m = (r + 1) % 3, (r + 2) % 3
        handed[r], handed[3 + r] = wrench[r], wrench[3 + r] + place[i] * wrench[m] - place[m] * wrench[i]
        size = max(size, abs(wrench[r]))
        force, moment = force + wrench[r] * wrench[r], moment + wrench[3 + r] * wrench[3 + r]
        speed, turn = speed + twist[r] * twist[r], turn + twist[3 + r] * twist[3 + r]
    handed[6], ticks.power[k, 0], ticks.power[k, 1] = size, received, -given
    ticks.power[k, 2] = np.sqrt(force) * np.sqrt(speed) + np.sqrt(moment) * np.sqrt(turn)
