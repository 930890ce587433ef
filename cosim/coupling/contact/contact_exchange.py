"""Contact between the film and the rigid scene: one search per tick, forces on both sides.

Per tick, after MuJoCo's step: the surfaces near the film are found at the new poses and frozen as tangent
planes; the soft step solves with them; what its contact points press with acts on the bodies in MuJoCo's
next step, at the same points, with the opposite sign. Each contact keeps where its stick spring is tied on
the obstacle, and its normal force, which bounds the friction of the next tick.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, final

import numpy as np

from cosim.base.frames import Array, IntArray, cross
from cosim.base.state_check import check_indices
from cosim.coupling.contact.contact_report import NOTHING_TOUCHED, ContactReport
from cosim.errors import InputError
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.distance.features import near_film
from cosim.rigid.scene.bodies import Bodies
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.contact_points import ContactSurface, Extent
from cosim.soft.contact.obstacle_contact import ContactForces, ContactPlanes
from cosim.soft.elements.element import Sums
from cosim.soft.solve.state import SoftState

_REACH_M = 1e-3  # looked ahead besides what the film moves in a tick
_STILL_REACH_M = 3e-3  # the same in statics, where nothing says how far the film will move
_BEHIND_M = 5e-3  # how far behind the film a corner still counts as one that came through it
_FEATURE_AREA_M2 = 5e-5  # each stands for: a corner must hold back the film around it by itself


@final
@dataclass(frozen=True)
class ContactMemory:
    """What contacts carry from one tick to the next.

    Args:
        key: (k,) ascending; names the pair of contact point and shape.
        normal_force: (k,) [N].
        offset: (k, 3) [m], shape frame: from where the shape carries the point to the anchor.
        place: (k, 3) [m], world: for features, where they were; for points of the film, not used.
    """

    key: Annotated[IntArray, ("k",)]
    normal_force: Annotated[Array, ("k",)]
    offset: Annotated[Array, ("k", 3)]
    place: Annotated[Array, ("k", 3)]

    @classmethod
    def empty(cls) -> ContactMemory:
        """Return the memory of no contact."""
        return cls(np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))

    def look_up(self, key: IntArray) -> tuple[IntArray, IntArray]:
        """Return (places in `key`, places in memory) of the pairs that are remembered."""
        at = np.searchsorted(self.key, key)
        inside = np.flatnonzero(at < len(self.key))
        same = inside[self.key[at[inside]] == key[inside]]
        return same, at[same]


@final
@dataclass(frozen=True)
class ContactState:
    """Where an exchange is: the arguments are its attributes of these names."""

    memory: ContactMemory
    planes: ContactPlanes | None
    sticking: ContactPlanes | None
    shape: Annotated[IntArray, ("k",)]
    key: Annotated[IntArray, ("k",)]
    carrier: Annotated[Array, ("k", 3)]
    points: int


@final
class ContactExchange:
    """Finds contacts, remembers them, and loads the bodies; `film_speed_m_s` is that before the step.

    Args:
        query: distances to what can be touched.
        bodies: of the scene.
        surface: of the soft body.
        law: of contact.
    """

    def __init__(
        self, query: ContactQuery, bodies: Bodies, surface: ContactSurface, law: ContactLaw | None = None
    ) -> None:
        self.query, self.bodies, self.surface = query, bodies, surface
        self.law = law or ContactLaw()
        self.memory = ContactMemory.empty()
        self.planes: ContactPlanes | None = None
        self.sticking: ContactPlanes | None = None
        self.shape: IntArray = np.zeros(0, np.int64)
        self._key: IntArray = np.zeros(0, np.int64)
        self._carrier: Array = np.zeros((0, 3))
        self._points = 0
        self.film_speed_m_s = 0.0

    def find(self, state: SoftState, tick_s: float) -> ContactPlanes | None:
        """Return what the film may touch in the coming step; None for nothing.

        Args:
            state: of the soft body before the step.
            tick_s: length of the step [s].
        """
        self.planes = None
        self.query.update()
        extent = Extent.of(state.positions, state.velocities)
        self.film_speed_m_s = extent.speed_m_s
        reach = 0.5 * self.law.smoothing_m + _REACH_M + 2.0 * extent.speed_m_s * tick_s
        active = self.query.near(extent.low, extent.high, reach)
        if len(active):
            self.planes = self._planes(state.positions, extent, reach, active)
        if self.planes is None and len(self.memory.key):
            self.memory = ContactMemory.empty()
        return self.planes

    def still(self, positions: Array) -> ContactPlanes | None:
        """Return what the film may touch near an equilibrium, without friction; None for nothing.

        Args:
            positions: (n, 3) [m], of the nodes.
        """
        self.query.update()
        extent = Extent.of(positions, np.zeros_like(positions))
        active = self.query.near(extent.low, extent.high, _STILL_REACH_M)
        return self._planes(positions, extent, _STILL_REACH_M, active) if len(active) else None

    def _planes(self, x: Array, extent: Extent, reach: float, active: IntArray) -> ContactPlanes | None:
        surface, query = self.surface, self.query
        points = surface.points(x)
        hits = query.distances(points, reach, active)
        chosen = query.features.of(active)
        places = query.feature_positions(chosen)
        around = ((places > extent.low - reach) & (places < extent.high + reach)).all(axis=1)
        chosen, places = chosen[around], places[around]
        film = near_film(places, x, surface.triangles, reach, _BEHIND_M)
        if not len(hits) + len(film):
            return None
        feature = chosen[film.point]
        self.shape = np.concatenate([hits.shape, query.features.shape[feature]])
        self._points = len(hits)
        self._key = np.concatenate([hits.shape * len(surface) + hits.point, feature + self._first_feature])
        nodes = np.concatenate([surface.nodes[hits.point], surface.triangles[film.triangle]])
        weights = np.concatenate([surface.weights[hits.point], film.weight])
        slots = np.concatenate([surface.slots[hits.point], surface.triangle_slots[film.triangle]])
        normal = np.concatenate([hits.normal, -film.normal])
        distance = np.concatenate([hits.distance, film.distance])
        area = np.concatenate([surface.area[hits.point], np.full(len(film), _FEATURE_AREA_M2)])
        touched = np.concatenate(
            [points[hits.point], np.einsum("ka,kar->kr", film.weight, x[surface.triangles[film.triangle]])]
        )
        self._carrier = np.concatenate([query.position[hits.shape], places[film.point]])
        anchor, normal_force = self._recall(touched)
        return ContactPlanes(
            nodes=nodes,
            weights=weights,
            slots=slots,
            normal=normal,
            offset=np.einsum("kr,kr->k", normal, touched) - distance,
            stiffness=self.law.stiffness_N_m3 * area,
            friction=query.friction[self.shape] * normal_force,
            anchor=anchor,
            law=self.law,
            body=query.body[self.shape],
        )

    @property
    def _first_feature(self) -> int:
        return len(self.query) * len(self.surface)

    def _recall(self, touched: Array) -> tuple[Array, Array]:
        """Return anchors (k, 3) [m] and normal forces (k,) [N] of the last tick; new ones start afresh."""
        memory, anchor, normal_force = self.memory, touched.copy(), np.zeros(len(touched))
        here, there = memory.look_up(self._key)
        if len(here):
            turned = np.einsum("krs,ks->kr", self.query.rotation[self.shape[here]], memory.offset[there])
            # the anchor of a point of the film rides on the shape; a feature has moved under the film,
            # whose point there is another one than before: the stretch goes on from where it was
            moved = self._carrier[here] - memory.place[there]
            film = here < self._points
            anchor[here] = turned + np.where(film[:, None], self._carrier[here], touched[here] + moved)
            normal_force[here] = memory.normal_force[there]
        return anchor, normal_force

    def settle(self, positions: Array) -> ContactReport:
        """Take in the end of the soft step: remember the contacts and load the bodies.

        Args:
            positions: (n, 3) [m], of the nodes at the end of the step.
        """
        if self.planes is None:
            self.sticking = None
            report = NOTHING_TOUCHED
        else:
            found = self.planes.at(positions)
            self.sticking = self.planes.sticking(found, self.query.friction[self.shape])
            self._remember(self.planes, found)
            report = ContactReport.of(self.planes, found)
        self.bodies.apply(report.bodies, report.force, report.torque)
        return report

    def film_load(self, positions: Array) -> Array:
        """Return the force and torque (6,) of the film on all bodies, summed over its nodes (n, 3) [m].

        About the world's origin. What `settle` reports is summed over contact points instead.
        """
        gradient = np.zeros_like(positions)
        if self.planes is not None:
            self.planes.add(positions, Sums(gradient), hessian=False)
        return np.concatenate([gradient.sum(axis=0), cross(positions, gradient).sum(axis=0)])

    def save_state(self) -> ContactState:
        """Return what the next tick depends on; nothing is copied, no array is written to in place."""
        return ContactState(
            self.memory, self.planes, self.sticking, self.shape, self._key, self._carrier, self._points
        )

    def restore_state(self, state: ContactState) -> None:
        """Return to a state of `save_state`; the scene has been restored before."""
        self.memory, self.planes, self.sticking = state.memory, state.planes, state.sticking
        self.shape, self._key = state.shape, state.key
        self._carrier, self._points = state.carrier, state.points
        self.query.update()

    def check_state(self, state: ContactState) -> None:
        """Check what a saved state names: `restore_state` takes it for granted.

        Raises:
            InputError: there is no such node or shape.
        """
        check_indices(state.shape, len(self.query.body), "shapes")
        for planes in (state.planes, state.sticking):
            if planes is None:
                continue
            if len(planes) != len(state.shape) or not 0 <= state.points <= len(planes):
                raise InputError(f"the saved contacts are {len(planes)}, of {len(state.shape)} shapes")
            self.surface.check_planes(planes)

    def _remember(self, planes: ContactPlanes, found: ContactForces) -> None:
        film = np.arange(len(planes)) < self._points
        anchor = planes.dragged_anchor(found)
        offset = anchor - np.where(film[:, None], self._carrier, found.point)
        local = np.einsum("ksr,ks->kr", self.query.rotation[self.shape], offset)
        kept = found.normal_force > 0.0
        self.memory = ContactMemory(
            self._key[kept], found.normal_force[kept], local[kept], self._carrier[kept]
        )
