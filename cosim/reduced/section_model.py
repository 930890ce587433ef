"""The section model of a stack of units over its working range, and the frames of its rings. Outer rings have
the cables' eyelets and stay flat while the film between them is inflated and bent. The frame of a ring has
its origin r at the mean of the nodes and the axes R that fit them best, sum_i R D_i x (x_i - r) = 0 with the
drawn offsets D_i: the ring may stretch and warp. A frame is four points (4, 3): origin and unit axes.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose, cross_matrix, rotation_from_vector
from cosim.errors import InputError
from cosim.reduced.sections.chain_shape import GasTables, chain_points, combine_points, gas_volumes
from cosim.reduced.sections.coefficients import COEFFICIENTS, HIGH, POLYNOMIAL
from cosim.reduced.sections.pressure_spline import PressureSpline
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.gas import SealedGas

POINTS = 4
_SAME = 1e-3  # of a radius
STRAINS: Final = ("shear", "length", "bending", "twist")
"""Kinds of strain in `SectionModel.held_out`."""
_REACH_PRESSURES = 20
_REACH_MARGIN = 1.05  # of lengths along the axes over those across: sections are sheared a little


def points_of(pose: Pose) -> Array:
    """Return the four points of a pose."""
    return np.vstack([pose.translation, pose.rotation.T])


def carried(frames: Array, motion: Pose) -> Array:
    """Return the frames (f, 4, 3) moved rigidly by a motion, world to world."""
    moved_frames = frames @ motion.rotation.T
    moved_frames[:, 0] += motion.translation
    return np.ascontiguousarray(moved_frames)


@final
@dataclass(frozen=True)
class RingFrames:
    """Rings that are frames, and the motion of the other nodes with them.

    Frame 0 is the flange. Of one stack it holds the first ring of the centre line, and the chain begins
    there. Copies have chains side by side; each begins at a frame that moves with the flange.

    Args:
        rings: nodes of frames 1, 2, ...; of a frame at which a copy begins none: the flange holds it.
        shapes: their drawn offsets (m, 3) [m] from the mean.
        drawn: (f, 4, 3), all frames as drawn, in the flange frame.
        near: (s,) the frame before each section; the next one is near + 1.
        before: (n,) the frame before each node; the next one is before + 1.
        fraction: (n,) how far on the way from that frame to the next it is drawn, 0 to 1.
        copies: how many chains there are.
        folds: whether square units have rims, see `rims`.
    """

    rings: tuple[IntArray, ...]
    shapes: tuple[Array, ...]
    drawn: Array
    near: IntArray
    before: IntArray
    fraction: Array
    copies: int = 1
    folds: bool = False

    @classmethod
    def of(cls, body: SoftBody) -> RingFrames:
        """Return the frames of a body.

        Raises:
            InputError: it has no rings for frames, is not held at the first of its centre, or feels rates.
        """
        copies = len(body.copies)
        if not copies and any("/" in name for name in body.rings):
            raise InputError(
                "section models are of one stack of units or its copies; this one is attached to; "
                "use fidelity = 'lumped'"
            )
        for element in (element for element in body.elements if element.remembers_steps):
            raise InputError(
                f"section models have no rates; this soft robot has {element.label}; use fidelity = 'lumped'"
            )
        base_nodes = len(body.base) // max(copies, 1)
        first = body.rings[body.center_rings[0]] if body.center_rings else body.base[:0]
        if not body.frame_rings or set(body.base[:base_nodes].tolist()) != set(first.tolist()):
            raise InputError(
                "section models need frame rings, and a base at the first ring of the centre: a stack of "
                "units held at unit_1.hole; use fidelity = 'lumped'"
            )
        rings = (*(body.rings[name] for name in body.frame_rings), body.tip)
        if not copies:
            return cls._of_stack(body.positions, rings)
        stack = body.positions[: body.nodes // copies]
        return cls._of_stack(body.copies[0].inverse().apply(stack), rings)._copied(body.copies)

    @classmethod
    def _of_stack(cls, positions: Array, rings: tuple[IntArray, ...]) -> RingFrames:
        """Return the frames of one stack along the z axis, with nodes (n, 3) [m]."""
        shapes = tuple(positions[ring] - positions[ring].mean(axis=0) for ring in rings)
        drawn = np.zeros((len(rings) + 1, POINTS, 3))
        drawn[:, 1:] = np.eye(3)
        drawn[1:, 0] = [positions[ring].mean(axis=0) for ring in rings]
        heights = drawn[:, 0, 2]
        z = positions[:, 2]
        before = np.clip(np.searchsorted(heights, z, side="right") - 1, 0, len(rings) - 1)
        fraction = np.clip((z - heights[before]) / (heights[before + 1] - heights[before]), 0.0, 1.0)
        for f, ring in enumerate(rings, start=1):  # exactly on its frame, without rounding of its height
            before[ring], fraction[ring] = min(f, len(rings) - 1), float(f == len(rings))
        return cls(rings, shapes, drawn, np.arange(len(rings)), before.astype(np.int64), fraction)

    def _copied(self, poses: tuple[Pose, ...]) -> RingFrames:
        """Return the frames of copies of one stack, at poses in the flange frame."""
        nodes, frames = len(self.before), len(self)
        begins = 1 + frames * np.arange(len(poses))
        no_ring, no_shape = np.zeros(0, np.int64), np.zeros((0, 3))
        rings = [ring for k in range(len(poses)) for ring in (no_ring, *(r + nodes * k for r in self.rings))]
        drawn = np.concatenate([points_of(Pose())[None], *(carried(self.drawn, pose) for pose in poses)])
        return RingFrames(
            tuple(rings),
            (no_shape, *self.shapes) * len(poses),
            drawn,
            (begins[:, None] + self.near).ravel(),
            (begins[:, None] + self.before).ravel(),
            np.tile(self.fraction, len(poses)),
            len(poses),
        )

    @property
    def chains(self) -> list[slice]:
        """The frames of each chain, base to tip."""
        count = len(self.near) // self.copies + 1
        first = len(self) - count * self.copies
        return [slice(first + count * k, first + count * (k + 1)) for k in range(self.copies)]

    @cached_property
    def rims(self) -> Array:
        """Corners (s, 4, 2) [m] of the frames of each section: of squares alike, zero of half units.

        Of other units (s, 0, 2).
        """
        corners = [_square(shape) for shape in self.shapes]
        rims = np.zeros((len(self.near), 4, 2))
        for s, frame in enumerate(self.near.tolist()):
            first, second = corners[max(frame - 1, 0)], corners[frame]
            if frame and len(first) and len(second) and np.allclose(first, second, rtol=_SAME):
                rims[s] = second
        return rims if self.folds and rims.any() else rims[:, :0]

    @property
    def bases(self) -> Mask:
        """(f,) the frames without a ring, fixed to the flange."""
        return np.array([True, *(len(ring) == 0 for ring in self.rings)])

    def strains(self, frames: Array) -> Array:
        """Return the strains (s, 6) of all sections of frames (f, 4, 3)."""
        return strains(frames[self.near], frames[self.near + 1])

    def strained(self, frames: Array, values: Array) -> Array:
        """Return frames (f, 4, 3) with other strains (s, 6); the first frame of each chain stays."""
        strained_frames = frames.copy()
        for chain, strain in zip(self.chains, np.split(values, self.copies), strict=True):
            strained_frames[chain] = frames_from_strains(frames[chain.start], strain)
        return strained_frames

    def __len__(self) -> int:
        return len(self.rings) + 1

    def fit(self, positions: Array, flange: Pose) -> Array:
        """Return the frames (f, 4, 3) of a film at node positions (n, 3) [m]."""
        frames = np.empty((len(self), POINTS, 3))
        frames[0] = points_of(flange)
        for f, (ring, shape) in enumerate(zip(self.rings, self.shapes, strict=True), start=1):
            if not len(ring):
                frames[f] = carried(self.drawn[f : f + 1], flange)[0]
                continue
            center = positions[ring].mean(axis=0)
            u, _, v = np.linalg.svd((positions[ring] - center).T @ shape)
            # a ring is flat: the sign of its third axis is that of a rotation
            u[:, 2] *= np.linalg.det(u @ v)
            frames[f] = np.vstack([center, (u @ v).T])
        return frames

    def measures(self, frames: Array) -> list[Array]:
        """Return for each ring the linear measure J (6, m, 3) of its frame's motion: (dr, phi) = J dx.

        phi = K^-1 sum_i R D_i x dx_i with K = sum_i |D_i|^2 1 - (R D_i)(R D_i)^T. Its transpose distributes a
        force and a moment over the ring, so that they do no work on deformations of the ring.

        Args:
            frames: (f, 4, 3), orientations R.
        """
        measures = []
        for frame, shape in zip(frames[1:], self.shapes, strict=True):
            arm = shape @ frame[1:]
            measure = np.empty((6, len(arm), 3))
            if not len(arm):  # where a copy begins
                measures.append(measure)
                continue
            measure[:3] = np.eye(3)[:, None, :] / len(arm)
            inverse = np.linalg.inv((arm**2).sum() * np.eye(3) - arm.T @ arm)
            measure[3:] = (inverse @ np.array([cross_matrix(a) for a in arm])).transpose(1, 0, 2)
            measures.append(measure)
        return measures

    def carried(self, positions: Array, frames: Array, moved: Array) -> Array:
        """Return the film after a motion of its frames, each node moved by the two frames next to it.

        Args:
            positions: (n, 3) [m].
            frames: (f, 4, 3), its frames.
            moved: (f, 4, 3), the frames after the motion.
        """
        moved_positions = np.zeros_like(positions)
        for frame, weight in ((self.before, 1.0 - self.fraction), (self.before + 1, self.fraction)):
            local = np.einsum("nar,nr->na", frames[frame, 1:], positions - frames[frame, 0])
            points = moved[frame, 0] + np.einsum("na,nar->nr", local, moved[frame, 1:])
            moved_positions += weight[:, None] * points
        return moved_positions

    def masses(self, node_mass: Array, positions: Array) -> Array:
        """Return the mass matrix (f, 4, 4) of each frame's points; two frames divide the nodes between them.

        The mass of a node is in the planes of the two frames, with its center of mass at the node's height.

        Args:
            node_mass: (n,) [kg].
            positions: (n, 3) [m], drawn shape.
        """
        mass_matrices = np.zeros((len(self), POINTS, POINTS))
        for frame, weight in ((self.before, 1.0 - self.fraction), (self.before + 1, self.fraction)):
            local = np.einsum("nr,nar->na", positions - self.drawn[frame, 0], self.drawn[frame, 1:])
            point = np.concatenate([np.ones((len(local), 1)), local], axis=1)
            point[:, 3] = 0.0
            np.add.at(mass_matrices, frame, np.einsum("n,na,nb->nab", weight * node_mass, point, point))
        return mass_matrices


def _square(shape: Array) -> Array:
    """Return the corners (4, 2) [m] of a ring (m, 3) around them; (0, 2) if it is no square."""
    radius = np.linalg.norm(shape[:, :2], axis=1)
    corners = shape[radius > (1.0 - _SAME) * radius.max(initial=0.0), :2]
    corners = corners[np.argsort(np.arctan2(corners[:, 1], corners[:, 0]))]
    square = len(corners) == 4 and abs(corners[0] @ corners[1]) < _SAME * radius.max() ** 2
    return corners if square else np.zeros((0, 2))


def strains(before: Array, after: Array) -> Array:
    """Return the strains (s, 6) of sections between frames (s, 4, 3) and the next ones; see `chain`."""
    step = (after[:, 0] - before[:, 0])[:, None, :]
    a, b = before[:, 1:], after[:, 1:]
    stretch = 0.5 * ((a + b) * step).sum(axis=2)
    turn = np.einsum("sir,sjr->sij", a, b)
    skew = 0.5 * np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1
    )
    return np.concatenate([stretch, skew], axis=1)


def frames_from_strains(first: Array, values: Array) -> Array:
    """Return the chain of frames (s + 1, 4, 3) that begins with `first` (4, 3) and has strains (s, 6)."""
    frames = [first]
    for value in values:
        axes = frames[-1][1:].T
        sine = float(np.linalg.norm(value[3:]))
        angle = np.arcsin(min(sine, 1.0))  # frames at right angles may round to a sine above 1
        turn = rotation_from_vector(value[3:] * (angle / sine if sine > 0.0 else 1.0))
        # u = ((1 + turn) / 2)^T step, seen from the frame before
        step = np.linalg.solve(0.5 * (np.eye(3) + turn).T, value[:3])
        frames.append(np.vstack([frames[-1][0] + axes @ step, (axes @ turn).T]))
    return np.array(frames)


@final
@dataclass(frozen=True)
class SectionModel:
    """Coefficients over pressure; functions of pressure are splines with `spline.size` coefficients.

    Args:
        spline: over the range of pressure.
        energy: (size, s, COEFFICIENTS + 3), see `energy`; the last three are the limits.
        length: (size, s) [m], L of each section.
        gas: (size,) [J], part of the gas' potential -int V dp that is not in the energies of the sections.
        nodes: (size, n, 2, 4), each node as a combination of the points of the two frames next to it.
        held_out: (p, 9), of each sampled pressure [Pa] the median and the largest error of the forces of each
            of `STRAINS`, at samples that were not fitted, over their root mean square there, of all sections.
        samples: that were solved.
        failures: poses at which the film had no equilibrium.
        tips: (k, 3), of loads that the model was not built from the pressure [Pa], the distance [m] of its
            tip from the film's, infinite where it has no equilibrium, and the film's length [m].
    """

    spline: PressureSpline
    energy: Array
    length: Array
    gas: Array
    nodes: Array
    held_out: Array
    samples: int
    failures: int
    tips: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def tip_error_m(self) -> float:
        """Largest distance [m] of the tip from the film's; not a number before it was compared."""
        return float(self.tips[:, 1].max()) if len(self.tips) else float("nan")

    @property
    def tip_error(self) -> float:
        """The same over the film's length."""
        return float((self.tips[:, 1] / self.tips[:, 2]).max()) if len(self.tips) else float("nan")

    def times(self, copies: int) -> SectionModel:
        """Return the model of a number of copies side by side."""
        energy, length = np.tile(self.energy, (1, copies, 1)), np.tile(self.length, (1, copies))
        return replace(self, energy=energy, length=length, nodes=np.tile(self.nodes, (1, copies, 1, 1)))


@final
class SectionBody:
    """A stack of units as a chain of frames, or copies of it as chains side by side.

    Args:
        body: whose film it is.
        model: condensed from that film, of one copy.
    """

    def __init__(self, body: SoftBody, model: SectionModel) -> None:
        folds = bool(model.energy[:, :, POLYNOMIAL:COEFFICIENTS].any())
        self.frames = replace(RingFrames.of(body), folds=folds)
        self.copies = self.frames.copies
        self.body, self.model = body, model.times(self.copies)
        model = self.model
        self.mass = self.frames.masses(body.node_mass, body.positions)
        self.mass_kg = float(self.mass[:, 0, 0].sum())
        self._one = model.length.shape[1] // self.copies
        size = model.spline.size
        self._energies = np.ascontiguousarray(model.energy.reshape(size, -1))
        self._lengths = np.ascontiguousarray(model.length)
        self._films = np.ascontiguousarray(model.nodes.reshape(size, -1))
        self._nodes = np.zeros((body.nodes, 2, 4))
        self._nodes_at = self._pressure = np.nan
        self.coefficients: Array = np.zeros(model.energy.shape[1:])
        self.inverse_length: Array = np.zeros(model.length.shape[1])

    @cached_property
    def reach_m(self) -> float:
        """A distance [m] from the flange's origin that no node exceeds: all sections stretched to their ends.

        Nodes are between their frames, and no farther from the axis than drawn, as gas draws rims inwards.
        """
        spline, model = self.model.spline, self.model
        spline_values = np.array(
            [spline.basis(pressure)[0] for pressure in spline.pressures(_REACH_PRESSURES)]
        )
        stretch = np.einsum("pk,ks->ps", spline_values, model.energy[:, :, HIGH])
        longest_m = ((spline_values @ model.length) * (1.0 + stretch))[:, : self._one]
        frames = self.frames
        base, nodes = (
            frames.drawn[frames.chains[0].start],
            self.body.positions[: len(frames.before) // self.copies],
        )
        radius = float(np.linalg.norm((nodes - base[0]) @ base[1:3].T, axis=1).max())
        return float(np.linalg.norm(base[0])) + _REACH_MARGIN * (float(longest_m.sum(axis=1).max()) + radius)

    @property
    def chain(self) -> tuple[Array, Array, IntArray, Array, Array]:
        """Coefficients (s, c), 1 / L (s,) [1/m], near (s,), rims and masses (f, 4, 4) for the kernels."""
        return self.coefficients, self.inverse_length, self.frames.near, self.frames.rims, self.mass

    def set_pressure(self, pressure_Pa: float) -> None:
        """Bring coefficients and lengths to a pressure."""
        if pressure_Pa == self._pressure:
            return
        self._pressure = pressure_Pa
        spline = self.model.spline
        spline.fill(pressure_Pa, self._energies, self.coefficients.reshape(-1))
        spline.fill(pressure_Pa, self._lengths, self.inverse_length)
        np.divide(1.0, self.inverse_length, out=self.inverse_length)

    def volume(self, frames: Array) -> Array:
        """Return the volumes (copies,) [m^3] enclosed at frames (f, 4, 3), at the present pressure."""
        volumes_m3: Array = self.volumes(frames[None], np.array([self._pressure]))[0]
        return volumes_m3

    def pressure(self, loads: Loads) -> float:
        """Return the gauge pressure [Pa] of the gas under loads.

        Raises:
            InputError: pressures of copies differ.
        """
        values = loads.pressures(self.copies)
        if self.copies > 1 and min(values) != max(values):
            raise InputError(
                f"pressures of copies are {min(values):g} to {max(values):g} Pa; section models of copies "
                "have one for all; use fidelity = 'lumped'"
            )
        return values[0]

    def gas(self, loads: Loads) -> SealedGas | None:
        """Return the sealed gas of loads; None where its pressure is commanded.

        Raises:
            InputError: there are copies, each with the pressure of its own gas.
        """
        if not loads.gas:
            return None
        gases = loads.gases(self.copies)
        if self.copies > 1 and any(gas is not None for gas in gases):
            raise InputError("section models of copies need commanded pressures; use fidelity = 'lumped'")
        return gases[0]

    def straight(self, pressure_Pa: float) -> Array:
        """Return the frames (f, 4, 3) of a straight chain with sections in the middle of their range."""
        frames = self.frames.drawn.copy()
        length = self.model.spline.basis(pressure_Pa)[0] @ self.model.length
        return self.frames.strained(frames, np.outer(length, (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)))

    def stretched(self, frames: Array, before_Pa: float, after_Pa: float) -> Array:
        """Return the frames (f, 4, 3) at another pressure, each section at the same place in its range."""
        spline, length = self.model.spline, self.model.length
        values = self.frames.strains(frames)
        values[:, 2] *= (spline.basis(after_Pa)[0] @ length) / (spline.basis(before_Pa)[0] @ length)
        return self.frames.strained(frames, values)

    def node_weights(self, pressure_Pa: float) -> Array:
        """Return (n, 2, 4): each node as a combination of the points of the frames next to it."""
        if pressure_Pa != self._nodes_at:
            self._nodes_at = pressure_Pa
            self.model.spline.fill(pressure_Pa, self._films, self._nodes.reshape(-1))
        return self._nodes

    def positions(self, frames: Array, pressure_Pa: float) -> Array:
        """Return the nodes (n, 3) [m] of the film on frames (f, 4, 3)."""
        nodes = np.empty((len(self._nodes), 3))
        combine_points(frames, self.frames.before, self.node_weights(pressure_Pa), nodes)
        return nodes

    def films(self, frames: Array, pressure_Pa: Array) -> Array:
        """Return the nodes (k, n, 3) [m] of the film on chains (k, f, 4, 3) at pressures (k,)."""
        return self.points(frames, pressure_Pa, self._films, self.frames.before)

    def points(self, frames: Array, pressure_Pa: Array, table: Array, before: IntArray) -> Array:
        """Return points (k, n, 3) [m] of chains (k, f, 4, 3) at pressures (k,).

        Args:
            frames: (k, f, 4, 3).
            pressure_Pa: (k,).
            table: (size, 8 n), combinations as in `SectionModel.nodes`.
            before: (n,), the first of the two frames that each point is between.
        """
        points = np.empty((len(frames), len(before), 3))
        chain_points(frames, pressure_Pa, self.model.spline, table, before, points)
        return points

    def volumes(self, frames: Array, pressure_Pa: Array) -> Array:
        """Return the volumes (k, copies) [m^3] enclosed by chains (k, f, 4, 3) at pressures (k,)."""
        tables = GasTables(self._energies, self._lengths, self.model.gas, self.frames.near, self.frames.rims)
        volumes_m3 = np.empty((len(frames), self.copies))
        gas_volumes(frames, pressure_Pa, self.model.spline, tables, volumes_m3)
        return volumes_m3

    def spread(self, nodal: Array, pressure_Pa: float) -> Array:
        """Return the loads (f, 4, 3) on the frames' points of forces (n, 3) [N] on the nodes."""
        weights, before = self.node_weights(pressure_Pa), self.frames.before
        loads = np.zeros((len(self.frames), 4, 3))
        np.add.at(loads, before, weights[:, 0, :, None] * nodal[:, None, :])
        np.add.at(loads, before + 1, weights[:, 1, :, None] * nodal[:, None, :])
        return loads
