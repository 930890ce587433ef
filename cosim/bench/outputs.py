"""Quantities of an equilibrium by their names: what is measured on a bench, and what a Jacobian is of."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias, final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.bench.parameters import AnyParameter, Moves, StaticModel
from cosim.config.toml.keys import unit_of, unit_text, unknown_name_message
from cosim.errors import InputError
from cosim.soft.beams.beam_rings import stiffener_strain
from cosim.soft.body.places import center_line_length, center_rings
from cosim.soft.elements.cable import base_tension
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.sensitivity import EquilibriumSlope, Moved, Side, Slope
from cosim.soft.solve.state import Clamp, Equilibrium

_XYZ: Final = "xyz"


class OutputShape(NamedTuple):
    """A shape that quantities are read from.

    Args:
        side: the model and its loads.
        positions: (n, 3) [m], world.
        gradient: (n, 3) [N], of the potential there.
        flange: world from flange.
    """

    side: Side
    positions: Array
    gradient: Array
    flange: Pose


def _tip(shape: OutputShape) -> Array:
    return shape.side.system.body.tip_position(shape.positions)


def _direction(shape: OutputShape) -> Array:
    return shape.side.system.body.tip_direction(shape.positions)


def _bending(shape: OutputShape) -> Array:
    axis, direction = shape.flange.rotation[:, 2], _direction(shape)
    return np.array([np.arctan2(np.linalg.norm(np.cross(axis, direction)), axis @ direction)])


def _length(shape: OutputShape) -> Array:
    body = shape.side.system.body
    return np.array([center_line_length(center_rings(body), shape.positions)])


def _volumes(shape: OutputShape) -> Array:
    return np.asarray(shape.side.system.gas.enclosed_volumes(shape.positions[None])[0])


def _pressures(shape: OutputShape) -> Array:
    return np.array(shape.side.loads.pressures_at(tuple(_volumes(shape).tolist())))


def _routes(shape: OutputShape) -> Array:
    return np.array([cable.length(shape.positions) for cable in shape.side.system.body.cables])


def _tensions(shape: OutputShape) -> Array:
    cables, loads = shape.side.system.body.cables, shape.side.loads
    lengths = loads.cable_length_m or (None,) * len(cables)
    given = zip(cables, lengths, loads.cable_tension_N, strict=True)
    return np.array([
        pull if length is None else base_tension(cable, shape.positions, length)
        for cable, length, pull in given
    ])  # fmt: skip


def _wrench(shape: OutputShape) -> Array:
    wrench = shape.side.clamp.wrench(shape.gradient, shape.positions, shape.flange)
    return np.concatenate([wrench.force, wrench.torque])


def _frame_strain(shape: OutputShape) -> Array:
    found = stiffener_strain(shape.side.system.body, shape.positions)
    if found is None:
        raise InputError("frame_strain: the soft robot has no printed frames")
    return np.array([found.peak])


Read: TypeAlias = Callable[[OutputShape], Array]

_READ: Final[dict[str, tuple[str, Read]]] = {
    "tip_position_m": ("xyz", _tip),
    "tip_direction": ("xyz", _direction),
    "bending_angle_rad": ("", _bending),
    "length_m": ("", _length),
    "volume_m3": ("chamber", _volumes),
    "pressure_Pa": ("chamber", _pressures),
    "cable_length_m": ("cable", _routes),
    "cable_tension_N": ("cable", _tensions),
    "frame_strain": ("", _frame_strain),
    "mass_kg": ("", lambda shape: np.array([shape.side.system.body.node_mass.sum()])),
    "flange_force_N": ("xyz", lambda shape: _wrench(shape)[:3]),
    "flange_torque_Nm": ("xyz", lambda shape: _wrench(shape)[3:]),
}
"""By name, what the entries are of, and how they are read."""
_LINEAR: Final = "tip_position_m"
"""A mean of positions, so that its derivative is its value at dx/dp, as of places."""
_PLACES: Final = ("ring_position_m", "node_position_m")


@final
@dataclass(frozen=True)
class Output:
    """A number that is read from an equilibrium.

    Args:
        name: of it.
        read: returns an array that it is in.
        place: in that array.
        linear: whether it is linear in the positions, and depends on nothing else.
    """

    name: str
    read: Read
    place: int
    linear: bool = False

    @property
    def unit(self) -> str:
        """As people write it; "1" without one."""
        return unit_text(unit_of(self.name.partition(".")[0])) or "1"


def outputs_of(names: Sequence[str], model: StaticModel) -> list[Output]:
    """Return outputs by name; a name without the last part means all its entries.

    Raises:
        InputError: there is no such output.
    """
    return [found for name in names for found in _found(name, model)]


def read(outputs: Sequence[Output], shape: OutputShape) -> Array:
    """Return the values (outputs,) at a shape."""
    arrays = {output.read: output.read(shape) for output in outputs}
    return np.array([arrays[output.read][output.place] for output in outputs])


def read_at(outputs: Sequence[Output], system: SoftSystem, clamp: Clamp, here: Equilibrium) -> Array:
    """Return the values (outputs,) at an equilibrium."""
    x, memory = np.array(here.state.positions, order="C"), system.fresh(here.state.memory)
    system.evaluate(x, here.loads, system.segment_share(x, here.loads, memory), memory, hessian=False)
    side = Side(0.0, 0.0, 0.0, system, clamp, here.loads)
    return read(outputs, OutputShape(side, x, system.gradient.copy(), here.world_from_flange))


def _found(name: str, model: StaticModel) -> Iterator[Output]:
    kind, _, of = name.partition(".")
    if kind in _PLACES:
        yield from _of_nodes(kind, of, model)
        return
    if kind not in _READ:
        raise InputError(
            f"no output {name!r}; there are {', '.join((*_READ, *_PLACES))}, those of a place with .NAME, "
            "vectors with .x, .y or .z"
        )
    what, reader = _READ[kind]
    known = {"xyz": tuple(_XYZ), "chamber": model.chambers, "cable": model.cables, "": ("",)}[what]
    if of and of not in known:
        raise InputError(f"{name}: {unknown_name_message(what or 'entry', of, known)}")
    for place, each in enumerate(known):
        if of in ("", each):
            yield Output(f"{kind}.{each}" if each else kind, reader, place, kind == _LINEAR)


def _of_nodes(kind: str, of: str, model: StaticModel) -> Iterator[Output]:
    body, axis = model.system.body, of[-1:] if of[-2:-1] == "." and of[-1:] in _XYZ else ""
    place = of[:-2] if axis else of
    if kind == "ring_position_m":
        if place not in body.rings:
            raise InputError(f"{kind}.{of}: {unknown_name_message('ring', place, tuple(body.rings))}")
        nodes = body.rings[place]
    else:
        if not place.isdecimal() or int(place) >= body.nodes:
            raise InputError(f"{kind}.{of}: no node {place!r}; there are 0 to {body.nodes - 1}")
        nodes = np.array([int(place)])

    def mean(shape: OutputShape) -> Array:
        return np.asarray(shape.positions[nodes].mean(axis=0))

    for k, each in enumerate(_XYZ):
        if axis in ("", each):
            yield Output(f"{kind}.{place}.{each}", mean, k, linear=True)


def change(
    outputs: Sequence[Output], slopes: EquilibriumSlope, moved: Moved, slope: Slope, flange: Pose
) -> Array:
    """Return the derivatives (outputs,) by a parameter.

    Args:
        outputs: of them.
        slopes: of the equilibrium.
        moved: the parameter.
        slope: by it.
        flange: world from flange.
    """
    if all(output.linear for output in outputs):
        return read(outputs, OutputShape(slopes.own, slope.motion, slope.quotient, flange))
    found = np.zeros(len(outputs))
    for side in moved.sides:
        found += side.weight * read(outputs, OutputShape(side, *slopes.moved(side, slope), flange))
    return found


@final
class Slopes:
    """Jacobians of the same outputs by the same parameters, at any equilibria of one model.

    Args:
        parameters: of the columns.
        outputs: of the rows.
        model: that has both.
        kinks: see `EquilibriumSlope`.
    """

    def __init__(
        self,
        parameters: Sequence[AnyParameter],
        outputs: Sequence[Output],
        model: StaticModel,
        *,
        kinks: bool = False,
    ) -> None:
        self._kinks, self._outputs = kinks, outputs
        self._moves: list[Moves] = [each.moves(model) for each in parameters]

    def at(
        self, solver: NewtonSolver, clamp: Clamp, here: Equilibrium, only: Sequence[int] | None = None
    ) -> tuple[Array, Array]:
        """Return the outputs (m,), and their Jacobian (m, parameters), at an equilibrium.

        Args:
            solver: for the body with the clamp in force.
            clamp: in force.
            here: the equilibrium.
            only: of some parameters, by their places; of all unless given.
        """
        slopes, flange = EquilibriumSlope(solver, clamp, here, kinks=self._kinks), here.world_from_flange
        moved = [self._moves[k](here, clamp) for k in (range(len(self._moves)) if only is None else only)]
        found = read(self._outputs, OutputShape(slopes.own, here.state.positions, slopes.gradient, flange))
        columns = [
            change(self._outputs, slopes, each, slope, flange)
            for each, slope in zip(moved, slopes.by(moved), strict=True)
        ]
        return found, np.stack(columns, axis=1) if columns else np.zeros((len(found), 0))
