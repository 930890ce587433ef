"""Contact between the film and the rigid scene: one search per tick, forces on both sides.

Per tick, after MuJoCo's step: the surfaces near the film are found at the new poses and frozen as tangent
planes; the soft step solves with them; what its contact points press with acts on the bodies in MuJoCo's
next step, at the same points, with the opposite sign. Each contact keeps where its stick spring is tied on
the obstacle, and its normal force, which bounds the friction of the next tick.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import unchecked
from cosim.base.state import copied
from cosim.base.state_checks import check_indices
from cosim.coupling.contact import contact_arrays, contact_kernels
from cosim.coupling.contact.contact_report import NOTHING_TOUCHED, ContactMemory, ContactReport
from cosim.coupling.contact.near_search import NearFilm, NearSearch
from cosim.errors import InputError
from cosim.rigid.distance import contact_query
from cosim.rigid.scene.bodies import Bodies
from cosim.soft.contact.contact_law import GLUED, ContactLaw
from cosim.soft.contact.contact_points import ContactSurface, Extent
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.solve.state import SoftState

LOOKAHEAD_TICKS: Final = 2.0
"""How many ticks' way of the fastest node a film looks ahead."""
POSITION_TOLERANCE_M: Final = 2e-6
"""How far bodies may go from where the film has met them; the next tick answers it, and more than that."""
TURN_LEVER_M: Final = 0.02
"""Lever at which angles count as ways."""
UNKNOWN: Final = 1e30
"""Of `ContactExchange.gives`: how such bodies give way is not known."""
BEHIND_M: Final = 5e-3
"""How far behind the film a corner still counts as one that came through it."""
FEATURE_AREA_M2: Final = 5e-5
"""What each represents: a corner must hold back the film around it by itself."""
HIT_WAY_M: Final = 1e-3
"""Way of a body in a step, beyond which its hit is not resolved: forces hang on the step."""
HIT_SHARE: Final = 0.1
"""The same as a share of the body's size."""
GLUE_N_m: Final = 1e5
"""Stiffness of the spring by which a node is glued: under 1 N it gives by 10 um."""
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
        past: (bodies, 12), loads on bodies before those that act, see `ContactExchange`.
        pressing: (bodies,) [N], sum of the normal forces on each.
        glued: (glued nodes, 3) [m], where they are tied, in their body's frame.
        report: what the contacts of the last step did.
    """

    memory: ContactMemory
    planes: ContactPlanes | None
    age: int
    centers: Annotated[Array, ("bodies", 3)]
    force: Annotated[Array, ("touched nodes", 3)]
    past: Annotated[Array, ("bodies", 12)]
    pressing: Annotated[Array, ("bodies",)]
    glued: Annotated[Array, ("*", 3)]
    report: ContactReport


@final
class ContactExchange:
    """Finds contacts, remembers them, and loads the bodies.

    After a step, `planes` are the contacts that it was taken with, None for none; `sticking` the same as they
    answer a small motion from rest; `report` says what they did, `memory` which press.

    Of bodies: `loads` are what acts on them, `past` (bodies, 12) the loads one tick before those that act,
    and two, `assumed` (bodies, 6) those with which the film meets them; `movable` (f,) can be touched and
    moved by loads; `gives` (bodies, 2) [1/N, 1/(N m)] is by how much a body goes from where the film has met
    it for a change of its load in a tick, over what may be. `age` counts ticks of contact since heavy bodies
    were weighed, `met` those that touched bodies which gave way since these were.

    Args:
        query: distances to what can be touched.
        bodies: of the scene.
        surface: of the soft body.
        law: of contact.
        glued: (k,) nodes of the film and the body that they are glued to, each where it is; None for none.
    """

    def __init__(
        self,
        query: contact_query.ContactQuery,
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
        self.glue = contact_arrays.Glue(
            points, np.zeros((len(nodes), 3)), np.array([body]), GLUE_N_m, bodies.positions, bodies.axes
        )
        self.search = NearSearch(query, surface)
        self._was_near = len(nodes) > 0
        self._prepare_surface()
        self._prepare_bodies()
        self.memory = ContactMemory.room(0)
        self.planes: ContactPlanes | None = None
        self._concluded: Array | None = None  # nodes for which loads on bodies are known
        self._nothing = ContactPlanes.room(0, self.law)
        self._body_ends = contact_arrays.ContactLoads.room(bodies.count)
        self.age = self.met = 0
        self._acts = False  # whether something is left to be ended in a tick in which nothing is touched
        self.report = NOTHING_TOUCHED

    def _prepare_surface(self) -> None:
        law, surface, query = self.law, self.surface, self.query
        stiffness = law.stiffness_N_m3 * surface.area
        self._surface = contact_arrays.SurfaceArrays(
            surface.nodes, surface.weights, surface.slots, stiffness, surface.triangles,
            surface.triangle_slots,
        )  # fmt: skip
        self._shapes = contact_arrays.ShapeArrays(query.position, query.rotation, query.friction, query.body)
        self._feature_N_m = law.stiffness_N_m3 * FEATURE_AREA_M2
        nodes = 1 + max(surface.nodes.max(initial=-1), surface.triangles.max(initial=-1))
        self._force = np.zeros((nodes, 3))

    def _prepare_bodies(self) -> None:
        bodies, count = self.bodies, self.bodies.count
        touchable = np.union1d(self.query.body, self.glue.body[: len(self.glue.point)])
        self.movable: IntArray = touchable[bodies.movable(touchable)]
        self.loads = contact_arrays.BodyLoads.of(bodies, ahead=True)
        self.past, self.assumed = np.zeros((count, 12)), np.zeros((count, 6))
        self.gives = np.full((count, 2), UNKNOWN)
        self._resolved = np.full(count, np.inf)
        sizes = bodies.sizes_m(self.movable)
        self._resolved[self.movable] = np.minimum(HIT_WAY_M, HIT_SHARE * sizes)

    def glue_at(self, positions: Array) -> None:
        """Glue the film's nodes where they are at positions (n, 3) [m]."""
        glue = self.glue
        body = glue.body[0]
        here = positions[self.surface.nodes[glue.point, 0]]
        glue.place[:] = (here - glue.position[body]) @ glue.axes[body].reshape(3, 3)

    def find(self, before: SoftState, tick_s: float) -> ContactPlanes | None:
        """Return what the film may touch in the coming step; None for nothing.

        Args:
            before: state of the soft body before the step.
            tick_s: length of the step [s].
        """
        return self._find(before.positions, before.velocities, self.rest_reach_m, LOOKAHEAD_TICKS * tick_s)

    def still(self, positions: Array) -> ContactPlanes | None:
        """Return what the film may touch near an equilibrium, without friction; None for nothing.

        Args:
            positions: (n, 3) [m], of the nodes.
        """
        return self._find(positions, np.zeros_like(positions), _STILL_REACH_M, 0.0)

    def _find(self, x: Array, velocity: Array, rest_m: float, ahead_s: float) -> ContactPlanes | None:
        self.planes = self._concluded = None
        if len(self.query) + len(self.glue.point) == 0:
            return None
        near = self._near(x, velocity, rest_m, ahead_s)
        glued = len(self.glue.point)
        if near is None and not glued:
            self.memory = ContactMemory.room(0)
            return None
        points = 0 if near is None else len(near.points.point)
        count = points + glued + (0 if near is None else len(near.features.feature))
        if not count:
            self.memory = ContactMemory.room(0)
            return None
        self.planes = ContactPlanes.room(count, self.law)
        self._describe(x, velocity, near, self.planes)
        return self.planes

    def _near(self, x: Array, velocity: Array, rest_m: float, ahead_s: float) -> NearFilm | None:
        """Return what is near the film, None for nothing; shapes are where the film will meet them."""
        tick_s, query, moves, coming_m = ahead_s / LOOKAHEAD_TICKS, self.query, len(self.movable) > 0, 0.0
        sight, extent = self.bodies.prediction, Extent.of(x, velocity)
        if moves:
            sight.at_velocities(tick_s)
            # a body that comes on is met a tick before it is there, so its hit finds ticks in pieces
            coming_m = tick_s * contact_kernels.fastest_body(sight.motions, self.movable)
            contact_kernels.assume(self.loads, self.past, self.assumed)
        self._place_shapes()
        reach_m = rest_m + ahead_s * extent.speed_m_s + coming_m
        active = query.near(extent.low, extent.high, reach_m)
        if moves and ahead_s > 0.0 and self._meets_ahead(active):
            sight.under_loads(self.assumed, tick_s)
            self._place_shapes()
            active = query.near(extent.low, extent.high, reach_m)
        if not len(active):
            return None
        self._was_near = True
        asked = x, extent, active, (reach_m, BEHIND_M), self.memory
        found = self.search.find(*asked)
        if found is None:
            self.search.make_lists(x, extent, reach_m + _MARGIN_M, BEHIND_M + _MARGIN_M)
            found = self.search.find(*asked)
        return found

    def _meets_ahead(self, active: IntArray) -> bool:
        """Return whether one of the bodies of shapes, or that which nodes are glued to, may give way."""
        ahead = self.bodies.prediction.ahead
        if len(self.glue.point) and ahead[self.glue.body[0]] > 0:
            return True
        return bool(np.count_nonzero(ahead[self.query.body[active]] > 0))

    def _place_shapes(self) -> None:
        sight, query = self.bodies.prediction, self.query
        centers = self.bodies.mass_centers, sight.lead
        unchecked(contact_kernels.place_shapes)(query.geom_poses, *centers, query.poses, self.loads.centers)

    def _describe(self, x: Array, velocity: Array, near: NearFilm | None, contacts: ContactPlanes) -> None:
        """Fill tangent planes and what they are tied to; what pressed before keeps force and anchor."""
        surface, shapes, sight = self._surface, self._shapes, self.bodies.prediction
        if near is not None:
            begin, features = len(near.points.point), near.features
            unchecked(contact_kernels.describe_points)(
                near.points, self.search.places, surface, shapes, contacts
            )
            if len(features.feature):
                unchecked(contact_kernels.describe_features)(x, features, surface, shapes, begin, contacts)
                contacts.stiffness[begin : begin + len(features.feature)] = self._feature_N_m
        if len(self.glue.point):
            contact_kernels.describe_glue(self.glue, surface, sight.lead, contacts)
        if len(self.movable):
            unchecked(contact_kernels.fill_approach)(contacts, velocity, self._resolved, sight.motions)
        if len(self.memory.key):
            unchecked(contact_kernels.recall)(self.memory, shapes, contacts)

    def move(self, contacts: IntArray, shift: Array) -> ContactPlanes:
        """Return what was found with contacts (k,) gone by a shift (k, 3) [m] with their bodies."""
        found = self.planes
        assert found is not None, "contacts were found"
        offset, anchor, carrier = found.offset.copy(), found.anchor.copy(), found.carrier.copy()
        offset[contacts] += np.einsum("kr,kr->k", found.normal[contacts], shift)
        anchor[contacts] += shift
        carrier[contacts] += shift
        self._concluded = None
        self.planes = moved = found.changed(offset=offset, anchor=anchor, carrier=carrier)
        return moved

    def ahead(self, bodies: IntArray, loads: Array, tick_s: float) -> Array:
        """Return how far bodies will be ahead (b, 6), see `PosePrediction`.

        Args:
            bodies: (b,) that are met ahead.
            loads: (6 b,), about their centres of mass, instead of those that act now.
            tick_s: length of MuJoCo's step [s].
        """
        borne = self.bodies.applied.copy()
        borne[bodies] = loads.reshape(-1, 6)
        self.bodies.prediction.under_loads(borne, tick_s)
        return self.bodies.prediction.lead[bodies]

    def held_way(self, bodies: IntArray, loads: Array, tick_s: float) -> Array:
        """Return how bodies give way (6 b, 6 b) under loads, see `ahead`, with all that holds them then."""
        applied = self.bodies.applied
        before = applied[bodies]
        applied[bodies] = loads.reshape(-1, 6)
        mobility = self.bodies.way_s2(tick_s) * self.bodies.mobility(bodies, held=True)
        applied[bodies] = before
        return mobility

    def may_give_way(self) -> tuple[bool, bool]:
        """Return whether a body that was found may give way, and whether it is known how all of them do."""
        if self.planes is None or not len(self.movable):
            return False, True
        near, ahead = self.planes.body, self.bodies.prediction.ahead
        if not np.count_nonzero(ahead[near] > 0):
            return False, True
        unknown = (ahead > 0) & (self.gives[:, 0] == UNKNOWN) & (self.loads.loaded != 0)
        return True, not np.count_nonzero(unknown[near])

    def disagreement(self, x: Array, tolerance_N: float, tick_s: float) -> float:
        """Return how far bodies go from where a step has met them, under its loads, over what they may.

        At most 1 where that is agreed, infinite where it is not known. Where free ones would, held ones do;
        otherwise MuJoCo's next step is looked at.

        Args:
            x: (n, 3) [m], nodes at the end of the step.
            tolerance_N: of the film's forces.
            tick_s: length of MuJoCo's step [s].
        """
        self._conclude(x)
        ends, loads, sight = self._body_ends, self.loads, self.bodies.prediction
        most = unchecked(contact_kernels.disagreement)(
            ends, loads, self.assumed, sight.ahead, self.gives, tolerance_N
        )
        if not most <= 1.0:
            most = self._away_m(tick_s) / POSITION_TOLERANCE_M if most < np.inf else most
        if most <= 1.0 and np.count_nonzero(ends.acting[sight.ahead > 0]):
            self.met += 1
        return float(most)

    def _away_m(self, tick_s: float) -> float:
        """Return how far bodies go from where the film has met them under the loads at the end of a step."""
        sight, borne = self.bodies.prediction, np.empty_like(self.assumed)
        before = sight.lead.copy()
        contact_kernels.fill_borne(self._body_ends, self.loads, borne)
        sight.under_loads(borne, tick_s)
        found = sight.lead, before, self.loads.centers, sight.ahead
        away_m = contact_kernels.farthest_led(*found, TURN_LEVER_M)
        sight.lead[:] = before
        return float(away_m)

    def _conclude(self, x: Array) -> None:
        """Sum the loads on bodies at the end of a step, once."""
        if self._concluded is not x and self.planes is not None:
            unchecked(contact_kernels.conclude)(x, self.planes, self.query.friction, self._body_ends)
            self._concluded = x

    def commit(self, before: Array, x: Array) -> ContactReport:
        """Take in the end of the soft step: remember the contacts and load the bodies.

        Args:
            before: (n, 3) [m], of the nodes at the beginning of the step.
            x: (n, 3) [m], the same at its end.
        """
        contacts = self.planes
        if contacts is None and not self._acts:
            self.report = NOTHING_TOUCHED
            return self.report
        if contacts is None:
            self._body_ends.clear()
            self.memory = ContactMemory.room(0)
        else:
            self._conclude(x)
            self.memory = self._remembered(contacts)
            self.age += 1
        ending = self._nothing if contacts is None else contacts
        work_J = unchecked(contact_kernels.add_work)(ending, before, x, self._force)
        unchecked(contact_kernels.load_bodies)(self._body_ends, self.loads, self.past)
        self._acts = contacts is not None
        self.report = self._reported(float(work_J))
        self.__dict__.pop("sticking", None)
        return self.report

    def _remembered(self, contacts: ContactPlanes) -> ContactMemory:
        """Return the contacts that press at the end of a step."""
        memory = ContactMemory.room(int(np.count_nonzero(contacts.normal_force > 0.0)))
        if len(memory.key):
            unchecked(contact_kernels.remember)(contacts, self._shapes, memory)
            if len(self.movable):
                unchecked(contact_kernels.see_hits)(contacts, self._resolved, self._body_ends.figures)
        return memory

    def _reported(self, work_J: float) -> ContactReport:
        if self.planes is None:
            return replace(NOTHING_TOUCHED, work_J=work_J)
        ends = self._body_ends
        acting = np.flatnonzero(ends.acting)
        normal_N, depth_m, hit_m_s, hit_way_m, hit_body = ends.figures.tolist()
        return ContactReport(
            acting, ends.loads[acting, :3], ends.loads[acting, 3:], len(self.memory.key), normal_N, depth_m,
            work_J, hit_m_s, hit_way_m, int(hit_body),
        )  # fmt: skip

    @cached_property
    def sticking(self) -> ContactPlanes | None:
        """The contacts as they answer a small motion from rest, at the end of the step."""
        planes = self.planes
        if planes is None:
            return None
        coefficient = np.append(self.query.friction, 0.0)[planes.shape]  # glue is of no shape
        return planes.sticking(np.where(planes.glued, GLUED, coefficient * planes.normal_force))

    def fastest_m_s(self, after: SoftState) -> float:
        """Return how fast the film comes on to what can move, or what it presses on moves on the flange."""
        if self.planes is None or not len(self.movable):
            return 0.0
        bodies, touched = self.bodies.prediction.motions, self.loads.loaded
        film = after.positions, after.velocities
        return float(
            unchecked(contact_kernels.fastest_touched)(self.planes, bodies, self.movable, touched, *film)
        )

    @property
    def rest_reach_m(self) -> float:
        """How far a film at rest looks for shapes."""
        return self.law.onset_m + _REACH_M

    @property
    def held_N_m(self) -> Array:
        """(bodies,) [N/m], trace of the stiffness of the contacts with each body, stick springs slack."""
        return self._body_ends.held

    @property
    def state(self) -> ContactState:
        """What the next tick depends on; the scene is restored before it."""
        rows = self.loads.centers, self._force, self.past, self.loads.pressing, self.glue.place
        return ContactState(self.memory, self.planes, self.age, *copied(rows), self.report)

    @state.setter
    def state(self, found: ContactState) -> None:
        self._check(found)
        self.glue.place[:], self.report = found.glued, found.report
        self.memory, self.planes, self.age = found.memory, found.planes, found.age
        self._concluded = None
        self.__dict__.pop("sticking", None)
        if len(found.memory.key) or found.planes is not None or self.bodies.applied[self.query.body].any():
            self._was_near = True
        self.loads.centers[:], self.loads.pressing[:] = found.centers, found.pressing
        self._force[:], self.past[:] = found.force, found.past
        self._acts = self._was_near  # bodies may bear what the next step is to end

    def _check(self, found: ContactState) -> None:
        """Check what a saved state names.

        Raises:
            InputError: there is no such node or shape.
        """
        glued, here = len(found.glued), len(self.glue.place)
        if glued != here:
            raise InputError(f"the saved soft robot is glued by {glued} nodes, this one by {here}")
        memory, query, surface = found.memory, self.query, self.surface
        of_features = memory.face >= 0
        features = memory.key[of_features] - len(query.body) * len(surface)  # keys of points come first
        check_indices(features, len(query.features.shape), "features")
        for triangle in (memory.face[of_features], memory.triangle[memory.triangle >= 0]):
            check_indices(triangle, len(surface.triangles), "triangles")
        if found.planes is not None:
            check_indices(found.planes.body, self.bodies.count, "bodies")
            surface.check_planes(found.planes)
