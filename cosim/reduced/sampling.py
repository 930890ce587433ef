"""Samples of a film's answer at wanted poses: strains of its sections and the forces that belong to them.

Guides: springs that hold the frame of every ring near a wanted pose and leave the ring free to deform.

With J the measure of a ring's frame (see `RingFrames.measures`) at the wanted orientation,
    energy = k_t |J_r x - c|^2 / 2 + k_r |J_phi x|^2 / 2,
quadratic in the nodes. What the springs exert is what the section models are fitted to.

Guides on all rings put the frames near random wanted poses, over the working range of pressure and of
relative motion. The frames that result, and what the guides exert on them, are exact samples: beyond a
section hang known forces only, so their resultant is the derivative of its energy by its strains.
"""

from dataclasses import dataclass, replace
from typing import TypeAlias, final

import numpy as np

from cosim.base.frames import Array, IntArray, Pose, cross
from cosim.errors import ConvergenceError
from cosim.reduced.section_model import RingFrames, frames_from_strains, strains
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements import element, frame_ring
from cosim.soft.film.film import FilmPotential
from cosim.soft.linear.pattern import BlockPattern
from cosim.soft.solve import equilibrium, newton_options, state
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.self_contact import FilmContactLaw, SelfContact

_STRAIGHT = 5  # straight samples at each pressure
_BEND_MAX = 0.5
_ACROSS = np.array([1.0, 1.0, 0.0, 1.0, 1.0, 1.0])  # all strains but the length
_HALF = 2.8  # bends of half units, over what would be those of whole ones of their length
_LEAST_GAP = 0.02  # of the gap that a bend closes, left open


@final
@dataclass(frozen=True)
class WorkingRange:
    """Of what the samples are taken.

    Args:
        pressures_Pa: rising from 0.
        tension_N: axial force up to which sections are stretched.
        samples: at each pressure, besides straight and almost straight ones.
        compression: largest shortening of a section over its length without load; less at low pressure.
        least_compression: the same of square frames with hardly any gas.
        bend: largest angle between neighbouring frames, relative to that at which their rims would meet.
        fold: the same of square frames, at the length of the free film, or at half of that at the largest
            pressure if it is more.
        twist: sine of the largest angle about the axis.
        shear_m: largest shift between neighbouring frames.
        small: share of bend, twist and shear in samples that are almost straight.
    """

    pressures_Pa: tuple[float, ...]
    tension_N: float
    samples: int
    compression: float = 0.35
    least_compression: float = 0.1
    bend: float = 0.75
    fold: float = 0.9
    twist: float = 0.02
    shear_m: float = 3e-4
    small: float = 0.15


@final
@dataclass(frozen=True)
class Lengths:
    """Lengths (s,) [m] of the sections at a pressure: the shortest and longest to sample, and the free ones.

    Args:
        low: shortest.
        still: free.
        high: longest.
        longest: free at the largest pressure.
    """

    low: Array
    still: Array
    high: Array
    longest: Array


@final
@dataclass(frozen=True)
class Poses:
    """Draws wanted strains at a pressure.

    Args:
        lengths: of the sections.
        radii: (s,) [m], of the far ring of each section.
        rims: (s, n, 2) [m], see `RingFrames.rims`.
        work: working range.
    """

    lengths: Lengths
    radii: Array
    rims: Array
    work: WorkingRange

    def draw(self, random: np.random.Generator) -> list[Array]:
        """Return wanted strains (s, 6): straight ones, almost straight ones, and bent ones."""
        straight = [self._straight(fraction) for fraction in np.linspace(0.0, 1.0, _STRAIGHT)]
        # small ones tell what a section resists shear, bending and twist with, apart from one another
        small = [at + self.work.small * (self._bent(random) * _ACROSS) for at in straight for _ in range(2)]
        return straight + small + [self._bent(random) for _ in range(self.work.samples)]

    def _straight(self, fraction: Array | float) -> Array:
        """Return the strains (s, 6) of a straight chain, lengths a fraction of the way from low to high."""
        low, high = self.lengths.low, self.lengths.high
        result = np.zeros((len(low), 6))
        result[:, 2] = low + fraction * (high - low)
        return result

    def _bent(self, random: np.random.Generator) -> Array:
        """Return random strains (s, 6) that change slowly along the chain."""
        count = len(self.lengths.low)
        way = np.linspace(0.0, 1.0, count)[:, None]

        def field(size: int) -> Array:
            """Return (s, size): constant and linear parts and a little of anything, within about -1 to 1."""
            ends = random.uniform(-1.0, 1.0, (2, size))
            return np.asarray((1.0 - way) * ends[0] + way * ends[1] + random.normal(0.0, 0.05, (count, size)))

        place = np.clip(field(1)[:, 0], -1.0, 1.0)
        result = self._straight(0.5 + 0.5 * place)
        result[:, :2] = self.work.shear_m * field(2)
        bend = 1.3 * np.sqrt(random.uniform(0.0, 1.0)) * field(2)
        bend /= np.maximum(1.0, np.linalg.norm(bend, axis=1, keepdims=True))
        if self.rims.size:
            self._fold(result, place, bend)
        else:
            # rims of neighbouring frames meet at an angle of length over radius
            largest = np.minimum(self.work.bend * result[:, 2] / self.radii, _BEND_MAX)
            result[:, 3:5] = largest[:, None] * bend
        result[:, 5] = self.work.twist * field(1)[:, 0]
        return result

    def _fold(self, result: Array, place: Array, bend: Array) -> None:
        """Fill lengths and bends (s, 2) of square units: most near their free length, no rims that overlap.

        Args:
            result: strains (s, 6).
            place: (s,), -1 at the shortest, 1 at the longest.
            bend: (s, 2), at most 1.
        """
        low, still, high = self.lengths.low, self.lengths.still, self.lengths.high
        result[:, 2] = still + place * np.abs(place) * np.where(place < 0.0, still - low, high - still)
        folded = np.maximum(still, 0.5 * self.lengths.longest)
        unit = bend / np.maximum(np.linalg.norm(bend, axis=1, keepdims=True), 1e-12)
        across = np.where(self.rims.any(axis=(1, 2)), self._closed(unit), self.radii.max() / _HALF)
        largest = np.minimum(self.work.fold * folded / across, _BEND_MAX)
        result[:, 3:5] = largest[:, None] * bend
        result[:, 2] = np.maximum(result[:, 2], (1.0 + _LEAST_GAP) * self._closed(result[:, 3:5]))

    def _closed(self, bend: Array) -> Array:
        """Return (s,) [m], by how much bends (s, 2) close the gap between two square frames."""
        closed = bend[:, :1] * self.rims[:, :, 1] - bend[:, 1:] * self.rims[:, :, 0]
        return np.asarray(np.abs(closed).max(axis=1))


@final
@dataclass(frozen=True)
class RingGroup:
    """Rings of as many nodes, and where the blocks of their pairs of nodes are.

    Args:
        frame: (k,) which frames they are, less one.
        nodes: (k, m).
        slots: (k, pairs) of the pattern.
        row: (k, pairs) place in the ring of each pair's row.
        column: (k, pairs), of its column.
    """

    frame: IntArray
    nodes: IntArray
    slots: IntArray
    row: IntArray
    column: IntArray

    @classmethod
    def all_of(cls, pattern: BlockPattern, frames: RingFrames) -> "tuple[RingGroup, ...]":
        """Return the groups of all rings; the nodes of a ring are coupled in the pattern."""
        groups = []
        sizes = np.array([len(ring) for ring in frames.rings])
        for size in np.unique(sizes[sizes > 0]):
            frame = np.flatnonzero(sizes == size)
            places = [_pairs(pattern, frames.rings[f]) for f in frame]
            slots, row, column = (np.array(part) for part in zip(*places, strict=True))
            groups.append(cls(frame, np.array([frames.rings[f] for f in frame]), slots, row, column))
        return tuple(groups)


def _pairs(pattern: BlockPattern, ring: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Return (slot, place of the row's node, place of the column's node) of all pairs in a ring."""
    place = np.full(pattern.nodes, -1, dtype=np.int64)
    place[ring] = np.arange(len(ring))
    slots = np.flatnonzero((place[pattern.row] >= 0) & (place[pattern.column] >= 0))
    return slots, place[pattern.row[slots]], place[pattern.column[slots]]


@final
class RingGuides:
    """Guides of all rings to wanted frames, which are its attribute `wanted`.

    Args:
        frames: of the body.
        groups: its rings.
        wanted: (f, 4, 3), the first is the flange.
        stiffness: (6,) [N/m, N m].
    """

    def __init__(
        self, frames: RingFrames, groups: tuple[RingGroup, ...], wanted: Array, stiffness: Array
    ) -> None:
        measures = frames.measures(wanted)
        self.wanted = wanted
        self._groups, self._stiffness = groups, stiffness
        self._measures = [np.array([measures[f] for f in group.frame]) for group in groups]
        self._centers = [wanted[1 + group.frame, 0] for group in groups]
        self._blocks = [
            np.einsum("kpar,kpas->kprs", weighted, other)
            for weighted, other in (
                (_chosen(stiffness[:, None, None] * m, group.row), _chosen(m, group.column))
                for m, group in zip(self._measures, groups, strict=True)
            )
        ]

    def add(self, positions: Array, sums: element.Sums, hessian: bool) -> float:
        """Add the gradient and, if told to, the Hessian; return the energy [J]."""
        energy = 0.0
        parts = zip(self._groups, self._measures, self._centers, self._blocks, strict=True)
        for group, measure, center, own in parts:
            off = np.einsum("kamr,kmr->ka", measure, positions[group.nodes])
            off[:, :3] -= center
            pull = self._stiffness * off
            energy += 0.5 * float((pull * off).sum())
            sums.gradient[group.nodes] += np.einsum("ka,kamr->kmr", pull, measure)
            if hessian:
                sums.blocks[group.slots] += own
        return energy

    def force(self, positions: Array) -> Array:
        """Return what the springs exert on the nodes (n, 3) [N]."""
        pull = np.zeros_like(positions)
        self.add(positions, element.Sums(pull), hessian=False)
        return -pull


def _chosen(measure: Array, place: IntArray) -> Array:
    """Return the measures (k, pairs, 6, 3) of the nodes at some places (k, pairs) of each ring."""
    return np.asarray(measure.transpose(0, 2, 1, 3)[np.arange(len(place))[:, None], place])


Sample: TypeAlias = tuple[float, Array, Array, float, Array, Array, Array]
"""Pressure, strains, forces, volume, frames, nodes and target, as in `Samples`."""

_STILL = (0.0, 0.0, 0.0)
_ALMOST_STRAIGHT = 15  # first samples at each pressure
_HALF_STIFF_Pa = 2e3  # a film without gas has no length of its own to be shortened from
_LEAST_STEP = 0.1  # of the way to a sample
_REUSE_MAX, _REUSE_BELOW_N = 8, 0.01  # of factorisations on a refined mesh, near an equilibrium
_FINER_OF = 5  # of so many poses one is sampled on the refined mesh as well
_CRUMPLED_Pa = 500.0  # below: bent films of a refined mesh are not sampled
_COUPLING_N_m = 1e-9  # of rings whose nodes only need places for each other in the tangent


@final
@dataclass(frozen=True)
class Samples:
    """What was found; sections s between frames s and s + 1.

    Args:
        length_m: (pressures, s), middle of the sampled lengths of each section.
        failures: samples without a solution.
        pressure_Pa: (m,).
        strain: (m, s, 6).
        force: (m, s, 6), derivatives of the energy with respect to the strains.
        volume_m3: (m,).
        frames: (m, f, 4, 3), flange frame.
        positions: (m, n, 3) [m], of the nodes.
        target: (m, f, 4, 3), frames to which the guides pull; without guides the frames themselves.
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
        films: law of contact between its units; None where they pass through one another.
    """

    def __init__(self, body: SoftBody, frames: RingFrames, films: FilmContactLaw | None = None) -> None:
        if body.frames is None:
            rings = np.array(frames.rings[:-1])
            body = body.with_elements(frame_ring.FrameRings.from_shape(body.positions, rings, _COUPLING_N_m))
        self._frames = frames
        self._system = FilmPotential(body)
        clamp = state.Clamp.of_base(body)
        # square units are followed to where they fold; others stop where their film crumples
        iterations, shift_N_m = (60, 1e9) if frames.rims.size else (25, 1e6)
        options = newton_options.NewtonOptions(
            tolerance_N=1e-5,
            start_tolerance_N=1e-5,
            iterations_max=iterations,
            shift_max_N_m=shift_N_m,
            sees_saddles=False,
        )
        newton = NewtonSolver(self._system, clamp.mask(body.nodes))
        contact = None if films is None else SelfContact(body, films)
        self._solver = equilibrium.EquilibriumSolver(newton, clamp, options, contact, slides_max=0)
        self._groups = RingGroup.all_of(self._system.pattern, frames)
        self._slack = Loads((), (0.0,) * len(body.cables), _STILL)
        self._body = body
        self.reached: list[float] = []
        self._radii = np.array([np.linalg.norm(shape, axis=1).max() for shape in frames.shapes])

    def collect(self, work: WorkingRange, seed: int) -> Samples:
        """Return samples over a working range.

        Args:
            work: what to sample.
            seed: of the random poses.
        """
        random = np.random.default_rng(seed)
        free = self._solver.solve(state.SoftState.drawn(self._body, Pose()), Pose(), self._slack)
        longest = self._still_lengths(free, work.pressures_Pa[-1])
        rows: list[Sample] = []
        lengths, failures = [], 0
        for pressure in work.pressures_Pa:
            free = self._solver.follow(free, Pose(), replace(self._slack, pressure_Pa=(pressure,)))
            rows.append(self._sample(free))
            here = self._lengths(free, longest, work)
            lengths.append(0.5 * (here.low + here.high))
            for wanted in Poses(here, self._radii, self._frames.rims, work).draw(random):
                try:
                    rows.append(self._guided(free, wanted))
                except ConvergenceError:
                    failures += 1
        return Samples.of(rows, np.array(lengths), failures)

    def finer(self, coarse: Samples, parents: IntArray) -> Samples:
        """Return samples at some poses of a coarser mesh, each begun in the shape that was found there.

        With hardly any gas these are the straight and almost straight ones: bent films crumple then, on each
        mesh in its own way.

        Args:
            coarse: samples of the mesh whose every triangle is divided into four.
            parents: (n, 2) nodes of it that each node lies halfway between.
        """
        # its starts are near; on the coarse mesh, kept factorisations lead crumpled films to other equilibria
        near = replace(self._solver.options, reuse_max=_REUSE_MAX, reuse_below_N=_REUSE_BELOW_N)
        self._solver.options = near
        free = self._solver.solve(state.SoftState.drawn(self._body, Pose()), Pose(), self._slack)
        rows, failures, off = list[Sample](), 0, np.zeros_like(free.state.positions)
        for level, pressure in enumerate(np.unique(coarse.pressure_Pa).tolist()):
            first, *others = np.flatnonzero(coarse.pressure_Pa == pressure).tolist()
            here = coarse.positions[first][parents].mean(axis=1)
            free = self._freed(free, pressure, here + off)
            rows.append(self._sample(free))
            off = free.state.positions - here
            most = len(others) if pressure > _CRUMPLED_Pa else _ALMOST_STRAIGHT
            for k in others[level % _FINER_OF : most : _FINER_OF]:
                start = coarse.positions[k][parents].mean(axis=1)
                try:
                    rows.append(self._near(free, coarse.target[k], start))
                except ConvergenceError:
                    failures += 1
        return Samples.of(rows, coarse.length_m, failures)

    def _freed(self, free: state.Equilibrium, pressure_Pa: float, start: Array) -> state.Equilibrium:
        """Return the film without load at another pressure, from a start (n, 3) [m] where that serves."""
        loads = replace(self._slack, pressure_Pa=(pressure_Pa,))
        try:
            return self._solver.solve(free.state, Pose(), loads, start)
        except ConvergenceError:
            return self._solver.follow(free, Pose(), loads)

    def _still_lengths(self, free: state.Equilibrium, pressure_Pa: float) -> Array:
        """Return the lengths (s,) [m] of the sections without load; of squares, others need none."""
        if self._frames.rims.size:
            free = self._solver.follow(free, Pose(), replace(self._slack, pressure_Pa=(pressure_Pa,)))
        return strains(*self._pairs(self._frames.fit(free.state.positions, Pose())))[:, 2]

    def _lengths(self, free: state.Equilibrium, longest: Array, work: WorkingRange) -> Lengths:
        """Return the lengths to sample at a pressure."""
        still = strains(*self._pairs(self._frames.fit(free.state.positions, Pose())))[:, 2]
        force = np.zeros_like(free.state.positions)
        force[self._body.tip, 2] = work.tension_N / len(self._body.tip)
        pulled = self._solver.follow(free, Pose(), replace(free.loads, nodal_force=force))
        long = strains(*self._pairs(self._frames.fit(pulled.state.positions, Pose())))[:, 2]
        pressure = free.loads.pressures(1)[0]
        shortened = work.compression * pressure / (pressure + _HALF_STIFF_Pa)
        if self._frames.rims.size:  # without such samples an energy falls where a film is shortened
            shortened = max(shortened, work.least_compression)
        return Lengths((1.0 - shortened) * still, still, np.maximum(1.02 * long, 1.05 * still), longest)

    def _guided(self, free: state.Equilibrium, wanted: Array) -> Sample:
        """Return the sample at wanted strains (s, 6), or as far on the way there as the film goes.

        Raises:
            ConvergenceError: it goes nowhere.
        """
        frames = self._frames
        here = strains(*self._pairs(frames.fit(free.state.positions, Pose())))
        found, guides, done, step = free, None, 0.0, 1.0
        while done < 1.0 and step > _LEAST_STEP:
            target = frames_from_strains(frames.drawn[0], here + min(1.0, done + step) * (wanted - here))
            x = found.state.positions
            start = frames.carried(x, frames.fit(x, Pose()), target)
            try:
                found, guides = self._pulled(found.state, free.loads, target, start)
            except ConvergenceError:
                step *= 0.5
                continue
            done += step
        if guides is None:
            raise ConvergenceError("no pose on the way to a sample has an equilibrium", float("nan"), 0)
        self.reached.append(min(1.0, done))
        return self._sample(found, guides)

    def _near(self, free: state.Equilibrium, target: Array, start: Array) -> Sample:
        """Return the sample at target frames (f, 4, 3) from a start (n, 3) [m], or else on the way there.

        Raises:
            ConvergenceError: the film goes nowhere.
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
            ConvergenceError: none was found.
        """
        guides = RingGuides(self._frames, self._groups, target, _GUIDE_STIFFNESS)
        return self._solver.solve(near, Pose(), replace(loads, extra=guides), start), guides

    def _sample(self, found: state.Equilibrium, guides: RingGuides | None = None) -> Sample:
        x = found.state.positions
        force = np.zeros_like(x) if guides is None else guides.force(x)
        here = self._frames.fit(x, Pose())
        volume = float(self._system.gas.enclosed_volumes(x[None]).sum())
        strain = strains(*self._pairs(here))
        pressure, forces = found.loads.pressures(1)[0], self._section_forces(x, here, force)
        return pressure, strain, forces, volume, here, x, here if guides is None else guides.wanted

    def _section_forces(self, x: Array, frames: Array, force: Array) -> Array:
        """Return the derivatives (s, 6) of the energy: what is beyond each section pulls at its far frame."""
        result = np.empty((len(frames) - 1, 6))
        pull, moment = np.zeros(3), np.zeros(3)
        origin = frames[-1, 0]
        for s in range(len(frames) - 2, -1, -1):
            ring, r = self._frames.rings[s], frames[s + 1, 0]
            moment = moment + np.cross(origin - r, pull) + cross(x[ring] - r, force[ring]).sum(axis=0)
            pull, origin = pull + force[ring].sum(axis=0), r
            result[s] = np.linalg.solve(_motion(frames[s], frames[s + 1]).T, np.concatenate([pull, moment]))
        return result

    @staticmethod
    def _pairs(frames: Array) -> tuple[Array, Array]:
        return frames[:-1], frames[1:]


# far above a section's own stiffness in bending and length, so that it goes where it is sent; below it in
# shear and twist, which then come from what the section needs
_GUIDE_STIFFNESS = np.array([3e4, 3e4, 3e4, 30.0, 30.0, 30.0])


def _motion(before: Array, after: Array) -> Array:
    """Return d strain / d (dr, phi) (6, 6) of the far frame."""
    step, a, b = after[0] - before[0], before[1:], after[1:]
    result = np.zeros((6, 6))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        result[i, :3] = 0.5 * (a[i] + b[i])
        result[i, 3:] = 0.5 * np.cross(b[i], step)
        result[3 + i, 3:] = -0.5 * (np.cross(a[k], b[j]) - np.cross(a[j], b[k]))
    return result
