"""The soft body: its nodes, elements, films by face group, and gas chambers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, TypedDict, TypeVar, Unpack, final

import numpy as np

from cosim.base.frames import Array, IntArray, Pose, cross
from cosim.base.names import ONLY_CHAMBER
from cosim.errors import MeshError
from cosim.soft.elements import cable, frame_ring, material, membrane
from cosim.soft.elements.element import DirectElement, Element, Instant
from cosim.soft.elements.hinge import Hinges
from cosim.soft.geometry.named_mesh import TIP_END
from cosim.soft.geometry.surface import check_face_groups, dihedral_angle, rows_of

LEAST_TIP_AREA: Final = 1e-6
"""Vector area of a drawn tip ring over the square of its length below which the tip is a line."""
_ROUNDING_J = 1e-15
_Kind = TypeVar("_Kind", bound=Element)


@final
@dataclass(frozen=True)
class GasChamber:
    """The part of a body that encloses one gas.

    Args:
        name: such as "copy_2".
        triangles: (t,) indices of the body's film triangles.
        caps: indices of the body's caps.
    """

    name: str
    triangles: IntArray
    caps: tuple[int, ...]

    def shifted(self, name: str, triangles: int, caps: int) -> GasChamber:
        """Return the same chamber under another name, with indices shifted."""
        return GasChamber(name, self.triangles + triangles, tuple(cap + caps for cap in self.caps))


def check_chambers(chambers: Sequence[GasChamber], triangles: int, caps: int) -> None:
    """Check that every triangle and cap belongs to exactly one chamber, and that names differ.

    Args:
        chambers: of a body; may be empty.
        triangles: number of triangles of the body.
        caps: number of caps of the body.

    Raises:
        MeshError: they do not.
    """
    if not chambers:
        return
    names = [chamber.name for chamber in chambers]
    if len(set(names)) < len(names):
        raise MeshError(f"chambers are called {', '.join(names)}; names must differ")
    for kind, count, indices in (
        ("triangle", triangles, np.concatenate([chamber.triangles for chamber in chambers])),
        ("cap", caps, np.array([cap for chamber in chambers for cap in chamber.caps], dtype=np.int64)),
    ):
        owners = np.zeros(count, dtype=np.int64)
        if indices.size and (indices.min() < 0 or indices.max() >= count):
            raise MeshError(f"a chamber has {kind} {int(indices.max())}; there are {count}")
        np.add.at(owners, indices, 1)
        if (owners != 1).any():
            first_wrong = int(np.flatnonzero(owners != 1)[0])
            raise MeshError(
                f"{kind} {first_wrong} belongs to {owners[first_wrong]} chambers; it must belong to one"
            )


def by_film(
    triangles: IntArray,
    film: material.Film | Mapping[str, material.Film],
    groups: Mapping[str, IntArray],
    panel_m: Array | float,
) -> list[tuple[IntArray, material.Film, Array]]:
    """Return the triangles of each film, and the width of the panel of each.

    Args:
        triangles: (m, 3) node indices.
        film: material of all triangles, or of each face group; the groups' order is that of the result.
        groups: indices of triangles by name; groups without a film are ignored.
        panel_m: (m,) or one number.

    Raises:
        MeshError: a film's group is unknown, or a triangle has no film or several.
    """
    panel = np.broadcast_to(panel_m, (len(triangles),))
    if isinstance(film, material.Film):
        return [(triangles, film, panel)]
    check_face_groups(groups, len(triangles))
    missing = [name for name in film if name not in groups]
    if missing:
        raise MeshError(f"a film is for face group {missing[0]!r}; there are {_names(groups)}")
    films = np.bincount(
        np.concatenate([np.zeros(0, np.int64), *(groups[name] for name in film)]), minlength=len(triangles)
    )
    if (films != 1).any():
        wrong = int(np.flatnonzero(films != 1)[0])
        raise MeshError(
            f"triangle {wrong} belongs to {films[wrong]} of the face groups {_names(film)}, "
            "which have films; it must belong to one"
        )
    films_of_groups = [(groups[name], group_film) for name, group_film in film.items() if len(groups[name])]
    return [(triangles[indices], group_film, panel[indices]) for indices, group_film in films_of_groups]


def _names(groups: Iterable[str]) -> str:
    """Return names of groups for a message; the group of all other triangles has none."""
    return ", ".join(filter(None, groups)) or "none"


class BodyParts(TypedDict, total=False):
    """Optional parts of a body in addition to nodes, triangles and film, see `SoftBody.from_arrays`.

    Args:
        face_groups: indices of triangles by name; those named by the film contain every triangle once.
        wrinkle_panel_m: (m,) or one number, see `Membranes`; a film of law "wrinkling" needs it.
        hinge_nodes: (h, 4) nodes i, j, k, l; j-k is the edge.
        hinge_stiffness: (h,) or one number [N m/rad].
        hinge_rest_angle: (h,) [rad]; the drawn shape's angles if omitted.
        fold_barrier_rad: angle below which the fold barrier acts; 0 for none.
        caps: rings that close the chamber.
        closed: whether the caps carry pressure; True if omitted.
        cables: routed cables.
        node_mass: (n,) or one number [kg].
        base: nodes that follow the flange.
        tip: nodes whose mean is the tip, in order around the ring.
        rings: names of node groups.
    """

    face_groups: Mapping[str, IntArray] | None
    wrinkle_panel_m: Array | float
    hinge_nodes: IntArray | None
    hinge_stiffness: Array | float
    hinge_rest_angle: Array | None
    fold_barrier_rad: float
    caps: tuple[IntArray, ...]
    closed: bool
    cables: tuple[cable.Cable, ...]
    node_mass: Array | float
    base: IntArray | None
    tip: IntArray | None
    rings: Mapping[str, IntArray] | None


def _hinges(x: Array, parts: BodyParts) -> Hinges:
    """Return the hinges of a body with nodes x (n, 3) [m]."""
    given_nodes, given_angles = parts.get("hinge_nodes"), parts.get("hinge_rest_angle")
    nodes = _nodes("hinges", np.zeros((0, 4)) if given_nodes is None else given_nodes, len(x))
    stiffness = np.broadcast_to(parts.get("hinge_stiffness", 0.0), (len(nodes),))
    angle = dihedral_angle(x, nodes) if given_angles is None else np.array(given_angles)
    return Hinges(nodes, np.array(stiffness, dtype=np.float64), angle, parts.get("fold_barrier_rad", 0.0))


@final
@dataclass(frozen=True)
class SoftBody:
    """A body of film, and other elements with a potential of its nodes' positions.

    Args:
        positions: (n, 3) [m], drawn shape, frame of the flange.
        elements: film triangles and hinges, cables, frames and others; sorted by kind.
        caps: hole rings that close the chamber, fan normals outward.
        closed: whether the caps carry pressure; False is the paper's open chamber.
        node_mass: (n,) [kg].
        base: nodes that follow the flange.
        tip: nodes of the last hole ring, in order.
        rings: node groups by name.
        center_rings: names of the rings on the centre line before the tip; empty: the base.
        frame_rings: names of the rings that are frames of a section model, base to tip; empty for none.
        chambers: parts that enclose separate gases; empty: one chamber.
        tip_along: (3,) drawn direction of the film in ring `TIP_END`, for the direction of a tip that is a
            line; None: the line from `before_tip` to the tip.
        copies: flange_from_copy of the body's copies, in order of nodes; empty for a single body.
    """

    positions: Array
    elements: tuple[Element, ...]
    caps: tuple[IntArray, ...]
    closed: bool
    node_mass: Array
    base: IntArray
    tip: IntArray
    rings: Mapping[str, IntArray] = field(default_factory=dict)
    center_rings: tuple[str, ...] = ()
    frame_rings: tuple[str, ...] = ()
    chambers: tuple[GasChamber, ...] = ()
    tip_along: Array | None = None
    copies: tuple[Pose, ...] = ()

    def __post_init__(self) -> None:
        for needed in (membrane.Membranes, Hinges):
            if needed not in self.kinds:
                raise MeshError(f"a body needs its {needed.label}, be there none of them")
        by_kind = sorted(self.elements, key=lambda element: self.kinds.index(type(element)))
        by_kind = _with_neighbours_joined(by_kind)
        object.__setattr__(self, "elements", tuple(by_kind))
        count = len(self.positions)
        groups: dict[str, IntArray] = {
            **{f"{element.label} {k}": element.all_nodes() for k, element in enumerate(by_kind)},
            "base": self.base,
            "tip": self.tip,
            **{f"cap {k}": ring for k, ring in enumerate(self.caps)},
        }
        for name, nodes in groups.items():
            if nodes.size and (nodes.min() < 0 or nodes.max() >= count):
                bad = int(nodes.min() if nodes.min() < 0 else nodes.max())
                raise MeshError(f"{name} refers to node {bad}; there are nodes 0 to {count - 1}")
        for name in (*self.center_rings, *self.frame_rings):
            if name not in self.rings:
                raise MeshError(f"there is no ring {name!r}; there are {', '.join(self.rings) or 'none'}")
        for kind in (kind for kind in self.kinds if kind.single and len(self.of_kind(kind)) > 1):
            raise MeshError(f"{kind.label} are given {len(self.of_kind(kind))} times; a body has them once")
        mass = self.node_mass
        if mass.shape != (count,) or not ((mass >= 0.0) & (mass < np.inf)).all():
            raise MeshError(f"node masses must be {count} finite numbers that are not negative")
        if not np.isfinite(self.positions).all():
            raise MeshError("the drawn shape holds positions that are not finite")
        check_chambers(self.chambers, len(self.triangles), len(self.caps))

    @cached_property
    def kinds(self) -> tuple[type[Element], ...]:
        """The kinds of its elements, in the order in which they are summed."""
        return tuple(dict.fromkeys(type(element) for element in self.elements))

    def of_kind(self, kind: type[_Kind]) -> tuple[_Kind, ...]:
        """Return the elements of a kind."""
        return tuple(element for element in self.elements if isinstance(element, kind))

    def with_elements(self, *elements: Element) -> SoftBody:
        """Return the body with further elements."""
        return replace(self, elements=(*self.elements, *elements))

    def with_other(self, kind: type[_Kind], *elements: _Kind) -> SoftBody:
        """Return the body with all its elements of a kind replaced."""
        rest = tuple(element for element in self.elements if not isinstance(element, kind))
        index = next((k for k, element in enumerate(self.elements) if isinstance(element, kind)), len(rest))
        return replace(self, elements=(*rest[:index], *elements, *rest[index:]))

    @cached_property
    def membranes(self) -> tuple[membrane.Membranes, ...]:
        """Film triangles, material by material."""
        return self.of_kind(membrane.Membranes)

    @cached_property
    def triangles(self) -> IntArray:
        """Nodes (m, 3) of all film triangles, in the order of `membranes`."""
        return rows_of([film.triangles for film in self.membranes])

    @cached_property
    def areas(self) -> Array:
        """Drawn areas (m,) [m^2] of all film triangles."""
        return rows_of([film.areas for film in self.membranes])

    @cached_property
    def hinges(self) -> Hinges:
        """Rotational springs."""
        return self.of_kind(Hinges)[0]

    @cached_property
    def cables(self) -> tuple[cable.Cable, ...]:
        """Routed cables."""
        return self.of_kind(cable.Cable)

    @cached_property
    def frames(self) -> frame_ring.FrameRings | None:
        """Stiff frames around rings, or None."""
        return next((entry for entry in self.of_kind(frame_ring.FrameRings) if not entry.leads_on), None)

    @cached_property
    def plates(self) -> tuple[frame_ring.FrameRings, ...]:
        """Stiff plates, each joining a group of nodes, and the frames beyond them."""
        return tuple(entry for entry in self.of_kind(frame_ring.FrameRings) if entry.leads_on)

    def first_memory(self) -> Array:
        """Return the elements' memory (values,) for the drawn shape, element by element."""
        return np.concatenate([element.first_memory(self.positions) for element in self.elements])

    @cached_property
    def memory_slices(self) -> tuple[slice, ...]:
        """Slice of each element's values in the memory."""
        sizes = [len(element.first_memory(self.positions)) for element in self.elements]
        ends = np.cumsum(sizes).tolist()
        return tuple(slice(end - size, end) for end, size in zip(ends, sizes, strict=True))

    @property
    def gas_chambers(self) -> tuple[GasChamber, ...]:
        """The chambers; a single one for the whole body if none are named."""
        if self.chambers:
            return self.chambers
        return (GasChamber(ONLY_CHAMBER, np.arange(len(self.triangles)), tuple(range(len(self.caps)))),)

    @property
    def enclosures(self) -> list[tuple[IntArray, list[IntArray]]]:
        """Film triangles (t, 3) and caps of each chamber."""
        triangles, caps = self.triangles, self.caps
        return [
            (triangles[chamber.triangles], [caps[k] for k in chamber.caps]) for chamber in self.gas_chambers
        ]

    @classmethod
    def from_arrays(
        cls,
        positions: Array,
        triangles: IntArray,
        film: material.Film | Mapping[str, material.Film],
        **parts: Unpack[BodyParts],
    ) -> SoftBody:
        """Return a body from plain arrays, for meshes from other sources.

        Args:
            positions: (n, 3) [m], stress-free shape of the film.
            triangles: (m, 3), outward orientation.
            film: material of all triangles, or of each face group; triangles are sorted in that order.
            parts: optional parts, see `BodyParts`.

        Raises:
            MeshError: degenerate triangles, unknown nodes, negative masses, a triangle with no film or two.
        """
        unknown = parts.keys() - BodyParts.__annotations__.keys()
        if unknown:
            raise TypeError(f"from_arrays() got an unexpected keyword argument {min(unknown)!r}")
        x = np.array(positions, dtype=np.float64, order="C")
        tri, panel_m = _nodes("triangles", triangles, len(x)), parts.get("wrinkle_panel_m", 0.0)
        films = by_film(tri, film, parts.get("face_groups") or {}, panel_m)
        membranes = [
            membrane.Membranes.from_shape(x, *triangles_film_panel) for triangles_film_panel in films
        ]
        return cls(
            positions=x,
            elements=(*membranes, _hinges(x, parts), *parts.get("cables", ())),
            caps=tuple(_indices(ring) for ring in parts.get("caps", ())),
            closed=parts.get("closed", True),
            node_mass=np.array(np.broadcast_to(parts.get("node_mass", 0.0), (len(x),)), dtype=np.float64),
            base=_indices(parts.get("base")),
            tip=_indices(parts.get("tip")),
            rings=dict(parts.get("rings") or {}),
        )

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return len(self.positions)

    @property
    def mass_kg(self) -> float:
        """Total mass."""
        return float(self.node_mass.sum())

    def strain(self, positions: Array) -> Array:
        """Return the Green strain (m, 3) of all film triangles at (n, 3) [m], see `Membranes.strain`."""
        return rows_of([film.strain(positions) for film in self.membranes])

    def principal_stress(self, positions: Array) -> Array:
        """Return the principal stresses (m, 2) [Pa] of all film triangles, largest first."""
        return rows_of([film.principal_stress(positions) for film in self.membranes])

    def tip_position(self, positions: Array) -> Array:
        """Return the mean of the tip ring (3,) [m]."""
        return np.asarray(positions[self.tip].mean(axis=0))

    @cached_property
    def tip_is_line(self) -> bool:
        """Whether the drawn tip ring encloses no area, as for sheets that are drawn flat."""
        r = self.positions[self.tip]
        following = np.roll(r, -1, axis=0)
        area = cross(r - r[:1], following - r[:1]).sum(axis=0)
        around = np.linalg.norm(following - r, axis=1).sum()
        return bool(np.linalg.norm(area) <= LEAST_TIP_AREA * around**2)

    @property
    def before_tip(self) -> IntArray:
        """Nodes of the last ring on the centre line before the tip."""
        if self.center_rings:
            return self.rings[self.center_rings[-1]]
        return self.rings.get("base", self.base)

    @cached_property
    def tip_way(self) -> tuple[IntArray, Array]:
        """Nodes (k,) and weights (k,) whose sum of w_i r_i is along a tip that is a line.

        With `tip_along`, weights of the linear fit r = c + a u + b v to the film at the tip, u along it and v
        across in the drawn shape: the sum is a, the fitted derivative of the position along the film.
        """
        if self.tip_along is None:
            weights = [np.full(len(self.tip), 1.0 / len(self.tip))]
            weights.append(np.full(len(self.before_tip), -1.0 / len(self.before_tip)))
            return np.concatenate([self.tip, self.before_tip]), np.concatenate(weights)
        nodes = np.unique(self.rings[TIP_END])
        from_mean = self.positions[nodes] - self.positions[nodes].mean(axis=0)
        along = from_mean @ self.tip_along
        across = from_mean - np.outer(along, self.tip_along)
        across = across @ np.linalg.svd(across, full_matrices=False)[2][0]
        return nodes, np.linalg.pinv(np.stack([along, across], axis=1))[0]

    @property
    def tip_measured_by(self) -> str:
        """Definition of the tip's direction, in words."""
        if not self.tip_is_line:
            return "normal of the tip ring"
        if self.tip_along is not None:
            _, weights = self.tip_way
            extent = np.ptp(self.positions[np.unique(self.rings[TIP_END])] @ self.tip_along)
            return f"film of {1e3 * extent:.1f} mm at the tip ({len(weights)} nodes)"
        return f"line from '{self.center_rings[-1] if self.center_rings else 'base'}' to the tip"

    def tip_direction(self, positions: Array) -> Array:
        """Return the unit normal (3,) of the tip ring, pointing away from the body.

        It is that of the ring's vector area, sum_i r_i x r_i+1 / 2, in the order of the cap. For a tip that
        is a line in the drawn shape, see `tip_way`.
        """
        r = positions[self.tip]
        if self.tip_is_line:
            nodes, weights = self.tip_way
            direction = weights @ positions[nodes]
            return np.asarray(direction / np.linalg.norm(direction))
        area = cross(r, r[np.arange(1, len(r) + 1) % len(r)]).sum(axis=0)
        return np.asarray(area / np.linalg.norm(area))


def _with_neighbours_joined(elements: list[Element]) -> list[Element]:
    """Return the elements, with neighbours of a counted kind and the same constants joined."""
    joined: list[Element] = []
    for element in elements:
        last = joined[-1] if joined else None
        if element.counted and type(last) is type(element) and not element.differences(last):
            joined[-1] = element.joined([last, element])
        else:
            joined.append(element)
    return joined


def _nodes(kind: str, values: object, count: int) -> IntArray:
    nodes = _indices(values)
    if nodes.size and (nodes.min() < 0 or nodes.max() >= count):
        raise MeshError(f"{kind} refer to node {int(nodes.max())}; there are nodes 0 to {count - 1}")
    return nodes


def _indices(values: object) -> IntArray:
    """Return a writable copy: for read-only arrays kernels would be compiled a second time."""
    return np.array(() if values is None else values, dtype=np.int64, order="C")


def stored_energy(body: SoftBody, positions: Array) -> dict[type[DirectElement], float]:
    """Return the energy [J] that the elements of each kind store at rest.

    Args:
        body: with the elements.
        positions: (n, 3) [m].
    """
    x = np.array(positions, order="C")  # a writable copy, as kernels need it
    no_slots, unused, no_blocks = np.zeros((0, 0), np.int64), np.zeros_like(x), np.zeros((0, 3, 3))
    energy: dict[type[DirectElement], float] = {}
    for element in body.of_kind(DirectElement):  # type: ignore[type-abstract]
        memory = element.first_memory(body.positions)
        added = element.add(x, no_slots, unused, no_blocks, Instant(memory, memory.copy()))
        energy[type(element)] = energy.get(type(element), 0.0) + added
    return energy


def hinge_energy_share(body: SoftBody, positions: Array) -> float:
    """Return U_hinges / (U_hinges + U_film); 0 without elastic energy.

    Args:
        body: with film and hinges.
        positions: (n, 3) [m].
    """
    energy = stored_energy(body, positions)
    bending, total = energy[Hinges], energy[membrane.Membranes] + energy[Hinges]
    return bending / total if total > _ROUNDING_J else 0.0
