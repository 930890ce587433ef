"""Builds the section model of a soft body: samples it, fits, and compares the two at other loads.

Fits section models to samples: linear least squares, everything a spline over pressure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.errors import ConvergenceError
from cosim.reduced.fit.sampling import Sampler, Samples, WorkingRange
from cosim.reduced.section_model import SectionBody, SectionModel
from cosim.reduced.sections.ring_frames import RingFrames, corners
from cosim.reduced.sections.section_energy import (
    BEND,
    COEFFICIENTS,
    COLUMNS,
    LINE,
    ROWS,
    TURNED,
    Y_CELLS,
    Z_CELLS,
    Z_FROM,
    PressureSpline,
    basis,
    bends,
)
from cosim.reduced.solve.newton import ChainSolver
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions, Outcome
from cosim.soft.solve.self_contact import FilmContactLaw, SelfContact
from cosim.soft.solve.state import Clamp, Equilibrium, SoftState

_RIDGE = 1e-5  # of coefficients scaled by what they do in the samples: what those leave open stays small
_LEAST_RIDGE = 1e-10  # the same of splines, whose sum has no force
_SMOOTH = 1e-6  # weight of second differences over strains
_BENT_LITTLE = 4  # splines over y
_LIMP_Pa = 3e3
_LEAST_STIFF = 0.1  # against bending, of its median over the samples
_ONE_SIDED, _ROUNDS_MAX = 10.0, 6  # weight of differences that would be below zero, and rounds to find them
_LEAST_BEND = 1e-3
_HELD_OUT = 8  # of so many samples one is not fitted
_LEAST_SHARE, _LEAST_AXIAL = 0.1, 1.0  # of the usual size: what is smaller counts as this
_BEYOND, _LEAST_BEYOND = 0.15, 0.12  # of the sampled range of lengths, of the length, on either side
_FARTHEST_BEND = 1.25  # over the largest sampled


def fit_model(
    samples: Samples, frames: RingFrames, spline: PressureSpline, smoothing: float = 1e-3
) -> SectionModel:
    """Return the model of a stack of units; sections that are alike have one energy.

    Args:
        samples: over its working range.
        frames: of its rings.
        spline: basis over that range of pressure.
        smoothing: weight of second differences over pressure.
    """
    over = np.array([spline.basis(p) for p in samples.pressure_Pa])  # (m, 2, size)
    levels = np.unique(samples.pressure_Pa)
    at_levels = np.array([spline.basis(p)[0] for p in levels])
    means = samples.length_m.copy()
    for group in frames.alike:
        means[:, group] = samples.length_m[:, group].mean(axis=1, keepdims=True)
    length = np.linalg.lstsq(at_levels, means, rcond=None)[0]
    size, sections = length.shape
    energy, errors = np.empty((size, sections, COLUMNS)), list[Array]()
    for group in frames.alike:
        some = _Sections(samples, group, over[:, 0], length[:, group[0]], frames)
        found, error = some.fitted(smoothing, spline)
        energy[:, group] = np.concatenate([found, some.limits(), some.constants(size)], axis=1)[:, None]
        errors += [error] * len(group)
    return SectionModel(
        spline,
        energy,
        length,
        _fit_gas(samples, over, energy, length),
        _fit_nodes(samples, frames, over[:, 0]),
        np.sqrt(np.mean(np.array(errors) ** 2, axis=0)),
        len(samples.pressure_Pa),
        samples.failures,
    )


@final
class _Sections:
    """Samples of some sections that are alike.

    Args:
        samples: of all.
        group: which sections.
        over: (m, size), the splines at the samples' pressures.
        length: (size,) [m], L.
        frames: of the stack.
    """

    def __init__(
        self, samples: Samples, group: list[int], over: Array, length: Array, frames: RingFrames
    ) -> None:
        count = len(group)
        self.strain = np.concatenate([samples.strain[:, s] for s in group])
        self.force = np.concatenate([samples.force[:, s] for s in group])
        self.pressure, self.over = np.tile(samples.pressure_Pa, count), np.tile(over, (count, 1))
        row = np.tile(np.arange(len(over)), count)
        self.kept = (row // _HELD_OUT) % _HELD_OUT != _HELD_OUT - 1  # ways, not single samples
        self.length = self.over @ length
        self.place, self.bend = self.strain[:, 2] / self.length - 1.0, np.hypot(*self.strain[:, 3:5].T)
        self.corners, angle = corners(frames.shapes[max(group[0] - 1, 0)])
        phase = self.corners * angle
        low, high, end = self.place.min(), self.place.max(), max(float(bends(self.bend).max()), _LEAST_BEND)
        step = max(high - low, _LEAST_BEND) / Z_CELLS
        # q changes its sign where a section is turned around: of one that is alike then nothing hangs on it
        self.without = TURNED if frames.symmetric(group[0]) else slice(0)
        self.fixed = np.array([low, step, end / Y_CELLS, self.corners, np.cos(phase), np.sin(phase)])

    def constants(self, size: int) -> Array:
        """Return (size, constants): what is alike at all pressures, as splines."""
        return np.tile(self.fixed, (size, 1))

    def limits(self) -> Array:
        """Return splines (size, 3) of the limits: how far beyond its samples a section may go."""
        rows, at_levels = [], []
        for level in np.unique(self.pressure):
            here = self.pressure == level
            low, high = self.place[here].min(), self.place[here].max()
            margin = max(_BEYOND * (high - low), _LEAST_BEYOND)
            rows.append([low - margin, high + margin, (_FARTHEST_BEND * self.bend[here].max()) ** 2])
            at_levels.append(self.over[here][0])
        return np.asarray(np.linalg.lstsq(np.array(at_levels), np.array(rows), rcond=None)[0])

    def _squares(self) -> Array:
        """Return b as splines (LINE,) over y: b = y^2 + 2 y_0 y."""
        step = self.fixed[2]
        y = step * (np.arange(LINE) - 1.0)
        return np.asarray(y * y - step * step / 3.0 + 2.0 * BEND * y)

    def fitted(self, smoothing: float, spline: PressureSpline) -> tuple[Array, Array]:
        """Return the coefficients (size, c), and the relative error (6,) over samples held out."""
        weight = _weights(self.pressure, self.force)
        size, wanted = self.over.shape[1], self.force * weight
        normal, load = np.zeros((size, COEFFICIENTS, size, COEFFICIENTS)), np.zeros((size, COEFFICIENTS))
        left: list[tuple[Array, Array, Array]] = []
        for level in np.unique(self.pressure):  # all samples of a pressure have the same splines
            here = np.flatnonzero(self.pressure == level)
            _, gradient = _terms(self.strain[here], 1.0 / self.length[here], self.fixed)
            gradient[:, :, self.without] = 0.0
            rows, over = gradient * weight[here][:, :, None], self.over[here[0]]
            kept = self.kept[here]
            matrix, right = rows[kept].reshape(-1, COEFFICIENTS), wanted[here][kept].ravel()
            normal += np.einsum("i,j,ck->icjk", over, over, matrix.T @ matrix)
            load += np.outer(over, matrix.T @ right)
            left.append((rows[~kept], wanted[here][~kept], over))
        bent = self.bend > _LEAST_BEND
        stiff = float(np.median(np.hypot(*self.force[bent, 3:5].T) / self.bend[bent]))
        # of straight sections, 2 dA/dy dy/db
        least = _LEAST_STIFF * stiff * self.fixed[2] * BEND
        found = _regularised(normal, load, 6 * int(self.kept.sum()), smoothing, least)
        found[:, : ROWS * LINE] += 0.5 * stiff * np.outer(_limpness(spline), np.tile(self._squares(), ROWS))
        off = np.concatenate([(rows @ (over @ found) - want) ** 2 for rows, want, over in left])
        mean = np.concatenate([want**2 for _, want, _ in left]).mean(axis=0)
        return found, np.sqrt(np.median(off, axis=0) / np.maximum(mean, 1e-30))


def _terms(strain: Array, inverse_length: Array, fixed: Array) -> tuple[Array, Array]:
    """Return values (m, c) and gradients (m, 6, c) of the energy's terms."""
    count = len(strain)
    values, gradients = np.zeros((count, COEFFICIENTS)), np.zeros((count, 6, COEFFICIENTS))
    rows = np.ascontiguousarray(strain), np.ascontiguousarray(inverse_length)
    basis(*rows, np.ascontiguousarray(fixed), values, gradients)
    return values, gradients


def _regularised(normal: Array, load: Array, count: int, smoothing: float, least: float) -> Array:
    """Return the coefficients (size, c) of normal equations (size, c, size, c) of so many rows.

    Second differences over pressure, over z and over y are kept small, those of all coefficients times
    what they do in the samples: splines with many knots then do not swing between samples, and go on as
    straight lines where there are none. A rises along y by `least` [J] from spline to spline at least, and the
    force of what is bent little rises with its length: where a film hardly resists, as without gas, the
    errors of a fit would else fold the chain. Source: Eilers and Marx, Statistical Science 11 (1996) 89.
    """
    size = len(load)
    scale = np.sqrt(np.einsum("icic->c", normal) / (size * count))
    scale[scale == 0.0] = 1.0
    scale[: ROWS * LINE] = np.sqrt((scale[: ROWS * LINE] ** 2).mean())
    full, right = normal / (scale[:, None, None] * scale), load / scale
    for c in range(COEFFICIENTS):
        full[:, c, :, c] += count * (_RIDGE * (c >= ROWS * LINE) + _LEAST_RIDGE) * np.eye(size)
        full[:, c, :, c] += count * smoothing * _seconds(size)
    shape = np.kron(_seconds(ROWS), np.eye(LINE)) + np.kron(np.eye(ROWS), _seconds(LINE))
    for k in range(size):
        full[k, : ROWS * LINE, k, : ROWS * LINE] += count * _SMOOTH * shape
    rising, most = _rising(least * scale[0])
    held = np.zeros((size, len(rising)), dtype=bool)
    for _ in range(_ROUNDS_MAX):
        solved = np.linalg.solve(full.reshape(load.size, -1), right.ravel()).reshape(load.shape)
        new = (solved[:, : ROWS * LINE] @ rising.T < most) & ~held
        if not new.any():
            break
        held |= new
        for k in range(size):
            full[k, : ROWS * LINE, k, : ROWS * LINE] += count * _ONE_SIDED * rising[new[k]].T @ rising[new[k]]
            right[k, : ROWS * LINE] += count * _ONE_SIDED * most[new[k]] @ rising[new[k]]
    return np.asarray(solved / scale)


def _limpness(spline: PressureSpline) -> Array:
    """Return (size,): how far below `_LIMP_Pa` the functions of pressure are, 1 without gas.

    There a film hardly resists bending, less than a fit can tell; a chain without any resistance would fold
    by itself. It is lent the median of all pressures.
    """
    span = np.arcsinh(spline.largest_Pa / 200.0) / spline.intervals
    centers = 200.0 * np.sinh(span * (np.arange(spline.size) - 1.0))
    return np.clip(1.0 - centers / _LIMP_Pa, 0.0, 1.0)


def _rising(least: float) -> tuple[Array, Array]:
    """Return differences (r, c) of A's coefficients and what they are at least (r,): slopes along y, and
    curvatures along z of what is bent little."""
    slopes = np.kron(np.eye(ROWS), np.diff(np.eye(LINE), axis=0))
    curvatures = np.kron(np.diff(np.eye(ROWS), n=2, axis=0), np.eye(LINE)[:_BENT_LITTLE])
    ends = np.concatenate([np.full(len(slopes), least), np.zeros(len(curvatures))])
    return np.concatenate([slopes, curvatures]), ends


def _seconds(size: int) -> Array:
    """Return the penalty (size, size) on second differences."""
    second = np.diff(np.eye(size), n=2, axis=0)
    return np.asarray(second.T @ second)


def _weights(pressure: Array, force: Array) -> Array:
    """Return weights (m, 6): one over the size of shear forces, bending moments and so on of each sample.

    Small ones count as much as large ones: what a section resists them with decides on its stability.
    """
    weight = np.empty_like(force)
    for level in np.unique(pressure):
        here = pressure == level
        for group in ([0, 1], [2], [3, 4], [5]):
            size = np.linalg.norm(force[here][:, group], axis=1)
            usual = max(float(np.sqrt((size**2).mean())), 1e-12)
            least = (_LEAST_AXIAL if group == [2] else _LEAST_SHARE) * usual
            weight[np.ix_(np.flatnonzero(here), np.array(group))] = (1.0 / np.hypot(size, least))[:, None]
    return weight


def _fit_gas(samples: Samples, over: Array, energy: Array, length: Array) -> Array:
    """Return (size,): the potential whose negative slope is the volume that the sections leave out."""
    left = samples.volume_m3.copy()
    for s in range(energy.shape[1]):
        reach = over[:, 0] @ length[:, s]
        values, gradients = _terms(samples.strain[:, s], 1.0 / reach, energy[0, s, Z_FROM:])
        rate = np.einsum("mk,kc->mc", over[:, 1], energy[:, s, :COEFFICIENTS])
        now = np.einsum("mk,kc->mc", over[:, 0], energy[:, s, :COEFFICIENTS])
        # dF/dL at fixed strains: z = u_3 / L - 1
        along = np.einsum("mc,mc->m", gradients[:, 2], now) * samples.strain[:, s, 2] / reach
        left += np.einsum("mc,mc->m", values, rate) - along * (over[:, 1] @ length[:, s])
    # the slope of a spline knows its coefficients up to a constant
    return np.asarray(np.linalg.lstsq(-over[:, 1], left, rcond=None)[0])


def _fit_nodes(samples: Samples, frames: RingFrames, over: Array) -> Array:
    """Return (size, n, 2, 4): nodes as combinations of the points of the frames beside them."""
    count, size = samples.positions.shape[1], over.shape[1]
    result = np.zeros((size, count, 2, 4))
    for s in range(len(frames) - 1):
        first, second = samples.frames[:, s], samples.frames[:, s + 1]
        for fraction, columns in ((0.0, [1, 2, 3]), (1.0, [5, 6, 7]), (None, [1, 2, 3, 4, 5, 6, 7])):
            mine = frames.before == s
            mine &= (
                (frames.fraction == fraction)
                if fraction is not None
                else ((frames.fraction > 0.0) & (frames.fraction < 1.0))
            )
            if not mine.any():
                continue
            origin = second[:, 0] if fraction == 1.0 else first[:, 0]
            features = np.concatenate(
                [first[:, 1:], (second[:, 0] - first[:, 0])[:, None], second[:, 1:]], axis=1
            )[:, [c - 1 for c in columns]]
            rows = np.einsum("mk,mfr->mrkf", over, features).reshape(3 * len(over), -1)
            wanted = (samples.positions[:, mine] - origin[:, None]).transpose(0, 2, 1).reshape(len(rows), -1)
            normal = rows.T @ rows
            normal += 1e-7 * np.diag(np.diag(normal)) + 1e-12 * np.eye(len(normal))
            found = np.linalg.solve(normal, rows.T @ wanted).reshape(size, len(columns), -1)
            weights = np.zeros((size, int(mine.sum()), 8))
            weights[:, :, columns] = found.transpose(0, 2, 1)
            # partition of unity, for all pressures: the sum of the spline's functions is one
            weights[:, :, 0] = 1.0 - weights[:, :, 4]
            if fraction == 1.0:
                weights[:, :, 0], weights[:, :, 4] = 0.0, 1.0
            result[:, mine] = weights.reshape(size, -1, 2, 4)
    return _centred(result, frames)


def _centred(nodes: Array, frames: RingFrames) -> Array:
    """Return the combinations, changed so that rings made from them have exactly the frames given."""
    for f, (ring, shape) in enumerate(zip(frames.rings, frames.shapes, strict=True), start=1):
        side = int(frames.before[ring[0]] != f)
        local = nodes[:, ring, side, 1:]
        local = local - local.mean(axis=1, keepdims=True)
        spin = np.cross(shape[None], local).sum(axis=1)
        inertia = (shape**2).sum() * np.eye(3) - shape.T @ shape
        turn = np.linalg.solve(inertia, spin.T).T
        nodes[:, ring, side, 1:] = local - np.cross(turn[:, None], shape[None])
    return nodes


LARGEST_PRESSURE_Pa: Final = 45e3
"""Working range of pressure, unless more is asked for."""
METHOD: Final = 3
"""Counts changes of the method that make older models worthless."""
_SEED = 1
_SMOOTHINGS = (1e-4, 1e-3, 1e-2, 1e-1)
_SWEEP = 80  # pressures, evenly spaced in their logarithm
_SWEEP_LEAN_rad = 0.15
_TENSION_OF_WEIGHT = 1.5
_LEAST_TENSION_N = 1.0
_SHARES = (0.2, 0.4, 0.65, 0.9)  # of the largest pressure, where the model is compared
_LEANS_rad = (0.0, 0.4, 0.8)
_PULL_OF_WEIGHT = 0.5


@final
@dataclass(frozen=True)
class Effort:
    """How much is sampled: at so many pressures, so many ways to bent poses at each, splines of so many intervals."""

    levels: int = 14
    samples: int = 16
    intervals: int = 8


def build_model(
    body: SoftBody,
    largest_Pa: float = LARGEST_PRESSURE_Pa,
    films: FilmContactLaw | None = None,
    effort: Effort | None = None,
) -> SectionModel:
    """Return the section model of a body.

    Args:
        body: one stack of units.
        largest_Pa: end of its range of pressure.
        films: law of contact between its units; None where they pass through one another.
        effort: how much is sampled.

    Raises:
        InputError: there is no section model of such a body.
    """
    frames = RingFrames.of(body)
    effort = effort or Effort()
    spline = PressureSpline(largest_Pa, effort.intervals)
    tension = max(_TENSION_OF_WEIGHT * 9.81 * body.mass_kg, _LEAST_TENSION_N)
    samples = Sampler(body, frames, films).collect(
        WorkingRange(spline.pressures(effort.levels), tension, samples=effort.samples), _SEED
    )
    fits = [fit_model(samples, frames, spline, smoothing) for smoothing in _SMOOTHINGS]
    # none whose equilibria are lost between the sampled pressures, and of the others the nearest to the film
    lost = [_lost_equilibria(body, model) for model in fits]
    compared = [
        _compared(body, model, films)
        for model, failures in zip(fits, lost, strict=True)
        if failures == min(lost)
    ]
    return min(compared, key=lambda model: model.tip_error)


def _lost_equilibria(body: SoftBody, model: SectionModel) -> int:
    """Return how often Newton's method fails while the hanging arm is inflated, upright and leaning."""
    chain = ChainSolver(SectionBody(body, model))
    free = np.arange(len(chain.section.frames)) > 0
    slack, lost = (0.0,) * len(body.cables), 0
    for lean in (0.0, _SWEEP_LEAN_rad):
        frames = chain.section.straight(0.0)
        gravity = (9.81 * float(np.sin(lean)), 0.0, 9.81 * float(np.cos(lean)))
        for pressure in (0.0, *np.geomspace(5.0, 0.95 * model.spline.largest_Pa, _SWEEP).tolist()):
            found = chain.solve(frames, free, Loads((pressure,), slack, gravity), 1e-6, 60)
            lost += found.outcome is not Outcome.CONVERGED
            frames = found.frames if found.outcome is Outcome.CONVERGED else frames
    return lost


def _compared(body: SoftBody, model: SectionModel, films: FilmContactLaw | None) -> SectionModel:
    """Return the model with the largest distance of its tip from the film's, and that over the film's length.

    The film leans by gravity to the side and is pulled by its first cable; loads without an equilibrium of
    the film do not count.
    """
    system = SoftSystem(body)
    clamp = Clamp.of_base(body)
    options = NewtonOptions(tolerance_N=1e-6, start_tolerance_N=1e-6, iterations_max=40)
    newton = NewtonSolver(system, clamp.mask(body.nodes))
    contact = None if films is None else SelfContact(body, films)
    solver = EquilibriumSolver(newton, clamp, options, contact, slides_max=0)
    chain = ChainSolver(SectionBody(body, model))
    pull = _PULL_OF_WEIGHT * 9.81 * body.mass_kg
    slack, along = (0.0,) * len(body.cables), (0.0, 0.0, 9.81)
    error_m = error = 0.0
    straight = solver.solve(SoftState.drawn(body, Pose()), Pose(), Loads((), slack, along))
    for fraction in _SHARES:
        here = straight = solver.follow(
            straight, Pose(), replace(straight.loads, pressure_Pa=(fraction * model.spline.largest_Pa,))
        )
        for lean in _LEANS_rad:
            tension = (pull * (lean > 0.0), *slack[1:]) if slack else ()
            gravity = (9.81 * float(np.sin(lean)), 0.0, 9.81 * float(np.cos(lean)))
            try:
                here = solver.follow(
                    here, Pose(), replace(here.loads, cable_tension_N=tension, gravity=gravity)
                )
            except ConvergenceError:
                break
            off, length = _tip_error(chain, here)
            error_m, error = max(error_m, off), max(error, off / length)
    return replace(model, tip_error=error, tip_error_m=error_m)


def _tip_error(chain: ChainSolver, film: Equilibrium) -> tuple[float, float]:
    """Return the distance of the tips and the film's length [m]."""
    frames = chain.section.frames.fit(film.state.positions, Pose())
    free = np.arange(len(frames)) > 0
    found = chain.solve(frames, free, film.loads, 1e-6, 60)
    length = float(np.linalg.norm(np.diff(frames[:, 0], axis=0), axis=1).sum())
    if found.outcome is not Outcome.CONVERGED:
        return np.inf, length
    return float(np.linalg.norm(found.frames[-1, 0] - frames[-1, 0])), length
