"""Contact of a soft body with itself (units, fingers, films of a unit), and with the flange.

The pairs of points and triangles are constant within a step, or a round of a static solution; their distances
and normals are exact. Modelled are the outside of the film, between units of one body; its inside, between
faces of one unit, as the outside of the film turned inside out; and the flange's face against the films next
to it. A face folded onto itself is not modelled.
"""

from dataclasses import dataclass, replace
from typing import Final, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import kernel, small_matrix, small_vector, unchecked
from cosim.errors import InputError
from cosim.soft.body.body import SoftBody
from cosim.soft.contact import contact_law
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.film_lists import FilmLists
from cosim.soft.contact.flange_face import FlangeFace, fill_before_face
from cosim.soft.contact.rigid_motion import furthest_from_mean
from cosim.soft.contact.self_contact_faces import FilmFaces, FilmPoints
from cosim.soft.contact.self_contact_pairs import FilmMemory, FilmPairs, PairRows
from cosim.soft.contact.self_contact_search import BEHIND_M
from cosim.soft.contact.triangle_foot import feet, fill_point, fill_slopes, fill_weights, plane_of
from cosim.soft.solve.state import SoftState

_STEP_REACH_M = 0.25e-3  # reach of the search for a film at rest that starts to move
LOOKAHEAD_STEPS: Final = 2.0
"""Reach of the search, in steps of the fastest node's motion relative to the mean."""
THROUGH_M: Final = 1.5e-3
"""Depth behind a film up to which points are found after a step of slow films."""
_STATIC_REACH_M = 3e-3  # reach of the search in statics, where the motion is not known
_FROM_EACH_SIDE = 0.5  # fraction of the stiffness: points of both films count


@final
@dataclass(frozen=True)
class FilmContactLaw:
    """How films press and rub on each other.

    Args:
        law: normal and sticking forces, as on an obstacle.
        friction: coefficient of sliding.
        throughout: whether every solution includes contact; otherwise a solution of films that did not press
            before is first tried without contact, and repeated with it if they press at its end.
        inside: whether contact inside a unit, and with the flange's face, is modelled.

    Raises:
        InputError: the coefficient is negative, or not a number.
    """

    law: ContactLaw
    friction: float = 0.5
    throughout: bool = True
    inside: bool = True

    def __post_init__(self) -> None:
        if not self.friction >= 0.0:
            raise InputError(f"contact: the friction coefficient is {self.friction}; it must not be negative")


class ContactRows(NamedTuple):
    """Points and triangles of all contacts: outside, inside, and before the flange's face.

    Args:
        nodes: (p, 3), nodes of each point's triangle.
        weights: (p, 3), barycentric.
        stiffness: (p,) [N/m].
        spare: (p,) [m], see `contact_law.spare`.
        key: (p,), first key of each point's pairs.
        triangles: (t, 3).
        offset: (t,), added to the key of the point; the same for all triangles of a unit.
    """

    nodes: IndexTable
    weights: Matrix
    stiffness: Vector
    spare: Vector
    key: Indices
    triangles: IndexTable
    offset: Indices

    @classmethod
    def of(cls, outside: FilmLists, inside: FilmLists, face: FlangeFace, stiffness: Array) -> "ContactRows":
        """Return the rows of a film, with the stiffness (p,) of all points."""
        rows, b = (outside.rows, inside.rows), len(face.nodes)
        units = [len(lists.units.start) - 1 for lists in (outside, inside)]
        counts = np.repeat([*units, 1], [*(len(lists.nodes) for lists in rows), b])
        return cls(
            np.concatenate([*(lists.nodes for lists in rows), face.nodes]),
            np.concatenate([*(lists.weights for lists in rows), face.weights]), stiffness,
            np.concatenate([*(lists.spare for lists in rows), face.spare]),
            np.cumsum(counts) - counts,
            np.concatenate([*(lists.triangles for lists in rows), face.corners]),
            np.concatenate([*(lists.films[:, 1] for lists in rows), np.zeros(b, np.int64)]),
        )  # fmt: skip


@kernel
def describe_pairs(x: Matrix, rows: ContactRows, hits: IndexTable, pairs: PairRows, key: Indices) -> None:
    """Fill pairs at the start of a step, without friction.

    Args:
        x: (n, 3) [m], before the step.
        rows: points and triangles.
        hits: (k, 2), points and the triangles near them.
        pairs: (k,), filled.
        key: (k,) ascending, filled; identifies pairs of point and unit, or inside of point and face.
    """
    y, slope = small_vector(3), small_matrix(3, 3)
    for e in range(hits.shape[0]):
        p, t, nodes, normal, foot = hits[e, 0], hits[e, 1], pairs.nodes[e], pairs.normal[e], pairs.foot[e]
        for r in range(3):
            nodes[r], nodes[3 + r] = rows.nodes[p, r], rows.triangles[t, r]
            pairs.weights[e, r], pairs.stretch[e, r] = rows.weights[p, r], 0.0
        key[e] = rows.key[p] + rows.offset[t]
        pairs.stiffness[e], pairs.friction[e], pairs.spare[e] = rows.stiffness[p], 0.0, rows.spare[p]
        fill_point(x, nodes, pairs.weights[e], y)
        fill_slopes(x, nodes[3:], normal, plane_of(x, nodes[3:], normal), slope)
        fill_weights(x, nodes[3:], slope, y, foot)


@kernel
def restore_friction(key: Indices, pressed: Indices, force: Vector, stretch: Matrix, pairs: PairRows) -> None:
    """Fill friction and stretch of the pairs that have pressed before.

    Args:
        key: (k,) ascending, of the pairs.
        pressed: (m,) ascending, keys of the pairs that pressed in the last step.
        force: (m,) [N], their largest friction force.
        stretch: (m, 3) [m], of their stick springs.
        pairs: (k,), filled.
    """
    k = 0
    for e in range(key.shape[0]):
        while k < pressed.shape[0] and pressed[k] < key[e]:
            k += 1
        if k < pressed.shape[0] and pressed[k] == key[e]:
            pairs.friction[e] = force[k]
            for r in range(3):
                pairs.stretch[e, r] = stretch[k, r]


def _inner_lists(faces: FilmFaces, body: SoftBody, law: ContactLaw) -> tuple[FilmLists, Array]:
    """Return the lists of a film's inside, and the area (p,) [m^2] of its points.

    Points of films that are drawn closer than the contact distance get a spare distance, so that they do not
    press as drawn. Points next to a seam do not press at all.
    """
    inside, x = faces.inside_out, body.positions
    points = FilmPoints.of(inside, x)
    lists = FilmLists(inside, points, body)
    if not inside.can_meet:
        return lists, points.area
    reach_m = law.smoothing_m
    hits = lists.over(x, reach_m, BEHIND_M, max(reach_m, BEHIND_M), moves=False)
    point, rows = hits[:, 0], lists.rows
    nodes = np.concatenate((rows.nodes[point], rows.triangles[hits[:, 1]]), axis=1)
    distance = feet(x, nodes, rows.weights[point])[2]
    np.maximum.at(rows.spare, point, contact_law.spare(distance, law))
    # at a creased seam, points are behind the planes of the other film without penetrating it
    rows.spare[np.isin(rows.nodes, faces.seam_nodes).any(axis=1)] = np.inf
    return lists, points.area


@final
class SelfContact:
    """Finds the pairs of films that may touch; `work_J` is their work on the film in the last step.

    Args:
        body: with the films.
        law: of contact.
    """

    def __init__(self, body: SoftBody, law: FilmContactLaw) -> None:
        self.law, self.faces, self._friction = law.law, FilmFaces.of(body), law.friction
        self.throughout, self.work_J = law.throughout, 0.0
        self._last: tuple[SoftState, float, FilmPairs | None] | None = None  # of the last step
        points = FilmPoints.of(self.faces, body.positions)
        self.outside = FilmLists(self.faces, points, body)
        self.inside, inner_area = _inner_lists(self.faces, body, self.law)
        self._face = FlangeFace.of(body, self.faces, points, self.law)
        if not law.inside:
            self.inside.can_meet = False
            self._face = FlangeFace._make(column[:0] for column in self._face)
        film = _FROM_EACH_SIDE * self.law.stiffness_N_m3 * np.concatenate((points.area, inner_area))
        stiffness = np.concatenate((film, self._face.stiffness))
        self._rows = ContactRows.of(self.outside, self.inside, self._face, stiffness)
        self._widths, inner = self.law.widths, self.inside.rows
        outer, self._before_face = self.outside.rows, np.zeros(len(self._face.nodes), np.int64)
        first = np.array([len(outer.nodes), len(outer.triangles)])
        last = first + np.array([len(inner.nodes), len(inner.triangles)])
        self._first = first, last  # first point and triangle inside, and of the flange's face
        self.can_touch = self.outside.can_meet or self.faces.inside_out.can_meet or len(self._face.nodes) > 0
        """Whether films can touch one another or the flange at all."""

    @property
    def rest_m(self) -> float:
        """Reach of the search in a step of films at rest."""
        return self.law.onset_m + _STEP_REACH_M

    def is_deferred(self, state: SoftState) -> bool:
        """Return whether a solution from a state is first tried without contact.

        Args:
            state: at the start.
        """
        return not self.throughout and state.touching is None

    def presses(self, end: SoftState, step_s: float) -> bool:
        """Return whether films press on one another at the end of a step without contact.

        Args:
            end: of the step.
            step_s: length [s].
        """
        return self._presses(end.positions, end.velocities, LOOKAHEAD_STEPS * step_s, THROUGH_M)

    def presses_at_rest(self, positions: Array) -> bool:
        """Return whether films press on one another at positions (n, 3) [m], or have passed through."""
        return self._presses(positions, np.zeros_like(positions), 0.0, BEHIND_M)

    def _presses(self, x: Array, velocities: Array, ahead_s: float, through_m: float) -> bool:
        fast = ahead_s > 0.0 and ahead_s * furthest_from_mean(velocities) > through_m
        reach_m, behind_m = self.law.onset_m, BEHIND_M if fast else through_m
        room_m, bounds = max(reach_m, BEHIND_M), (through_m, behind_m)
        for lists in (self.outside, self.inside):
            if lists.can_meet and lists.presses(x, reach_m, bounds, room_m, moves=ahead_s > 0.0):
                return True
        return fill_before_face(x, self._face, reach_m, behind_m, self._before_face[:0]) > 0

    def step_pairs(self, state: SoftState, step_s: float) -> FilmPairs | None:
        """Return the possible pairs in a step; None for none.

        Args:
            state: before the step.
            step_s: length [s].
        """
        last = self._last
        if last is None or last[0] is not state or last[1] != step_s:  # steps may be repeated
            x, reach_m = state.positions, self.rest_m
            reach_m += LOOKAHEAD_STEPS * step_s * furthest_from_mean(state.velocities)
            last = self._last = state, step_s, self._find(x, reach_m, state.touching)
        return last[2]

    def static_pairs(
        self, positions: Array, held: FilmPairs | None = None, slack: float = 0.0
    ) -> FilmPairs | None:
        """Return the possible pairs near an equilibrium, without friction; None for none.

        Args:
            positions: (n, 3) [m].
            held: pairs of the last round, which keep their triangle while their foot is on it.
            slack: barycentric weight by which a foot may be beyond the triangle's edges.
        """
        near_pairs = self._find(positions, _STATIC_REACH_M, None)
        if held is None:
            return near_pairs
        valid = held.holding(positions, slack, _STATIC_REACH_M)
        key, triangle = held.key[valid], held.triangle[valid]
        if near_pairs is not None:
            # of two triangles of one unit the first counts, which is that of the last round
            key, first = np.unique(np.concatenate([key, near_pairs.key]), return_index=True)
            triangle = np.concatenate([triangle, near_pairs.triangle])[first]
        if not len(key):
            return None
        return self._pairs(key, triangle, positions)

    def same_pairs(self, pairs: FilmPairs, positions: Array) -> FilmPairs:
        """Return the same pairs for this body, which has the same triangles but another drawn shape.

        Args:
            pairs: without friction.
            positions: (n, 3) [m].
        """
        return self._pairs(pairs.key, pairs.triangle, positions)

    def _pairs(self, key: IntArray, triangle: IntArray, positions: Array) -> FilmPairs:
        rows = self._rows
        point = np.searchsorted(rows.key, key, side="right") - 1
        nodes = np.concatenate((rows.nodes[point], rows.triangles[triangle]), axis=1)
        pairs = FilmPairs.slack(
            key, triangle, nodes, rows.weights[point], rows.stiffness[point], self.law, positions
        )
        return replace(pairs, rows=pairs.rows._replace(spare=rows.spare[point]))

    def _find(self, x: Array, reach_m: float, before: FilmMemory | None) -> FilmPairs | None:
        """Return the pairs within reach, with friction for those that pressed in the last step."""
        hits = self._hits(x, reach_m)
        count = len(hits)
        if not count:
            return None
        key, pairs = np.empty(count, np.int64), PairRows.empty(count, self._widths)
        unchecked(describe_pairs)(x, self._rows, hits, pairs, key)
        if before is not None:
            unchecked(restore_friction)(
                key, before.key, self._friction * before.normal_force, before.stretch, pairs
            )
        return FilmPairs(key, hits[:, 1], pairs)

    def _hits(self, x: Array, reach_m: float) -> IntArray:
        """Return rows (k, 2) of points and the triangles near them."""
        hit_rows, room_m = [], max(reach_m, BEHIND_M)
        for lists, shift in ((self.outside, 0), (self.inside, self._first[0])):
            if lists.can_meet:
                hits = lists.over(x, reach_m, BEHIND_M, room_m, moves=True)
                if len(hits):
                    hit_rows.append(hits + shift)
        count = unchecked(fill_before_face)(x, self._face, reach_m, BEHIND_M, self._before_face)
        if count:
            hit_rows.append(self._before_face[:count, None] + self._first[1])
        if len(hit_rows) == 1:
            return hit_rows[0]
        return np.concatenate(hit_rows) if hit_rows else np.zeros((0, 2), np.int64)
