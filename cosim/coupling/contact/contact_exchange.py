"""Contact between the film and the rigid scene: one search per tick, forces on both sides.

Per tick, after MuJoCo's step: the surfaces near the film are found at the new poses and frozen as tangent
planes; the soft step solves with them; what its contact points press with acts on the bodies in MuJoCo's
next step, at the same points, with the opposite sign. Each contact keeps where its stick spring is tied on
the obstacle, and its normal force, which bounds the friction of the next tick.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.state_check import check_indices
from cosim.coupling.contact.contact_arrays import EndRows, MemoryRows, ShapeRows, SurfaceRows, Ties
from cosim.coupling.contact.contact_kernels import conclude, describe
from cosim.coupling.contact.contact_memory import ContactMemory
from cosim.coupling.contact.contact_report import NOTHING_TOUCHED, ContactReport
from cosim.coupling.contact.film_neighbours import FilmNeighbours
from cosim.errors import InputError
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.scene.bodies import Bodies
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.contact_points import ContactSurface, Extent
from cosim.soft.contact.obstacle_contact import ContactPlanes, PlaneRows
from cosim.soft.solve.state import SoftState

_REACH_M = 1e-3  # looked ahead besides what the film moves in a tick
AHEAD_TICKS: Final = 2.0
"""How many ticks' way of the fastest node a film looks ahead."""
_STILL_REACH_M = 3e-3  # the same in statics, where nothing says how far the film will move
BEHIND_M: Final = 5e-3
"""How far behind the film a corner still counts as one that came through it."""
FEATURE_AREA_M2: Final = 5e-5
"""What each stands for: a corner must hold back the film around it by itself."""
NOTHING_BORNE: Final = np.zeros(6)


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
    triangle: Annotated[IntArray, ("k",)]
    points: int
    near: bool


@final
class ContactExchange:
    """Finds contacts, remembers them, and loads the bodies.

    `film_speed_m_s` is that of the film before the step. After a step that touched anything, `film_load` (6,)
    is force and torque of the film on all bodies about the world's origin, summed over its nodes (what
    `settle` reports is summed over contact points), and `held_N_m` (bodies,) the trace of the stiffness of
    the contacts with each body, stick springs slack. `near` is whether the last search had
    anything to look at.

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
        self.neighbours = FilmNeighbours(query, surface)
        self.memory = ContactMemory.empty()
        self.planes: ContactPlanes | None = None
        self.sticking: ContactPlanes | None = None
        none = np.zeros(0, np.int64)
        self._ties = Ties(none, none, np.zeros((0, 3)), none)
        self._points = 0
        self._surface_rows = SurfaceRows(*(getattr(surface, name) for name in SurfaceRows._fields))
        self.shape_rows = ShapeRows(*(getattr(query, name) for name in ShapeRows._fields))
        self.film_load, self.held_N_m = NOTHING_BORNE, np.zeros(bodies.count)
        self.film_speed_m_s, self.near = 0.0, True

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
        reach = self.rest_reach_m + AHEAD_TICKS * extent.speed_m_s * tick_s
        active = self.query.near(extent.low, extent.high, reach)
        self.near = len(active) > 0
        if len(active):
            self.planes = self._planes(state.positions, extent, reach, active)
        if self.planes is None and len(self.memory.key):
            self.memory = ContactMemory.empty()
        return self.planes

    @property
    def rest_reach_m(self) -> float:
        """How far a film at rest looks for shapes."""
        return 0.5 * self.law.smoothing_m + _REACH_M

    @property
    def idle(self) -> bool:
        """Whether nothing was near in the last tick, and nothing is left of what was touched before."""
        return not self.near and self.planes is None and self.sticking is None and not len(self.memory.key)

    def still(self, positions: Array) -> ContactPlanes | None:
        """Return what the film may touch near an equilibrium, without friction; None for nothing.

        Args:
            positions: (n, 3) [m], of the nodes.
        """
        self.query.update()
        extent = Extent.of(positions, np.zeros_like(positions))
        active = self.query.near(extent.low, extent.high, _STILL_REACH_M)
        return self._planes(positions, extent, _STILL_REACH_M, active) if len(active) else None

    @property
    def _held_by(self) -> IntArray:
        """The triangle of the film (features,) that pressed on each feature in the last tick; -1 for none."""
        held = np.full(len(self.query.features.shape), -1)
        features, triangles = self._held(self.memory)
        held[features] = triangles
        return held

    def _held(self, memory: ContactMemory) -> tuple[IntArray, IntArray]:
        """Return the features that a memory holds, and the triangles of the film that press on them."""
        of_features = memory.triangle >= 0
        points = len(self.query.body) * len(self.surface)  # their keys come first
        return memory.key[of_features] - points, memory.triangle[of_features]

    def _planes(self, x: Array, extent: Extent, reach: float, active: IntArray) -> ContactPlanes | None:
        near = self.neighbours.find(x, extent, active, reach, BEHIND_M, self._held_by)
        count = near.count
        if not count:
            return None
        memory, stiffness, surface = self.memory, self.law.stiffness_N_m3, self._surface_rows
        planes, self._ties = PlaneRows.room(count), Ties.room(count)
        self._points = len(near.rows.point)
        described = planes, self._ties
        before = MemoryRows(*(getattr(memory, name) for name in MemoryRows._fields))
        areas = stiffness, stiffness * FEATURE_AREA_M2
        describe(x, near.places, near.rows, surface, self.shape_rows, before, *areas, *described)
        return ContactPlanes(*planes[:-1], law=self.law, body=planes.body)

    def settle(self, positions: Array) -> ContactReport:
        """Take in the end of the soft step: remember the contacts and load the bodies.

        Args:
            positions: (n, 3) [m], of the nodes at the end of the step.
        """
        planes = self.planes
        report = self.nothing_settled() if planes is None else self._conclude(planes, positions)
        self.bodies.apply(report.bodies, report.force, report.torque)
        return report

    def nothing_settled(self) -> ContactReport:
        """Take in a step in which nothing could be touched."""
        self.sticking, self.film_load = None, NOTHING_BORNE
        return NOTHING_TOUCHED

    def _conclude(self, planes: ContactPlanes, positions: Array) -> ContactReport:
        count, bodies, law = len(planes), self.bodies.count, self.law
        end, kept = EndRows.room(count, bodies), MemoryRows.room(count)
        pressing = conclude(
            positions, planes.rows, self._ties, self._points, self.shape_rows, law.smoothing_m, law.stick_m,
            kept, end,
        )  # fmt: skip
        self.memory = ContactMemory(
            kept.key[:pressing], kept.normal_force[:pressing], kept.offset[:pressing], kept.place[:pressing],
            kept.triangle[:pressing],
        )  # fmt: skip
        return self._ended(planes, end)

    def _ended(self, planes: ContactPlanes, end: EndRows) -> ContactReport:
        self.sticking = planes.sticking(end.point, end.slack_friction)
        self.held_N_m, self.film_load = end.held, end.film
        acting = np.flatnonzero(end.acting)
        force, torque = end.loads[acting, :3], end.loads[acting, 3:]
        return ContactReport(acting, force, torque, len(self.memory.key), *end.figures.tolist())

    def go_to(self, rows: PlaneRows, ties: Ties, points: int, end: EndRows) -> ContactReport:
        """Be at the end of steps that were taken elsewhere; bodies and `memory` are there; return the report.

        Args:
            rows: contacts of the last step.
            ties: theirs.
            points: how many of them are of points of the film.
            end: what is left of them.
        """
        planes = self.planes = ContactPlanes(*rows[:-1], law=self.law, body=rows.body)
        self._ties, self._points = ties, points
        return self._ended(planes, end)

    def save_state(self) -> ContactState:
        """Return what the next tick depends on; nothing is copied, no array is written to in place."""
        return ContactState(self.memory, self.planes, self.sticking, *self._ties, self._points, self.near)

    def restore_state(self, state: ContactState) -> None:
        """Return to a state of `save_state`; the scene has been restored before."""
        self.memory, self.planes, self.sticking = state.memory, state.planes, state.sticking
        self._ties, self._points = Ties(state.shape, state.key, state.carrier, state.triangle), state.points
        self.near = state.near
        self.query.update()

    def check_state(self, state: ContactState) -> None:
        """Check what a saved state names: `restore_state` takes it for granted.

        Raises:
            InputError: there is no such node or shape.
        """
        check_indices(state.shape, len(self.query.body), "shapes")
        features, triangles = self._held(state.memory)
        check_indices(features, len(self.query.features.shape), "features")
        check_indices(triangles, len(self.surface.triangles), "triangles")
        for planes in (state.planes, state.sticking):
            if planes is None:
                continue
            if len(planes) != len(state.shape) or not 0 <= state.points <= len(planes):
                raise InputError(f"the saved contacts are {len(planes)}, of {len(state.shape)} shapes")
            self.surface.check_planes(planes)
