"""Samples the film's response at wanted poses: strains of its sections, and the forces that belong to them.
Guides on all rings pull their frames near random wanted poses, over the working range of pressure and
relative motion. The resulting frames and the forces of the guides are exact samples: only known forces act
beyond a section, so their resultant is the derivative of the section's energy by its strains.
"""

from dataclasses import dataclass, replace
from typing import TypeAlias, final

import numpy as np

from cosim.base.frames import Array, IntArray, Pose, cross
from cosim.errors import ConvergenceError
from cosim.reduced.ring_guides import RingGroup, RingGuides
from cosim.reduced.section_model import RingFrames, frames_from_strains, strains
from cosim.reduced.wanted_poses import Lengths, Poses, WorkingRange
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements import frame_ring
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve import equilibrium, newton_options, state
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.self_contact import FilmContactLaw, SelfContact

Sample: TypeAlias = tuple[float, Array, Array, float, Array, Array, Array]
"""Pressure, strains, forces, volume, frames, nodes and target, as in `Samples`."""

_STILL = (0.0, 0.0, 0.0)
_ALMOST_STRAIGHT = 15  # first samples at each pressure
_HALF_STIFF_Pa = 2e3  # at lower pressure samples are shortened less: a film without gas has no free length
_LEAST_STEP = 0.1  # smallest load step to a sample
_REUSE_MAX, _REUSE_BELOW_N = 8, 0.01  # reuse of factorisations on a refined mesh, near an equilibrium
_FINER_OF = 5  # one of this many poses is also sampled on the refined mesh
_CRUMPLED_Pa = 500.0  # below this pressure bent films of a refined mesh are not sampled
_COUPLING_N_m = 1e-9  # stiffness of rings that are added only for their blocks in the tangent
# far above a section's stiffness in bending and length, so that it reaches the wanted pose; below it in shear
# and twist, which then follow from equilibrium
_GUIDE_STIFFNESS = np.array([3e4, 3e4, 3e4, 30.0, 30.0, 30.0])


@final
@dataclass(frozen=True)
class Samples:
    """Samples of a film; section s is between frames s and s + 1.

    Args:
        length_m: (pressures, s), middle of the sampled lengths of each section.
        failures: samples without a solution.
        pressure_Pa: (m,).
        strain: (m, s, 6).
        force: (m, s, 6), derivatives of the energy with respect to the strains.
        volume_m3: (m,).
        frames: (m, f, 4, 3), flange frame.
        positions: (m, n, 3) [m], of the nodes.
        target: (m, f, 4, 3), frames that the guides pull to; without guides the frames themselves.
    """

    length_m: Array
    failures: int
    pressure_Pa: Array
    strain: Array
    force: Array
    volume_m3: Array
    frames: Array
    positions: Array
    target: Array

    @classmethod
    def of(cls, rows: list[Sample], length_m: Array, failures: int) -> "Samples":
        """Return samples as columns."""
        return cls(length_m, failures, *(np.array(column) for column in zip(*rows, strict=True)))


@final
class Sampler:
    """Solves the film under guides.

    Args:
        body: one stack of units.
        frames: of its rings.
        films: law of contact between its units; None: they pass through one another.
    """

    def __init__(self, body: SoftBody, frames: RingFrames, films: FilmContactLaw | None = None) -> None:
        if body.frames is None:
            rings = np.array(frames.rings[:-1])
            body = body.with_elements(frame_ring.FrameRings.from_shape(body.positions, rings, _COUPLING_N_m))
        self._frames = frames
        self._system = FilmPotential(body)
        clamp = Clamp.of_base(body)
        # square units are solved up to folding; others only until their film crumples
        iterations, shift_N_m = (60, 1e9) if frames.rims.size else (25, 1e6)
        options = newton_options.NewtonOptions(
            tolerance_N=1e-5,
            start_tolerance_N=1e-5,
            iterations_max=iterations,
            shift_max_N_m=shift_N_m,
            checks_stability=False,
        )
        newton = NewtonSolver(self._system, clamp.mask(body.nodes))
        contact = None if films is None else SelfContact(body, films)
        self._solver = equilibrium.EquilibriumSolver(newton, clamp, options, contact, slides_max=0)
        self._groups = RingGroup.all_of(self._system.pattern, frames)
        self._slack = Loads((), (0.0,) * len(body.cables), _STILL)
        self._body = body
        self.reached: list[float] = []
        self._radii = np.array([np.linalg.norm(shape, axis=1).max() for shape in frames.shapes])

    def _without_loads(self) -> state.Equilibrium:
        """Return the equilibrium without loads, near the drawn shape."""
        drawn = state.SoftState.drawn(self._body, Pose())
        return self._solver.solve(self._solver.opened(drawn, Pose(), self._slack), Pose(), self._slack)

    def collect(self, work: WorkingRange, seed: int) -> Samples:
        """Return samples over a working range.

        Args:
            work: range to sample.
            seed: of the random poses.
        """
        random = np.random.default_rng(seed)
        unloaded = self._without_loads()
        longest = self._still_lengths(unloaded, work.pressures_Pa[-1])
        rows: list[Sample] = []
        lengths, failures = [], 0
        for pressure in work.pressures_Pa:
            unloaded = self._solver.follow(unloaded, Pose(), replace(self._slack, pressure_Pa=(pressure,)))
            rows.append(self._sample(unloaded))
            range_m = self._lengths(unloaded, longest, work)
            lengths.append(0.5 * (range_m.low + range_m.high))
            for wanted_strains in Poses(range_m, self._radii, self._frames.rims, work).draw(random):
                try:
                    rows.append(self._guided(unloaded, wanted_strains))
                except ConvergenceError:
                    failures += 1
        return Samples.of(rows, np.array(lengths), failures)

    def finer(self, coarse: Samples, parents: IntArray) -> Samples:
        """Return samples at some poses of a coarser mesh, each started from the shape of the coarser mesh.

        With hardly any gas these are only straight and almost straight ones: bent films crumple, differently
        on each mesh.

        Args:
            coarse: samples of the mesh with one refinement less.
            parents: (n, 2) nodes of the coarser mesh; each node is halfway between two.
        """
        # near starts allow reuse; on the coarse mesh it leads crumpled films to other equilibria
        near_start_options = replace(self._solver.options, reuse_max=_REUSE_MAX, reuse_below_N=_REUSE_BELOW_N)
        self._solver.options = near_start_options
        unloaded = self._without_loads()
        rows, failures, mesh_difference = list[Sample](), 0, np.zeros_like(unloaded.state.positions)
        for level, pressure in enumerate(np.unique(coarse.pressure_Pa).tolist()):
            straight_sample, *bent_samples = np.flatnonzero(coarse.pressure_Pa == pressure).tolist()
            shape = coarse.positions[straight_sample][parents].mean(axis=1)
            unloaded = self._freed(unloaded, pressure, shape + mesh_difference)
            rows.append(self._sample(unloaded))
            mesh_difference = unloaded.state.positions - shape
            end = len(bent_samples) if pressure > _CRUMPLED_Pa else _ALMOST_STRAIGHT
            for k in bent_samples[level % _FINER_OF : end : _FINER_OF]:
                start = coarse.positions[k][parents].mean(axis=1)
                try:
                    rows.append(self._near(unloaded, coarse.target[k], start))
                except ConvergenceError:
                    failures += 1
        return Samples.of(rows, coarse.length_m, failures)

    def _freed(self, free: state.Equilibrium, pressure_Pa: float, start: Array) -> state.Equilibrium:
        """Return the film without load at another pressure, from a start (n, 3) [m] if that converges."""
        loads = replace(self._slack, pressure_Pa=(pressure_Pa,))
        try:
            return self._solver.solve(free.state, Pose(), loads, start)
        except ConvergenceError:
            return self._solver.follow(free, Pose(), loads)

    def _still_lengths(self, free: state.Equilibrium, pressure_Pa: float) -> Array:
        """Return the lengths (s,) [m] of the sections without load; for squares at `pressure_Pa`."""
        if self._frames.rims.size:
            free = self._solver.follow(free, Pose(), replace(self._slack, pressure_Pa=(pressure_Pa,)))
        return strains(*self._pairs(self._frames.fit(free.state.positions, Pose())))[:, 2]

    def _lengths(self, free: state.Equilibrium, longest: Array, work: WorkingRange) -> Lengths:
        """Return the lengths to sample at a pressure."""
        free_length = strains(*self._pairs(self._frames.fit(free.state.positions, Pose())))[:, 2]
        force = np.zeros_like(free.state.positions)
        force[self._body.tip, 2] = work.tension_N / len(self._body.tip)
        pulled = self._solver.follow(free, Pose(), replace(free.loads, nodal_force=force))
        pulled_length = strains(*self._pairs(self._frames.fit(pulled.state.positions, Pose())))[:, 2]
        pressure = free.loads.pressures(1)[0]
        shortened = work.compression * pressure / (pressure + _HALF_STIFF_Pa)
        if self._frames.rims.size:  # without such samples the fitted energy decreases under shortening
            shortened = max(shortened, work.least_compression)
        return Lengths(
            (1.0 - shortened) * free_length,
            free_length,
            np.maximum(1.02 * pulled_length, 1.05 * free_length),
            longest,
        )

    def _guided(self, free: state.Equilibrium, wanted_strains: Array) -> Sample:
        """Return the sample at wanted strains (s, 6), or at the last equilibrium on the way to them.

        Raises:
            ConvergenceError: no equilibrium was found.
        """
        frames = self._frames
        initial = strains(*self._pairs(frames.fit(free.state.positions, Pose())))
        solution, guides, reached_fraction, step = free, None, 0.0, 1.0
        while reached_fraction < 1.0 and step > _LEAST_STEP:
            target = frames_from_strains(
                frames.drawn[0], initial + min(1.0, reached_fraction + step) * (wanted_strains - initial)
            )
            x = solution.state.positions
            start = frames.carried(x, frames.fit(x, Pose()), target)
            try:
                solution, guides = self._pulled(solution.state, free.loads, target, start)
            except ConvergenceError:
                step *= 0.5
                continue
            reached_fraction += step
        if guides is None:
            raise ConvergenceError("no pose on the way to a sample has an equilibrium", float("nan"), 0)
        self.reached.append(min(1.0, reached_fraction))
        return self._sample(solution, guides)

    def _near(self, free: state.Equilibrium, target: Array, start: Array) -> Sample:
        """Return the sample at target frames (f, 4, 3), solved from a start (n, 3) [m] or by load steps.

        Raises:
            ConvergenceError: no equilibrium was found.
        """
        try:
            return self._sample(*self._pulled(free.state, free.loads, target, start))
        except ConvergenceError:
            return self._guided(free, self._frames.strains(target))

    def _pulled(
        self, near: state.SoftState, loads: Loads, target: Array, start: Array
    ) -> tuple[state.Equilibrium, RingGuides]:
        """Return the equilibrium under guides to target frames (f, 4, 3), from a start (n, 3) [m].

        Raises:
            ConvergenceError: no equilibrium was found.
        """
        guides = RingGuides(self._frames, self._groups, target, _GUIDE_STIFFNESS)
        return self._solver.solve(near, Pose(), replace(loads, extra=guides), start), guides

    def _sample(self, solution: state.Equilibrium, guides: RingGuides | None = None) -> Sample:
        x = solution.state.positions
        force = np.zeros_like(x) if guides is None else guides.force(x)
        fitted = self._frames.fit(x, Pose())
        volume = float(self._system.gas.enclosed_volumes(x[None]).sum())
        strain = strains(*self._pairs(fitted))
        pressure, forces = solution.loads.pressures(1)[0], self._section_forces(x, fitted, force)
        return pressure, strain, forces, volume, fitted, x, fitted if guides is None else guides.wanted

    def _section_forces(self, x: Array, frames: Array, force: Array) -> Array:
        """Return the derivatives (s, 6) of the energy from the forces beyond each section."""
        section_forces = np.empty((len(frames) - 1, 6))
        pull, moment = np.zeros(3), np.zeros(3)
        origin = frames[-1, 0]
        for s in range(len(frames) - 2, -1, -1):
            ring, r = self._frames.rings[s], frames[s + 1, 0]
            moment = moment + np.cross(origin - r, pull) + cross(x[ring] - r, force[ring]).sum(axis=0)
            pull, origin = pull + force[ring].sum(axis=0), r
            section_forces[s] = np.linalg.solve(
                _motion(frames[s], frames[s + 1]).T, np.concatenate([pull, moment])
            )
        return section_forces

    @staticmethod
    def _pairs(frames: Array) -> tuple[Array, Array]:
        return frames[:-1], frames[1:]


def _motion(near: Array, far: Array) -> Array:
    """Return d strain / d (dr, phi) (6, 6) of the far frame."""
    step, a, b = far[0] - near[0], near[1:], far[1:]
    jacobian = np.zeros((6, 6))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        jacobian[i, :3] = 0.5 * (a[i] + b[i])
        jacobian[i, 3:] = 0.5 * np.cross(b[i], step)
        jacobian[3 + i, 3:] = -0.5 * (np.cross(a[k], b[j]) - np.cross(a[j], b[k]))
    return jacobian
