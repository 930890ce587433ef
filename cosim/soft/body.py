"""The soft body: what it is made of (frozen) and the loads on it (frozen)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Protocol, final

import numpy as np

from cosim.errors import InputError, MeshError
from cosim.frames import Array, IntArray, cross
from cosim.soft.cable import Cable
from cosim.soft.contact import ContactPlanes
from cosim.soft.film import Film
from cosim.soft.film_contact import FilmPairs
from cosim.soft.frame_ring import FrameRings
from cosim.soft.gas import SealedGas
from cosim.soft.gas_chamber import (
    GasChamber,
    Gases,
    check_chambers,
    gas_between,
    of_each,
    pressure_between,
)
from cosim.soft.hinge import Hinges
from cosim.soft.membrane import Membranes
from cosim.soft.surface import dihedral_angle


@final
@dataclass(frozen=True)
class SoftBody:
    """A film chamber with hinges and cables, described once.

    Args:
        positions: (n, 3) [m], drawn shape, frame of the flange.
        membranes: film triangles.
        hinges: rotational springs.
        caps: hole rings that close the chamber, fan normals outward.
        closed: whether the caps carry pressure; False is the paper's open chamber.
        cables: routed cables.
        node_mass: (n,) [kg].
        base: nodes that follow the flange.
        tip: nodes of the last hole ring, in order.
        rings: names of node groups.
        frames: stiff frames around rings, or None.
        plates: stiff plates, each joining a group of nodes.
        chambers: which parts enclose a gas of their own; none: all of it encloses one.
    """

    positions: Array
    membranes: Membranes
    hinges: Hinges
    caps: tuple[IntArray, ...]
    closed: bool
    cables: tuple[Cable, ...]
    node_mass: Array
    base: IntArray
    tip: IntArray
    rings: Mapping[str, IntArray] = field(default_factory=dict)
    frames: FrameRings | None = None
    plates: tuple[FrameRings, ...] = ()
    chambers: tuple[GasChamber, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.positions)
        groups: dict[str, IntArray] = {
            "triangles": self.membranes.triangles,
            "hinges": self.hinges.nodes,
            "base": self.base,
            "tip": self.tip,
            **{f"cap {k}": ring for k, ring in enumerate(self.caps)},
            "frames": np.zeros(0, np.int64) if self.frames is None else self.frames.rings,
            **{f"plate {k}": plate.rings for k, plate in enumerate(self.plates)},
            **{f"cable {k}": cable.nodes for k, cable in enumerate(self.cables)},
        }
        for name, nodes in groups.items():
            if nodes.size and (nodes.min() < 0 or nodes.max() >= count):
                bad = int(nodes.min() if nodes.min() < 0 else nodes.max())
                raise MeshError(f"{name} refers to node {bad}; there are nodes 0 to {count - 1}")
        mass = self.node_mass
        if mass.shape != (count,) or not ((mass >= 0.0) & (mass < np.inf)).all():
            raise MeshError(f"node masses must be {count} finite numbers that are not negative")
        if not np.isfinite(self.positions).all():
            raise MeshError("the drawn shape holds positions that are not finite")
        check_chambers(self.chambers, len(self.membranes.triangles), len(self.caps))

    @classmethod
    def from_arrays(
        cls,
        positions: Array,
        triangles: IntArray,
        film: Film,
        *,
        hinge_nodes: IntArray | None = None,
        hinge_stiffness: Array | float = 0.0,
        hinge_rest_angle: Array | None = None,
        fold_barrier_rad: float = 0.0,
        caps: tuple[IntArray, ...] = (),
        closed: bool = True,
        cables: tuple[Cable, ...] = (),
        node_mass: Array | float = 0.0,
        base: IntArray | None = None,
        tip: IntArray | None = None,
        rings: Mapping[str, IntArray] | None = None,
    ) -> SoftBody:
        """Return a body from plain arrays, so that foreign meshes run.

        Args:
            positions: (n, 3) [m], stress-free shape of the film.
            triangles: (m, 3), outward orientation.
            film: material.
            hinge_nodes: (h, 4) nodes i, j, k, l; j-k is the edge.
            hinge_stiffness: (h,) or one number [N m/rad].
            hinge_rest_angle: (h,) [rad]; the drawn shape's angles if omitted.
            fold_barrier_rad: angle below which the fold barrier acts; 0 for none.
            caps: rings that close the chamber.
            closed: whether the caps carry pressure.
            cables: routed cables.
            node_mass: (n,) or one number [kg].
            base: nodes that follow the flange.
            tip: nodes whose mean is the tip, in order around the ring.
            rings: names of node groups.

        Raises:
            MeshError: degenerate triangles, unknown nodes, negative masses.
        """
        x = np.array(positions, dtype=np.float64, order="C")
        tri = _indices(triangles)
        if tri.size and (tri.min() < 0 or tri.max() >= len(x)):
            raise MeshError(f"triangles refer to node {int(tri.max())}; there are nodes 0 to {len(x) - 1}")
        nodes = np.zeros((0, 4), np.int64) if hinge_nodes is None else _indices(hinge_nodes)
        stiffness = np.array(np.broadcast_to(hinge_stiffness, (len(nodes),)), dtype=np.float64)
        if nodes.size and (nodes.min() < 0 or nodes.max() >= len(x)):
            raise MeshError(f"hinges refer to node {int(nodes.max())}; there are nodes 0 to {len(x) - 1}")
        rest = dihedral_angle(x, nodes) if hinge_rest_angle is None else np.array(hinge_rest_angle)
        return cls(
            positions=x,
            membranes=Membranes.from_shape(x, tri, film),
            hinges=Hinges(nodes, stiffness, rest, fold_barrier_rad),
            caps=tuple(_indices(ring) for ring in caps),
            closed=closed,
            cables=cables,
            node_mass=np.array(np.broadcast_to(node_mass, (len(x),)), dtype=np.float64),
            base=_indices(() if base is None else base),
            tip=_indices(() if tip is None else tip),
            rings=dict(rings or {}),
        )

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return len(self.positions)

    @property
    def mass_kg(self) -> float:
        """Total mass."""
        return float(self.node_mass.sum())

    def tip_position(self, positions: Array) -> Array:
        """Return the mean of the tip ring (3,) [m]."""
        return np.asarray(positions[self.tip].mean(axis=0))

    def tip_direction(self, positions: Array) -> Array:
        """Return the unit normal (3,) of the tip ring, pointing away from the body.

        The vector area of the ring, sum_i r_i x r_i+1 / 2, as ordered for the cap.
        """
        r = positions[self.tip]
        area = cross(r, r[np.arange(1, len(r) + 1) % len(r)]).sum(axis=0)
        return np.asarray(area / np.linalg.norm(area))


def _indices(values: object) -> IntArray:
    """Return a copy that can be written to: of one that can't, kernels would be compiled a second time."""
    return np.array(values, dtype=np.int64, order="C")


class NodalPotential(Protocol):
    """A further potential of the nodes' positions, for studies of a body."""

    def add(self, positions: Array, gradient: Array, blocks: Array, *, hessian: bool) -> float:
        """Add its gradient (n, 3) and Hessian blocks; return the energy [J]."""


@final
@dataclass(frozen=True)
class Loads:
    """What acts on a body at one instant.

    Args:
        pressure_Pa: gauge pressure of the gas, in all chambers or in each.
        cable_tension_N: tension of each cable at its base end; without meaning where its length is commanded.
        gravity: (3,) [m/s^2].
        nodal_force: (n, 3) [N], dead load (it keeps its direction), world axes; None for none.
        gas: sealed gas in place of a given pressure, in all chambers or in each; it needs a closed body.
        contact: what may be touched; None for nothing.
        cable_length_m: unstretched length of each cable whose length is commanded, None for one whose tension
            is; empty where no length is.
        self_contact: films that may touch one another; None for none.
        extra: a further potential, such as springs; None for none.

    Raises:
        InputError: a negative tension: cables cannot push; a length that is not above 0.
    """

    pressure_Pa: float | Annotated[tuple[float, ...], ("chambers",)] = 0.0
    cable_tension_N: Annotated[tuple[float, ...], ("cables",)] = ()
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    nodal_force: Annotated[Array, ("nodes", 3)] | None = None
    gas: Gases = None
    contact: ContactPlanes | None = None
    cable_length_m: tuple[float | None, ...] = ()
    self_contact: FilmPairs | None = None
    extra: NodalPotential | None = None

    def __post_init__(self) -> None:
        if not all(tension >= 0.0 for tension in self.cable_tension_N):
            raise InputError(
                f"cable tensions are {self.cable_tension_N} N; a cable cannot push, give 0 or more"
            )
        if not all(length is None or length > 0.0 for length in self.cable_length_m):
            raise InputError(f"cable lengths are {self.cable_length_m} m; they must be above 0")

    def pressures(self, chambers: int) -> tuple[float, ...]:
        """Return the given gauge pressure [Pa] of each of so many chambers.

        Raises:
            InputError: there are more or fewer values than chambers.
        """
        return of_each(self.pressure_Pa, chambers, "pressure")

    def gases(self, chambers: int) -> tuple[SealedGas | None, ...]:
        """Return the sealed gas of each of so many chambers, None where the pressure is given.

        Raises:
            InputError: there are more or fewer values than chambers.
        """
        return of_each(self.gas, chambers, "gas")

    def pressures_at(self, volumes_m3: tuple[float, ...]) -> tuple[float, ...]:
        """Return the gauge pressure [Pa] in each chamber, that of sealed gases at these volumes [m^3]."""
        given = self.pressures(len(volumes_m3))
        gases = zip(self.gases(len(volumes_m3)), given, volumes_m3, strict=True)
        return tuple(p if gas is None else gas.gauge_pressure(volume) for gas, p, volume in gases)

    def interpolated(self, end: Loads, share: float) -> Loads:
        """Return the loads at a share of the way to others; exactly those at 1.

        Between two sealed gases the mass changes at the first one's volume; sealing is done at once, and so
        is the change of a cable from commanded tension to commanded length.
        """
        if share >= 1.0:
            return end
        pulls = zip(self.cable_tension_N, end.cable_tension_N, strict=True)
        tension = tuple(float((1.0 - share) * a + share * b) for a, b in pulls)
        pairs = zip(self.gravity, end.gravity, strict=True)
        gx, gy, gz = (float((1.0 - share) * a + share * b) for a, b in pairs)
        pressure = pressure_between(self.pressure_Pa, end.pressure_Pa, share)
        force = _weighted(self.nodal_force, end.nodal_force, share)
        gas = gas_between(self.gas, end.gas, share)
        lengths = _lengths(self.cable_length_m, end.cable_length_m, share)
        return Loads(
            pressure,
            tension,
            (gx, gy, gz),
            force,
            gas,
            end.contact,
            lengths,
            end.self_contact,
            end.extra,
        )


def _weighted(begin: Array | None, end: Array | None, share: float) -> Array | None:
    """Return (1 - share) begin + share end, where None stands for zero."""
    if begin is None or end is None:
        return share * end if end is not None else (1.0 - share) * begin if begin is not None else None
    return (1.0 - share) * begin + share * end


def _lengths(
    begin: tuple[float | None, ...], end: tuple[float | None, ...], share: float
) -> tuple[float | None, ...]:
    """Return the commanded lengths between two, of the cables that have one at the end."""
    if len(begin) != len(end):
        return end
    return tuple(
        b if a is None or b is None else (1.0 - share) * a + share * b
        for a, b in zip(begin, end, strict=True)
    )
