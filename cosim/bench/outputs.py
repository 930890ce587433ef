"""Named quantities of an equilibrium, such as "tip_position_m.x" or "cable_tension_N.left", and their
derivatives by parameters.
"""

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
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve import newton
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.parameter_derivatives import (
    EquilibriumDerivatives,
    ParameterChange,
    ParameterDerivative,
    PerturbedModel,
)
from cosim.soft.solve.state import Equilibrium

XYZ: Final = "xyz"
_LINEAR: Final = "tip_position_m"
"""Linear in the positions, so its derivative is its value at dx/dp."""
_PLACES: Final = ("ring_position_m", "node_position_m")


class OutputShape(NamedTuple):
    """A shape of the film, from which quantities are computed.

    Args:
        side: model and loads.
        positions: (n, 3) [m], world.
        gradient: (n, 3) [N], of the potential at these positions.
        flange: world from flange.
    """

    side: PerturbedModel
    positions: Array
    gradient: Array
    flange: Pose


def _tip(shape: OutputShape) -> Array:
    return shape.side.film.body.tip_position(shape.positions)


def _direction(shape: OutputShape) -> Array:
    return shape.side.film.body.tip_direction(shape.positions)


def _bending(shape: OutputShape) -> Array:
    axis, direction = shape.flange.rotation[:, 2], _direction(shape)
    return np.array([np.arctan2(np.linalg.norm(np.cross(axis, direction)), axis @ direction)])


def _length(shape: OutputShape) -> Array:
    body = shape.side.film.body
    return np.array([center_line_length(center_rings(body), shape.positions)])


def _volumes(shape: OutputShape) -> Array:
    return np.asarray(shape.side.film.gas.enclosed_volumes(shape.positions[None])[0])


def _pressures(shape: OutputShape) -> Array:
    return np.array(shape.side.loads.pressures_at(tuple(_volumes(shape).tolist())))


def _routes(shape: OutputShape) -> Array:
    return np.array([cable.length(shape.positions) for cable in shape.side.film.body.cables])


def _tensions(shape: OutputShape) -> Array:
    cables, loads = shape.side.film.body.cables, shape.side.loads
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
    strain = stiffener_strain(shape.side.film.body, shape.positions)
    if strain is None:
        raise InputError("frame_strain: the soft robot has no printed frames")
    return np.array([strain.peak])


Quantity: TypeAlias = Callable[[OutputShape], Array]
_QUANTITIES: Final[dict[str, tuple[str, Quantity]]] = {
    "tip_position_m": ("xyz", _tip),
    "tip_direction": ("xyz", _direction),
    "bending_angle_rad": ("", _bending),
    "length_m": ("", _length),
    "volume_m3": ("chamber", _volumes),
    "pressure_Pa": ("chamber", _pressures),
    "cable_length_m": ("cable", _routes),
    "cable_tension_N": ("cable", _tensions),
    "frame_strain": ("", _frame_strain),
    "mass_kg": ("", lambda shape: np.array([shape.side.film.body.node_mass.sum()])),
    "flange_force_N": ("xyz", lambda shape: _wrench(shape)[:3]),
    "flange_torque_Nm": ("xyz", lambda shape: _wrench(shape)[3:]),
}
"""Kind of the entries, and function, by name."""


@final
@dataclass(frozen=True)
class Output:
    """A scalar quantity of an equilibrium.

    Args:
        name: such as "tip_position_m.x".
        quantity: function that returns an array with it.
        index: of it in that array.
        linear: whether it is linear in the positions, and depends on nothing else.
    """

    name: str
    quantity: Quantity
    index: int
    linear: bool = False

    @property
    def unit(self) -> str:
        """Unit for people; "1" without one."""
        return unit_text(unit_of(self.name.partition(".")[0])) or "1"


def outputs_of(names: Sequence[str], model: StaticModel) -> list[Output]:
    """Return outputs by name; a name without its last part means all entries.

    Raises:
        InputError: there is no such output.
    """
    return [found for name in names for found in _found(name, model)]


def read(outputs: Sequence[Output], shape: OutputShape) -> Array:
    """Return the values (outputs,) at a shape."""
    arrays = {output.quantity: output.quantity(shape) for output in outputs}
    return np.array([arrays[output.quantity][output.index] for output in outputs])


def read_at(outputs: Sequence[Output], film: FilmPotential, clamp: Clamp, here: Equilibrium) -> Array:
    """Return the values (outputs,) at an equilibrium."""
    x, memory = np.array(here.state.positions, order="C"), film.fresh(here.state.memory)
    film.evaluate(x, here.loads, film.losses_at(x, here.loads, memory), memory, hessian=False)
    side = PerturbedModel(0.0, 0.0, 0.0, film, clamp, here.loads)
    return read(outputs, OutputShape(side, x, film.gradient.copy(), here.world_from_flange))


def _found(name: str, model: StaticModel) -> Iterator[Output]:
    kind, _, of = name.partition(".")
    if kind in _PLACES:
        yield from _of_nodes(kind, of, model)
        return
    if kind not in _QUANTITIES:
        raise InputError(
            f"no output {name!r}; there are {', '.join((*_QUANTITIES, *_PLACES))}, those of a place with "
            ".NAME, vectors with .x, .y or .z"
        )
    what, quantity = _QUANTITIES[kind]
    known = {"xyz": tuple(XYZ), "chamber": model.chambers, "cable": model.cables, "": ("",)}[what]
    if of and of not in known:
        raise InputError(f"{name}: {unknown_name_message(what or 'entry', of, known)}")
    for index, each in enumerate(known):
        if of in ("", each):
            yield Output(f"{kind}.{each}" if each else kind, quantity, index, kind == _LINEAR)


def _of_nodes(kind: str, of: str, model: StaticModel) -> Iterator[Output]:
    body, axis = model.film.body, of[-1:] if of[-2:-1] == "." and of[-1:] in XYZ else ""
    name = of[:-2] if axis else of
    if kind == "ring_position_m":
        if name not in body.rings:
            raise InputError(f"{kind}.{of}: {unknown_name_message('ring', name, tuple(body.rings))}")
        nodes = body.rings[name]
    else:
        if not name.isdecimal() or int(name) >= body.nodes:
            raise InputError(f"{kind}.{of}: no node {name!r}; there are 0 to {body.nodes - 1}")
        nodes = np.array([int(name)])

    def mean(shape: OutputShape) -> Array:
        return np.asarray(shape.positions[nodes].mean(axis=0))

    for k, each in enumerate(XYZ):
        if axis in ("", each):
            yield Output(f"{kind}.{name}.{each}", mean, k, linear=True)


def change(
    outputs: Sequence[Output],
    slopes: EquilibriumDerivatives,
    moved: ParameterChange,
    slope: ParameterDerivative,
    flange: Pose,
) -> Array:
    """Return the derivatives (outputs,) by a parameter.

    Args:
        outputs: the quantities.
        slopes: derivatives of the equilibrium.
        moved: the difference quotient of the parameter.
        slope: derivative of the shape by the parameter.
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
    """Computes Jacobians of outputs by parameters at equilibria of one model.

    Args:
        parameters: columns of the Jacobian.
        outputs: rows of the Jacobian.
        model: the model.
        kinks: see `EquilibriumDerivatives`.
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
        self, solver: newton.NewtonSolver, clamp: Clamp, here: Equilibrium, only: Sequence[int] | None = None
    ) -> tuple[Array, Array]:
        """Return the outputs (m,), and their Jacobian (m, parameters), at an equilibrium.

        Args:
            solver: of the body with the active clamp.
            clamp: the active clamp.
            here: the equilibrium.
            only: indices of some parameters; None for all.
        """
        slopes, flange = (
            EquilibriumDerivatives(solver, clamp, here, kinks=self._kinks),
            here.world_from_flange,
        )
        moved = [self._moves[k](here, clamp) for k in (range(len(self._moves)) if only is None else only)]
        found = read(self._outputs, OutputShape(slopes.own, here.state.positions, slopes.gradient, flange))
        columns = [
            change(self._outputs, slopes, each, slope, flange)
            for each, slope in zip(moved, slopes.by(moved), strict=True)
        ]
        return found, np.stack(columns, axis=1) if columns else np.zeros((len(found), 0))
