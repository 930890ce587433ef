"""Contact between the film and the rigid scene: one search per tick, forces on both sides.

Per tick, after MuJoCo's step: the surfaces near the film are found at the new poses and frozen as tangent
planes; the soft step solves with them; what its contact points press with acts on the bodies in MuJoCo's
next step, at the same points, with the opposite sign. Each contact keeps where its stick spring is tied on
the obstacle, and its normal force, which bounds the friction of the next tick. Kernels do all of this, for
ticks that they take by themselves as well; here is what they act on, and the lists of what is near, made
again where they are no longer valid.
"""

import logging
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Final, final

import numpy as np

from cosim.base import compilation
from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import nothing_of
from cosim.base.kernels import RecordStore, address_of
from cosim.base.state import check_indices
from cosim.coupling.contact import contact_arrays, contact_kernels, search_kernels
from cosim.coupling.contact.contact_arrays import AGE, REMEMBERED, TOUCHES, ContactArrays, MemoryRows, Search
from cosim.coupling.contact.contact_kernels import contact_calls, find_touched, settle_touched
from cosim.coupling.contact.contact_report import NOTHING_TOUCHED, ContactMemory, ContactReport
from cosim.rigid.distance import film_distance, signed_distance
from cosim.rigid.scene.bodies import Bodies
from cosim.soft.contact import obstacle_contact
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.contact_points import ContactSurface, Extent
from cosim.soft.contact.obstacle_contact import ContactPlanes, PlaneRows, TouchedPlanes, add_contacts
from cosim.soft.solve.state import SoftState

BEHIND_M: Final = 5e-3
"""How far behind the film a corner still counts as one that came through it."""
FEATURE_AREA_M2: Final = 5e-5
"""What each represents: a corner must hold back the film around it by itself."""
RENEW_ABOVE: Final = 1.2
"""Growth of the contacts' own stiffness beyond which bodies are weighed: the film's grows at most as much."""
HIT_WAY_M: Final = 1e-3
"""Way of a body in a step, beyond which its hit is not resolved: forces hang on the step."""
HIT_SHARE: Final = 0.1
"""The same as a share of the body's size."""
GLUE_N_m: Final = 1e5
"""Stiffness of the spring by which a node is glued: under 1 N it gives by 10 um."""
_WHERE_NEAR = contact_arrays, contact_kernels, film_distance, obstacle_contact, search_kernels  # kernels
_REACH_M = 1e-3  # looked ahead besides what the film moves in a tick
_STILL_REACH_M = 3e-3  # the same in statics, where nothing says how far the film will move
_MARGIN_M = 8e-3  # more of it lengthens the lists, less makes them anew more often


@final
@dataclass(frozen=True)
class ContactState:
    """Where an exchange is.

    Args:
        memory: contacts that press.
        planes: what might have been touched in the last step; None for nothing.
        age: ticks of contact since bodies were weighed.
        centers: (bodies, 3) [m], of masses, where the film has met them.
        force: (touched nodes, 3) [N], on the film.
        past: (bodies, 12), loads on bodies before those that act, see `ContactArrays`.
    """

    memory: ContactMemory
    planes: ContactPlanes | None
    age: int
    centers: Annotated[Array, ("bodies", 3)]
    force: Annotated[Array, ("touched nodes", 3)]
    past: Annotated[Array, ("bodies", 12)]
    pressing: Annotated[Array, ("bodies",)]


@final
class ContactExchange:
    """Finds contacts, remembers them, and loads the bodies.

    After a step, `planes` are the contacts that it was taken with, and `sticking` the same with slack stick
    springs; `report` says what they did.

    Args:
        query: distances to what can be touched.
        bodies: of the scene.
        surface: of the soft body.
        law: of contact.
        glued: (k,) nodes of the film and the body that they are glued to, each where it is; None for none.
    """

    def __init__(
        self,
        query: signed_distance.ContactQuery,
        bodies: Bodies,
        surface: ContactSurface,
        law: ContactLaw | None = None,
        glued: tuple[IntArray, int] | None = None,
    ) -> None:
        self.query, self.bodies, self.surface = query, bodies, surface
        self.law = law or ContactLaw()
        nodes, body = glued or (np.zeros(0, np.int64), 0)
        # the surface's first points are its nodes, ascending
        points = np.searchsorted(surface.nodes[surface.weights[:, 0] == 1.0, 0], nodes)
        self._glue = contact_arrays.Glue(
            points, np.zeros((len(nodes), 3)), np.array([body]), GLUE_N_m, bodies.positions, bodies.axes
        )
        self._places = np.zeros((len(surface), 3))
        nothing: contact_arrays.ListRows = nothing_of(contact_arrays.ListRows)
        nowhere = nothing._replace(row=np.full(len(query), -1))
        self._store = RecordStore(ContactArrays)
        self._meets = len(nodes) > 0
        self.arrays = self._first_arrays(self._searching(nowhere))

    @property
    def at(self) -> int:
        """Address at which kernels read `arrays`, until these change."""
        return self._store.address(self.arrays)

    def glue(self, positions: Array) -> None:
        """Glue the film's nodes where they are at positions (n, 3) [m]."""
        glue = self._glue
        body = glue.body[0]
        here = positions[self.surface.nodes[glue.point, 0]]
        glue.place[:] = (here - glue.position[body]) @ glue.axes[body].reshape(3, 3)

    def find(self, state: SoftState, tick_s: float) -> ContactPlanes | None:
        """Return what the film may touch in the coming step; None for nothing.

        Args:
            state: of the soft body before the step.
            tick_s: length of the step [s].
        """
        return self._found(
            state.positions, state.velocities, self.rest_reach_m, contact_arrays.AHEAD_TICKS * tick_s
        )

    def still(self, positions: Array) -> ContactPlanes | None:
        """Return what the film may touch near an equilibrium, without friction; None for nothing.

        Args:
            positions: (n, 3) [m], of the nodes.
        """
        return self._found(positions, np.zeros_like(positions), _STILL_REACH_M, 0.0)

    def may_give_way(self) -> tuple[bool, bool]:
        """Return whether a body that was found may give way, and whether it is known how all of them do."""
        arrays = self.arrays
        near = arrays.touched.planes.body[: arrays.counts[TOUCHES]]
        near = near[arrays.bodies.leads.ahead[near] > 0]
        if not len(near):
            return False, True
        unknown = (arrays.gives[near, 0] == contact_arrays.UNKNOWN) & (arrays.bodies.loaded[near] != 0)
        return True, not unknown.any()

    def settle(self, before: Array, positions: Array) -> ContactReport:
        """Take in the end of the soft step: remember the contacts and load the bodies.

        Args:
            before: (n, 3) [m], of the nodes at the beginning of the step.
            positions: (n, 3) [m], the same at its end.
        """
        if self._meets:
            settle_touched(self.at, before, positions)
        planes = self.planes
        self.forget()
        self.planes = planes
        return self.report

    def move(self, contacts: IntArray, shift: Array) -> None:
        """Let contacts (k,) of what was found go by a shift (k, 3) [m] with their bodies."""
        self.forget()
        planes = self.arrays.touched.planes
        planes.offset[contacts] += np.einsum("kr,kr->k", planes.normal[contacts], shift)
        planes.anchor[contacts] += shift
        self.arrays.ties.carrier[contacts] += shift

    def ahead(self, bodies: IntArray, loads: Array, tick_s: float) -> Array:
        """Return how far bodies will be ahead (b, 6), see `Leads.lead`.

        Args:
            bodies: (b,).
            loads: (6 b,), about their centres of mass, instead of those that act now.
            tick_s: length of MuJoCo's step [s].
        """
        leads, applied = self.arrays.bodies.leads, self.bodies.applied
        before = applied[bodies]
        applied[bodies] = loads.reshape(-1, 6)
        contact_arrays.foresee(leads, tick_s)
        applied[bodies] = before
        return leads.lead[bodies]

    def held_way(self, bodies: IntArray, loads: Array, tick_s: float) -> Array:
        """Return how bodies give way (6 b, 6 b) under loads, see `ahead`, with all that holds them then."""
        applied = self.bodies.applied
        before = applied[bodies]
        applied[bodies] = loads.reshape(-1, 6)
        mobility = self.bodies.way_s2(tick_s) * self.bodies.mobility(bodies, held=True)
        applied[bodies] = before
        return mobility

    def fastest_m_s(self, state: SoftState) -> float:
        """Return how fast the film comes on to what can move, or what it presses on moves on the flange."""
        if not self._meets:
            return 0.0
        return float(contact_kernels.fastest_touched(self.at, state.positions, state.velocities))

    @property
    def rest_reach_m(self) -> float:
        """How far a film at rest looks for shapes."""
        return 0.5 * self.law.smoothing_m + _REACH_M

    @property
    def asks_for_weighing(self) -> bool:
        """Whether `LightBodies` has to weigh bodies after the last step."""
        return self.asks_for_heavy or bool(
            self.arrays.counts[contact_arrays.MET] >= self.arrays.numbers.renewed_after
        )

    @property
    def asks_for_heavy(self) -> bool:
        """Whether these are heavy ones."""
        return bool(self.arrays.counts[contact_arrays.ASKS])

    def ask_for_weighing_after(self, ticks: int) -> None:
        """Let heavy bodies be weighed after so many ticks of contact, where nothing else asks for it."""
        self.arrays = self.arrays._replace(numbers=self.arrays.numbers._replace(renewed_after=ticks))

    def forget(self) -> None:
        """Read again what kernels have filled meanwhile."""
        for name in ("planes", "sticking", "report"):
            self.__dict__.pop(name, None)

    @cached_property
    def planes(self) -> ContactPlanes | None:
        """Contacts of the last step; None for none."""
        count = int(self.arrays.counts[TOUCHES])
        if not count:
            return None
        rows = PlaneRows(*(part[:count].copy() for part in self.arrays.touched.planes))  # type: ignore[arg-type]
        return ContactPlanes(*rows[:-1], law=self.law, body=rows.body)

    @cached_property
    def sticking(self) -> ContactPlanes | None:
        """The same as they answer a small motion from rest, at the end of the step."""
        planes, end = self.planes, self.arrays.end
        if planes is None:
            return None
        return planes.sticking(end.point[: len(planes)].copy(), end.slack_friction[: len(planes)].copy())

    @cached_property
    def report(self) -> ContactReport:
        """What the contacts did in the last step."""
        end, counts = self.arrays.end, self.arrays.counts
        if not counts[TOUCHES]:
            return replace(NOTHING_TOUCHED, work_J=float(end.figures[2]))
        acting = np.flatnonzero(end.acting)
        force, torque = end.loads[acting, :3], end.loads[acting, 3:]
        normal_N, depth_m, work_J, hit_m_s, hit_way_m, hit_body = end.figures.tolist()
        return ContactReport(
            acting, force, torque, int(counts[REMEMBERED]), normal_N, depth_m, work_J, hit_m_s, hit_way_m,
            int(hit_body),
        )  # fmt: skip

    @property
    def held_N_m(self) -> Array:
        """(bodies,) [N/m], trace of the stiffness of the contacts with each body, stick springs slack."""
        return self.arrays.end.held

    @property
    def memory(self) -> ContactMemory:
        """The contacts that press."""
        count = int(self.arrays.counts[REMEMBERED])
        return ContactMemory(*(part[:count].copy() for part in self.arrays.memory))  # type: ignore[arg-type]

    def save_state(self) -> ContactState:
        """Return what the next tick depends on."""
        centers = self.arrays.bodies.centers.copy()
        age, force = int(self.arrays.counts[AGE]), self.arrays.end.force.copy()
        past, pressing = self.arrays.past.copy(), self.arrays.bodies.pressing.copy()
        return ContactState(self.memory, self.planes, age, centers, force, past, pressing)

    def restore_state(self, state: ContactState) -> None:
        """Return to a state of `save_state`; the scene has been restored before."""
        self.forget()
        self.planes, count = state.planes, len(state.memory.key)
        if count or state.planes is not None or self.bodies.applied[self.query.body].any():
            self._meet()
        if count > len(self.arrays.memory.key):
            self.arrays = self._with_room(self.arrays.search, count)
        for name, part in zip(MemoryRows._fields, self.arrays.memory, strict=True):
            part[:count] = getattr(state.memory, name)
        self.arrays.bodies.centers[:] = state.centers
        self.arrays.end.force[:], self.arrays.past[:] = state.force, state.past
        self.arrays.bodies.pressing[:] = state.pressing
        counts = self.arrays.counts
        counts[:] = 0
        # bodies may bear what the next step is to end
        counts[REMEMBERED], counts[AGE], counts[contact_arrays.LEFT] = count, state.age, self._meets

    def check_state(self, state: ContactState) -> None:
        """Check what a saved state names: `restore_state` takes it for granted.

        Raises:
            InputError: there is no such node or shape.
        """
        memory, query, surface = state.memory, self.query, self.surface
        of_features = memory.face >= 0
        features = memory.key[of_features] - len(query.body) * len(surface)  # keys of points come first
        check_indices(features, len(query.features.shape), "features")
        for triangle in (memory.face[of_features], memory.triangle[memory.triangle >= 0]):
            check_indices(triangle, len(surface.triangles), "triangles")
        if state.planes is not None:
            check_indices(state.planes.body, self.bodies.count, "bodies")
            surface.check_planes(state.planes)

    def _found(self, x: Array, velocity: Array, rest_m: float, ahead_s: float) -> ContactPlanes | None:
        self.forget()
        if find_touched(self.at, x, velocity, rest_m, ahead_s) < 0:  # the lists serve no longer
            extent = Extent.of(x, velocity)
            coming_m = ahead_s / contact_arrays.AHEAD_TICKS * float(self.arrays.speed[1])
            reach = rest_m + ahead_s * extent.speed_m_s + coming_m
            search = self.search_around(x, extent, reach + _MARGIN_M, BEHIND_M + _MARGIN_M)
            self.arrays = self._with_room(search, len(search.lists.listed) + len(search.lists.features))
            find_touched(self.at, x, velocity, rest_m, ahead_s)
        return self.planes

    def _meet(self) -> None:
        """Have all kernels compiled, as something is near: many a film never comes so far."""
        if not self._meets:
            compilation.compile_modules(logging.getLogger("cosim").warning, _WHERE_NEAR)
            self._meets = True

    def search_around(self, positions: Array, extent: Extent, reach_m: float, behind_m: float) -> Search:
        """Return a search by lists that hold to such distances at present.

        Args:
            positions: (n, 3) [m], of the nodes.
            extent: of the film.
            reach_m: bound on the distance.
            behind_m: how far behind the film a feature still counts.
        """
        self._meet()
        query, room = self.query, max(reach_m, behind_m)
        shapes = query.near(extent.low, extent.high, reach_m)
        frames = [(positions - query.position[g]) @ query.rotation[g] for g in shapes]
        points = query.points_around(self.surface.points(positions), reach_m, shapes)
        row = np.full(len(query), -1)
        row[shapes] = np.arange(len(shapes))
        features = query.features.of(shapes)
        places = query.feature_positions(features)
        near = ((places > extent.low - room) & (places < extent.high + room)).all(axis=1)
        features, places = features[near], places[near]
        found = film_distance.TriangleLists.around(places, positions, self.surface.triangles, room)
        local = np.array(frames).reshape(-1, *positions.shape)
        lists = contact_arrays.ListRows(
            row, local, reach_m, behind_m, points.spans, points.listed, features, found.first, found.listed,
        )  # fmt: skip
        return self._searching(lists)

    def _searching(self, lists: contact_arrays.ListRows) -> Search:
        query, surface = self.query, self.surface
        rows = contact_arrays.SurfaceRows(
            *(getattr(surface, name) for name in contact_arrays.SurfaceRows._fields)
        )
        features = query.features.shape, query.features.position
        near = contact_arrays.NearPoints.room(len(lists.listed), len(lists.features))
        scratch = np.empty((max(len(lists.listed), len(lists.features)), 4)), np.empty((2, 3))
        return Search(
            query.bounds, *features, rows, lists, near, np.empty_like(lists.features), self._places,
            np.empty_like(lists.spans), np.empty((len(lists.features), 3)), np.empty_like(lists.features),
            *scratch, search_kernels.search_calls(),
        )  # fmt: skip

    def _first_arrays(self, search: Search) -> ContactArrays:
        law, bodies, query, surface = self.law, self.bodies, self.query, self.surface
        stiffness, room = law.stiffness_N_m3, len(self._glue.point)
        touchable = np.union1d(query.body, self._glue.body[:room])
        nodes = 1 + max(surface.nodes.max(initial=-1), surface.triangles.max(initial=-1))
        movable = touchable[bodies.movable(touchable)]
        numbers = contact_arrays.ContactNumbers(
            BEHIND_M, stiffness, stiffness * FEATURE_AREA_M2, RENEW_ABOVE, 0
        )
        touched = TouchedPlanes(
            address_of(add_contacts), PlaneRows.room(room), np.array([law.smoothing_m, law.stick_m]),
            np.empty((room, 3)), np.empty(room),
        )  # fmt: skip
        return ContactArrays(
            search,
            contact_arrays.ShapeRows(*(getattr(query, name) for name in contact_arrays.ShapeRows._fields)),
            numbers, MemoryRows.room(room), MemoryRows.room(room), touched, contact_arrays.Ties.room(room),
            self._glue, contact_arrays.EndRows.room(room, bodies.count, np.zeros((nodes, 3))),
            contact_arrays.BodyLoads(
                bodies.applied, bodies.mass_centers.copy(), bodies.bearing, np.zeros(bodies.count),
                np.zeros(8), contact_arrays.leads_of(bodies),
            ),
            movable, np.zeros(len(movable), np.int64), np.zeros(len(movable)),
            np.full((bodies.count, 2), contact_arrays.UNKNOWN), np.zeros((bodies.count, 6, 6)),
            np.zeros((bodies.count, 12)), np.zeros((bodies.count, 6)), np.zeros((bodies.count, 18)),
            np.zeros(2), self._resolved(movable), np.zeros(7, np.int64), contact_calls(),
        )  # fmt: skip

    def _resolved(self, movable: IntArray) -> Array:
        """Return the ways (bodies,) [m] of bodies in a step with which that resolves a hit."""
        ways = np.full(self.bodies.count, np.inf)
        ways[movable] = np.minimum(HIT_WAY_M, HIT_SHARE * self.bodies.sizes_m(movable))
        return ways

    def _with_room(self, search: Search, room: int) -> ContactArrays:
        """Return the arrays with room for so many contacts, what is remembered taken along."""
        before, remembered = self.arrays, int(self.arrays.counts[REMEMBERED])
        room = max(room, remembered) + len(self._glue.point)
        memory = MemoryRows.room(room)
        for old, new in zip(before.memory, memory, strict=True):
            new[:remembered] = old[:remembered]
        touched = before.touched._replace(
            planes=PlaneRows.room(room), own=np.empty((room, 3)), pressing=np.empty(room)
        )
        return before._replace(
            search=search, memory=memory, kept=MemoryRows.room(room),
            touched=touched, ties=contact_arrays.Ties.room(room),
            end=contact_arrays.EndRows.room(room, self.bodies.count, before.end.force),
        )  # fmt: skip
