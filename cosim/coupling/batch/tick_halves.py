"""What a tick does around the soft step, in kernels: the rigid half before it, and what is handed over after.

The soft side is known by its figures alone: the wrench on the flange, centre and inertia of its mass.
"""

from __future__ import annotations

import numpy as np

from cosim.base.kernels import device_function, small_matrix, small_vector
from cosim.base.numba_insides import call_native
from cosim.coupling.schemes.momentum_balance import LEVER_M, SMALLEST_N
from cosim.reduced.sections.outputs import CENTER, INERTIA, WRENCH
from cosim.rigid.scene.native import BEGIN, FACTORISE, FINISH

ALL_DONE, SOFT_STEP_LEFT, RIGID_SIDE_WARNS, SOFT_STEP_BEGUN = range(4)
"""How a row of ticks ended; with the second and the last, the tick's rigid half is done."""


@device_function
def _fill_payload(figures, mass, origin, axes, mounted, out):  # type: ignore[no-untyped-def]
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
def _command(scene, commands, k, payload):  # type: ignore[no-untyped-def]
    """Tell the servos what to follow."""
    for j in range(scene.control.shape[0]):
        torque = commands.torque[k, j]
        for i in range(10):
            torque += commands.by_payload[k, j, i] * payload[i]
        scene.control[j, 0] = commands.position[k, j]
        scene.control[j, 1] = commands.velocity[k, j]
        scene.control[j, 2] = torque


@device_function
def _give_back(scene, carried):  # type: ignore[no-untyped-def]
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
def _carry(scene, inertia):  # type: ignore[no-untyped-def]
    """Add what the joints carry to a mass matrix that MuJoCo has computed for new positions."""
    joints = inertia.shape[0]
    for i in range(joints):
        for j in range(i + 1):
            scene.mass[scene.mass_places[i, j]] += inertia[i, j]
    if joints > 0:
        call_native(scene.steps[FACTORISE], scene.sides[0], scene.sides[1])


@device_function
def _momentum_error(scene, handed):  # type: ignore[no-untyped-def]
    """Return how far what acts on the flange is from what was handed over, see `momentum`."""
    largest = 0.0
    for r in range(3):
        i, k = (r + 1) % 3, (r + 2) % 3
        torque = (
            scene.applied[3 + r] + scene.center[i] * scene.applied[k] - scene.center[k] * scene.applied[i]
        )
        largest = max(largest, abs(handed[r] - scene.applied[r]))
        largest = max(largest, abs(handed[3 + r] - torque) / LEVER_M)
    return largest / max(handed[6], SMALLEST_N)


@device_function
def _read_scene(scene, ticks, k):  # type: ignore[no-untyped-def]
    """Keep where arm and bodies are at the end of tick k, and how the flange moves."""
    for j in range(scene.position.shape[0]):
        ticks.joints[k, j], ticks.joint_speed[k, j] = scene.position[j], scene.speed[j]
        ticks.servo_torque[k, j] = scene.servo_torque[j]
    for body in range(scene.places.shape[0]):
        for r in range(3):
            ticks.places[k, body, r] = scene.places[body, r]
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
def _hand_over(ticks, k):  # type: ignore[no-untyped-def]
    """Take the wrench from the chain's figures to the world's origin."""
    place, size = ticks.origin[k + 1], 0.0
    for r in range(3):
        i, m = (r + 1) % 3, (r + 2) % 3
        force_i, force_m = ticks.figures[k + 1, WRENCH + i], ticks.figures[k + 1, WRENCH + m]
        ticks.handed[k + 1, r] = ticks.figures[k + 1, WRENCH + r]
        torque = ticks.figures[k + 1, WRENCH + 3 + r]
        ticks.handed[k + 1, 3 + r] = torque + place[i] * force_m - place[m] * force_i
        size = max(size, abs(ticks.figures[k + 1, WRENCH + r]))
    ticks.handed[k + 1, 6] = size


@device_function
def _power(force, torque, twist):  # type: ignore[no-untyped-def]
    """Return the power [W] of a load with a twist."""
    power = 0.0
    for r in range(3):
        power += force[r] * twist[r]
    for r in range(3):
        power += torque[r] * twist[3 + r]
    return power


@device_function
def _fill_power(scene, ticks, k):  # type: ignore[no-untyped-def]
    """Keep the powers of the wrench that acted and of the answer, see `LedgerEntry`."""
    twist, wrench = ticks.twist[k], ticks.figures[k + 1, WRENCH:CENTER]
    force = moment = speed = turn = 0.0
    for r in range(3):
        force, moment = force + wrench[r] * wrench[r], moment + wrench[3 + r] * wrench[3 + r]
        speed, turn = speed + twist[r] * twist[r], turn + twist[3 + r] * twist[3 + r]
    ticks.power[k, 0] = _power(scene.applied[:3], scene.applied[3:], twist)
    ticks.power[k, 1] = -_power(wrench[:3], wrench[3:], twist)
    ticks.power[k, 2] = np.sqrt(force) * np.sqrt(speed) + np.sqrt(moment) * np.sqrt(turn)


@device_function
def take_rigid_half(scene, carried, mounted, mass, commands, ticks, k):  # type: ignore[no-untyped-def]
    """Let MuJoCo step under servos and the last wrench; return whether it has not warned.

    Args:
        scene: see `NativeScene`.
        carried: on the joints.
        mounted: (10,), parameters of a rigid mass on the flange, flange frame.
        mass: [kg], of the soft side.
        commands: position, velocity, torque and by_payload of n ticks.
        ticks: of which the k-th begins.
        k: which.
    """
    payload = small_vector(10)
    _fill_payload(ticks.figures[k], mass, ticks.origin[k], ticks.axes[k], mounted, payload)
    _command(scene, commands, k, payload)
    for r in range(6):
        scene.applied[r] = ticks.figures[k, WRENCH + r]
    _give_back(scene, carried)
    ticks.momentum_error[k] = _momentum_error(scene, ticks.handed[k])
    call_native(scene.steps[FINISH], scene.sides[0], scene.sides[1])
    call_native(scene.steps[BEGIN], scene.sides[0], scene.sides[1])
    for kind in range(scene.warnings.shape[0]):
        if scene.warnings[kind] != 0:
            return False
    _carry(scene, carried.inertia)
    _read_scene(scene, ticks, k)
    return True


@device_function
def fill_flange(scene, flange):  # type: ignore[no-untyped-def]
    """Fill flange (4, 3), see `flange_axes`, with its present pose."""
    for r in range(3):
        flange[0, r] = scene.origin[r]
        for c in range(3):
            flange[1 + c, r] = scene.axes[r, c]


@device_function
def conclude_tick(scene, ticks, k, residual, iterations):  # type: ignore[no-untyped-def]
    """Keep what the soft step of tick k has left; its figures are there."""
    ticks.residual[k], ticks.iterations[k] = residual, iterations
    _hand_over(ticks, k)
    _fill_power(scene, ticks, k)
