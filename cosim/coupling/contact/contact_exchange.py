"""Contact between the film and the rigid scene: one search per tick, equal and opposite forces.

Per tick, after MuJoCo's step, the surfaces near the film are found at the new poses and frozen as tangent
planes. The soft step is solved with them. Its contact forces act on the bodies in MuJoCo's next step, at the
same points, with the opposite sign. Each contact remembers the anchor of its stick spring on the obstacle,
and its normal force, which bounds the friction of the next tick.
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
"""Reach of the search, in ticks of the fastest node's motion."""
POSITION_TOLERANCE_M: Final = 2e-6
"""Largest accepted error of a body's predicted pose; the next tick corrects it."""
TURN_LEVER_M: Final = 0.02
"""Lever by which angles are converted to distances."""
UNKNOWN: Final = 1e30
"""In `ContactExchange.compliance`: the body's compliance is not known."""
BEHIND_M: Final = 5e-3
"""How far behind the film a corner still counts as one that came through it."""
FEATURE_AREA_M2: Final = 5e-5
"""Film area that a corner represents: alone, it must hold back the film around it."""
HIT_WAY_M: Final = 1e-3
"""Motion of a body in a step above which its hit is not resolved: forces depend on the step."""
HIT_FRACTION: Final = 0.1
"""The same as a fraction of the body's size."""
GLUE_N_m: Final = 1e5
"""Stiffness of the spring of a glued node: 10 um under 1 N."""
_REACH_M = 1e-3  # reach of the search in addition to the film's motion
_STATIC_REACH_M = 3e-3  # the same in statics, where the motion is not known
_MARGIN_M = 8e-3  # of the lists: more makes them longer, less rebuilds them more often


def body_loads(bodies: Bodies, *, predicted: bool) -> contact_arrays.BodyLoads:
    """Return the contact loads on a scene's bodies; `predicted`: contacts may be at predicted poses."""
    centers = bodies.mass_centers.copy() if predicted else bodies.mass_centers
    untouched = np.zeros(bodies.count), np.zeros(8)
    return contact_arrays.BodyLoads(bodies.applied, centers, bodies.bearing, *untouched)


@final
@dataclass(frozen=True)
class ContactState:
    """State of a `ContactExchange`.

    Args:
        memory: contacts that press.
        planes: contacts of the last step; None for none.
        age: ticks of contact since heavy bodies were updated.
        centers: (bodies, 3) [m], of masses, for which contacts were computed.
        force: (touched nodes, 3) [N], on the film.
        past: (bodies, 12), earlier loads on bodies, see `ContactExchange`.
        normal_force: (bodies,) [N], sum of the normal forces on each.
        glued: (glued nodes, 3) [m], anchors in the body's frame.
        report: of the last step's contacts.
    """

    memory: ContactMemory
    planes: ContactPlanes | None
    age: int
    centers: Annotated[Array, ("bodies", 3)]
    force: Annotated[Array, ("touched nodes", 3)]
    past: Annotated[Array, ("bodies", 12)]
    normal_force: Annotated[Array, ("bodies",)]
    glued: Annotated[Array, ("*", 3)]
    report: ContactReport


@final
class ContactExchange:
    """Finds contacts, remembers them, and loads the bodies.

    After a step, `planes` are its contacts, None for none; `sticking` are the same contacts for a small
    motion from rest; `report` summarises them, `memory` holds those that press.

    For bodies: `loads` are their present contact loads, `past` (bodies, 12) the loads one tick and two ticks
    before, `assumed` (bodies, 6) the loads for which poses are predicted. `movable` (f,) are the bodies that
    the film can touch and loads can move. `compliance` (bodies, 2) [1/N, 1/(N m)] is the change of a body's
    pose in a tick per change of its load, relative to the tolerance. `age` counts ticks of contact since
    heavy bodies were updated, `light_ticks` ticks of contact with light bodies since these were updated.

    Args:
        query: distances to the shapes that can be touched.
        bodies: of the scene.
        surface: of the soft body.
        law: of contact.
        glued: (k,) nodes of the film and the body to which they are glued in place; None for none.
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
        self.memory = ContactMemory.empty(0)
        self.planes: ContactPlanes | None = None
        self._summed_at: Array | None = None  # nodes for which loads on bodies have been summed
        self._nothing = ContactPlanes.empty(0, self.law)
        self._contact_loads = contact_arrays.ContactLoads.none(bodies.count)
        self.age = self.light_ticks = 0
        self._loads_pending = False  # whether bodies have loads that a tick without contact must remove
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
        self.loads = body_loads(bodies, predicted=True)
        self.past, self.assumed = np.zeros((count, 12)), np.zeros((count, 6))
        self.compliance = np.full((count, 2), UNKNOWN)
        self._resolved = np.full(count, np.inf)
        sizes = bodies.sizes_m(self.movable)
        self._resolved[self.movable] = np.minimum(HIT_WAY_M, HIT_FRACTION * sizes)

    def glue_nodes(self, positions: Array) -> None:
        """Tie the glued nodes to their body at positions (n, 3) [m]."""
        glue = self.glue
        body = glue.body[0]
        points = positions[self.surface.nodes[glue.point, 0]]
        glue.anchor[:] = (points - glue.position[body]) @ glue.axes[body].reshape(3, 3)

    def find(self, before: SoftState, tick_s: float) -> ContactPlanes | None:
        """Return the possible contacts of the coming step; None for none.

        Args:
            before: state of the soft body before the step.
            tick_s: length of the step [s].
        """
        return self._find(before.positions, before.velocities, self.rest_reach_m, LOOKAHEAD_TICKS * tick_s)

    def find_static(self, positions: Array) -> ContactPlanes | None:
        """Return the possible contacts near an equilibrium, without friction; None for none.

        Args:
            positions: (n, 3) [m], of the nodes.
        """
        return self._find(positions, np.zeros_like(positions), _STATIC_REACH_M, 0.0)

    def _find(self, x: Array, velocity: Array, rest_m: float, ahead_s: float) -> ContactPlanes | None:
        self.planes = self._summed_at = None
        if len(self.query) + len(self.glue.point) == 0:
            return None
        near = self._near(x, velocity, rest_m, ahead_s)
        glued = len(self.glue.point)
        if near is None and not glued:
            self.memory = ContactMemory.empty(0)
            return None
        points = 0 if near is None else len(near.points.point)
        count = points + glued + (0 if near is None else len(near.features.feature))
        if not count:
            self.memory = ContactMemory.empty(0)
            return None
        self.planes = ContactPlanes.empty(count, self.law)
        self._describe(x, velocity, near, self.planes)
        return self.planes

    def _near(self, x: Array, velocity: Array, rest_m: float, ahead_s: float) -> NearFilm | None:
        """Return points and features near each other, None for none; shapes are at their predicted poses."""
        tick_s, query, moves, coming_m = ahead_s / LOOKAHEAD_TICKS, self.query, len(self.movable) > 0, 0.0
        prediction, extent = self.bodies.prediction, Extent.of(x, velocity)
        if moves:
            prediction.at_velocities(tick_s)
            # an approaching body is found a tick early, so that its hit falls into ticks with substeps
            coming_m = tick_s * contact_kernels.fastest_body(prediction.motions, self.movable)
            contact_kernels.extrapolate_loads(self.loads, self.past, self.assumed)
        self._predict_poses()
        reach_m = rest_m + ahead_s * extent.speed_m_s + coming_m
        active = query.near(extent.low, extent.high, reach_m)
        if moves and ahead_s > 0.0 and self._any_predicted(active):
            prediction.under_loads(self.assumed, tick_s)
            self._predict_poses()
            active = query.near(extent.low, extent.high, reach_m)
        if not len(active):
            return None
        self._was_near = True
        arguments = x, extent, active, (reach_m, BEHIND_M), self.memory
        near = self.search.find(*arguments)
        if near is None:
            self.search.build_lists(x, extent, reach_m + _MARGIN_M, BEHIND_M + _MARGIN_M)
            near = self.search.find(*arguments)
        return near

    def _any_predicted(self, active: IntArray) -> bool:
        """Return whether the pose of a body of these shapes, or of the glued body, is predicted."""
        ahead = self.bodies.prediction.ahead
        if len(self.glue.point) and ahead[self.glue.body[0]] > 0:
            return True
        return bool(np.count_nonzero(ahead[self.query.body[active]] > 0))

    def _predict_poses(self) -> None:
        query, centers = self.query, self.bodies.mass_centers
        unchecked(contact_kernels.predict_poses)(
            query.geom_poses, centers, self.bodies.prediction.lead, query.poses, self.loads.centers
        )

    def _describe(self, x: Array, velocity: Array, near: NearFilm | None, contacts: ContactPlanes) -> None:
        """Fill tangent planes and anchors; contacts that pressed before keep force and anchor."""
        surface, shapes, prediction = self._surface, self._shapes, self.bodies.prediction
        if near is not None:
            begin, features = len(near.points.point), near.features
            unchecked(contact_kernels.describe_points)(
                near.points, self.search.points, surface, shapes, contacts
            )
            if len(features.feature):
                unchecked(contact_kernels.describe_features)(x, features, surface, shapes, begin, contacts)
                contacts.stiffness[begin : begin + len(features.feature)] = self._feature_N_m
        if len(self.glue.point):
            contact_kernels.describe_glue(self.glue, surface, prediction.lead, contacts)
        if len(self.movable):
            unchecked(contact_kernels.fill_approach)(contacts, velocity, self._resolved, prediction.motions)
        if len(self.memory.key):
            unchecked(contact_kernels.restore_memory)(self.memory, shapes, contacts)

    def move(self, contacts: IntArray, shift: Array) -> ContactPlanes:
        """Move contacts (k,) by a shift (k, 3) [m] of their bodies, and return all contacts."""
        planes = self.planes
        assert planes is not None, "contacts were found"
        offset, anchor, carrier = planes.offset.copy(), planes.anchor.copy(), planes.carrier.copy()
        offset[contacts] += np.einsum("kr,kr->k", planes.normal[contacts], shift)
        anchor[contacts] += shift
        carrier[contacts] += shift
        self._summed_at = None
        self.planes = moved = planes.changed(offset=offset, anchor=anchor, carrier=carrier)
        return moved

    def predict(self, bodies: IntArray, loads: Array, tick_s: float) -> Array:
        """Return the predicted displacements (b, 6) of bodies under given loads, see `PosePrediction`.

        Args:
            bodies: (b,) whose poses are predicted.
            loads: (6 b,), about their centres of mass, in place of the present ones.
            tick_s: length of MuJoCo's step [s].
        """
        applied = self.bodies.applied.copy()
        applied[bodies] = loads.reshape(-1, 6)
        self.bodies.prediction.under_loads(applied, tick_s)
        return self.bodies.prediction.lead[bodies]

    def held_compliance(self, bodies: IntArray, loads: Array, tick_s: float) -> Array:
        """Return the compliance (6 b, 6 b) of bodies under loads, with MuJoCo's constraints; see `predict`.

        That is h^2 J M^-1 J^T, as in `light_bodies`.
        """
        applied = self.bodies.applied
        before = applied[bodies]
        applied[bodies] = loads.reshape(-1, 6)
        mobility = self.bodies.way_s2(tick_s) * self.bodies.mobility(bodies, held=True)
        applied[bodies] = before
        return mobility

    def light_bodies_near(self) -> tuple[bool, bool]:
        """Return whether light bodies are among the contacts, and whether the compliance of all is known."""
        if self.planes is None or not len(self.movable):
            return False, True
        near, ahead = self.planes.body, self.bodies.prediction.ahead
        if not np.count_nonzero(ahead[near] > 0):
            return False, True
        unknown = (ahead > 0) & (self.compliance[:, 0] == UNKNOWN) & (self.loads.loaded != 0)
        return True, not np.count_nonzero(unknown[near])

    def mismatch(self, x: Array, tolerance_N: float, tick_s: float) -> float:
        """Return the largest error of a predicted pose under a step's loads, relative to the tolerance.

        At most 1 is accepted; infinite means not known. The error of free bodies bounds that of constrained
        ones; if the bound fails, MuJoCo's next step is computed.

        Args:
            x: (n, 3) [m], nodes at the end of the step.
            tolerance_N: of the film's forces.
            tick_s: length of MuJoCo's step [s].
        """
        self._sum_loads(x)
        ends, loads, prediction = self._contact_loads, self.loads, self.bodies.prediction
        largest_error = unchecked(contact_kernels.mismatch)(
            ends, loads, self.assumed, prediction.ahead, self.compliance, tolerance_N
        )
        if not largest_error <= 1.0:
            largest_error = (
                self._pose_error_m(tick_s) / POSITION_TOLERANCE_M if largest_error < np.inf else largest_error
            )
        if largest_error <= 1.0 and np.count_nonzero(ends.touched[prediction.ahead > 0]):
            self.light_ticks += 1
        return float(largest_error)

    def _pose_error_m(self, tick_s: float) -> float:
        """Return the largest error [m] of a predicted pose under the loads at the end of a step."""
        prediction, loads = self.bodies.prediction, np.empty_like(self.assumed)
        before = prediction.lead.copy()
        contact_kernels.fill_next_loads(self._contact_loads, self.loads, loads)
        prediction.under_loads(loads, tick_s)
        poses = prediction.lead, before, self.loads.centers, prediction.ahead
        error_m = contact_kernels.largest_pose_error(*poses, TURN_LEVER_M)
        prediction.lead[:] = before
        return float(error_m)

    def _sum_loads(self, x: Array) -> None:
        """Sum the loads on bodies at the end of a step, once."""
        if self._summed_at is not x and self.planes is not None:
            unchecked(contact_kernels.sum_contact_loads)(
                x, self.planes, self.query.friction, self._contact_loads
            )
            self._summed_at = x

    def commit(self, before: Array, x: Array) -> ContactReport:
        """Accept the soft step: remember its contacts and load the bodies.

        Args:
            before: (n, 3) [m], nodes at the start of the step.
            x: (n, 3) [m], nodes at its end.
        """
        contacts = self.planes
        if contacts is None and not self._loads_pending:
            self.report = NOTHING_TOUCHED
            return self.report
        if contacts is None:
            self._contact_loads.clear()
            self.memory = ContactMemory.empty(0)
        else:
            self._sum_loads(x)
            self.memory = self._new_memory(contacts)
            self.age += 1
        ending = self._nothing if contacts is None else contacts
        work_J = unchecked(contact_kernels.add_work)(ending, before, x, self._force)
        unchecked(contact_kernels.load_bodies)(self._contact_loads, self.loads, self.past)
        self._loads_pending = contacts is not None
        self.report = self._new_report(float(work_J))
        self.__dict__.pop("sticking", None)
        return self.report

    def _new_memory(self, contacts: ContactPlanes) -> ContactMemory:
        """Return the contacts that press at the end of a step."""
        memory = ContactMemory.empty(int(np.count_nonzero(contacts.normal_force > 0.0)))
        if len(memory.key):
            unchecked(contact_kernels.fill_memory)(contacts, self._shapes, memory)
            if len(self.movable):
                unchecked(contact_kernels.find_worst_hit)(
                    contacts, self._resolved, self._contact_loads.figures
                )
        return memory

    def _new_report(self, work_J: float) -> ContactReport:
        if self.planes is None:
            return replace(NOTHING_TOUCHED, work_J=work_J)
        ends = self._contact_loads
        acting = np.flatnonzero(ends.touched)
        normal_N, depth_m, hit_m_s, hit_way_m, hit_body = ends.figures.tolist()
        return ContactReport(
            acting, ends.loads[acting, :3], ends.loads[acting, 3:], len(self.memory.key), normal_N, depth_m,
            work_J, hit_m_s, hit_way_m, int(hit_body),
        )  # fmt: skip

    @cached_property
    def sticking(self) -> ContactPlanes | None:
        """The contacts at the end of the step for a small motion from rest, in which all of them stick."""
        planes = self.planes
        if planes is None:
            return None
        coefficient = np.append(self.query.friction, 0.0)[planes.shape]  # glue is of no shape
        return planes.sticking(np.where(planes.glued, GLUED, coefficient * planes.normal_force))

    def fastest_m_s(self, after: SoftState) -> float:
        """Return the largest speed of approach of film and movable bodies, see `fastest_touched`."""
        if self.planes is None or not len(self.movable):
            return 0.0
        bodies, touched = self.bodies.prediction.motions, self.loads.loaded
        film = after.positions, after.velocities
        return float(
            unchecked(contact_kernels.fastest_touched)(self.planes, bodies, self.movable, touched, *film)
        )

    @property
    def rest_reach_m(self) -> float:
        """Reach of the search for a film at rest."""
        return self.law.onset_m + _REACH_M

    @property
    def stiffness_N_m(self) -> Array:
        """(bodies,) [N/m], trace of the stiffness of the contacts with each body, stick springs slack."""
        return self._contact_loads.stiffness_trace

    @property
    def state(self) -> ContactState:
        """State of contact; restore the scene before it."""
        rows = self.loads.centers, self._force, self.past, self.loads.normal_force, self.glue.anchor
        return ContactState(self.memory, self.planes, self.age, *copied(rows), self.report)

    @state.setter
    def state(self, saved: ContactState) -> None:
        self._check(saved)
        self.glue.anchor[:], self.report = saved.glued, saved.report
        self.memory, self.planes, self.age = saved.memory, saved.planes, saved.age
        self._summed_at = None
        self.__dict__.pop("sticking", None)
        if len(saved.memory.key) or saved.planes is not None or self.bodies.applied[self.query.body].any():
            self._was_near = True
        self.loads.centers[:], self.loads.normal_force[:] = saved.centers, saved.normal_force
        self._force[:], self.past[:] = saved.force, saved.past
        self._loads_pending = self._was_near  # bodies may have loads that the next step must remove

    def _check(self, saved: ContactState) -> None:
        """Check the indices in a saved state.

        Raises:
            InputError: a node, shape or body does not exist here.
        """
        glued, present = len(saved.glued), len(self.glue.anchor)
        if glued != present:
            raise InputError(f"the saved soft robot is glued by {glued} nodes, this one by {present}")
        memory, query, surface = saved.memory, self.query, self.surface
        of_features = memory.face >= 0
        features = memory.key[of_features] - len(query.body) * len(surface)  # keys of points come first
        check_indices(features, len(query.features.shape), "features")
        for triangle in (memory.face[of_features], memory.triangle[memory.triangle >= 0]):
            check_indices(triangle, len(surface.triangles), "triangles")
        if saved.planes is not None:
            check_indices(saved.planes.body, self.bodies.count, "bodies")
            surface.check_planes(saved.planes)
