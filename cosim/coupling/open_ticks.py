"""Ticks of a film in a row that stays open: each is begun and ended by a call of its own, by an address.

Somebody else steps the scene meanwhile. A call with all arrays of both sides costs more than a tick's rigid
half; here kernels find them in a record. A file of its own, as only attached soft robots compile it.
"""

from typing import Any, NamedTuple

from cosim.base.kernels import handing_on_views, kernel, record_at
from cosim.base.numba_insides import caller
from cosim.coupling.film_ticks import FilmCommands, FilmMotion, FilmSteps, advance_film
from cosim.coupling.half_ticks import RigidSide, load_scene, power_on_bodies
from cosim.coupling.ticks import Servos, Ticks

_advance_film = caller(advance_film)


class OpenTicks(NamedTuple):
    """What the ticks of an open row act on; n are room for.

    Args:
        rigid: side, whose rigid halves are read.
        servos: (1, 0) each, as somebody else has them.
        commands: of n ticks, each filled ahead of its end.
        steps: see `FilmSteps`.
        ticks: n.
        way: of n ticks.
    """

    rigid: RigidSide
    servos: Servos
    commands: FilmCommands
    steps: FilmSteps
    ticks: Ticks
    way: FilmMotion


@handing_on_views
def _from_on(ticks: Any, k: int) -> Ticks:
    """Return the rows of tick k and all after it."""
    return Ticks(
        ticks.figures[k:], ticks.origin[k:], ticks.axes[k:], ticks.twist[k:], ticks.handed[k:],
        ticks.joints[k:], ticks.joint_speed[k:], ticks.servo_torque[k:], ticks.places[k:],
        ticks.quaternions[k:], ticks.power[k:], ticks.momentum_error[k:], ticks.residual[k:],
        ticks.iterations[k:], ticks.contacts[k:], ticks.contact[k:], ticks.body_force[k:],
        ticks.self_contact[k:], ticks.work[k:], ticks.hit[k:], ticks.mounted[k:], ticks.touch[k:],
    )  # fmt: skip


@kernel
def load_open_tick(at: int, k: int) -> None:
    """Load the rigid side for tick k of the `OpenTicks` at an address; somebody else takes its rigid half."""
    row = record_at(at, OpenTicks)
    load_scene(row.rigid.scene, row.rigid.carried, row.ticks, k)
    row.ticks.work[k, 3] = power_on_bodies(row.rigid.bodies)


@kernel
def end_open_tick(at: int, call: int, k: int) -> int:
    """Read the rigid half of tick k and take the soft one; return how that ended, see `advance_film`.

    Args:
        at: address of the `OpenTicks`.
        call: address of `advance_film`.
        k: the tick.
    """
    row = record_at(at, OpenTicks)
    asked, way = row.commands, row.way
    commands = FilmCommands(asked.pressure[k:], asked.tension[k:], asked.gravity[k:])
    rows = FilmMotion(way.x[k:], way.velocity[k:], way.memory[k:])
    given = row.rigid, row.servos, commands, row.steps, _from_on(row.ticks, k), rows
    return _advance_film(call, given)[1]
