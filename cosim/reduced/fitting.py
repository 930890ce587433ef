"""Builds the section model of a soft body: samples it, fits the model to the samples by linear least squares
with all coefficients as splines over pressure, and compares both at other loads.
"""

from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, Mask, Pose
from cosim.errors import ConvergenceError
from cosim.reduced.sampling import Sampler, Samples
from cosim.reduced.section_model import RingFrames, SectionBody, SectionModel
from cosim.reduced.sections.coefficients import COEFFICIENTS, DEGREES, POLYNOMIAL
from cosim.reduced.sections.pressure_spline import PressureSpline
from cosim.reduced.sections.section_energy import basis
from cosim.reduced.solve.chain_solver import ChainSolver
from cosim.reduced.solve.working_range import place_in_range
from cosim.reduced.wanted_poses import WorkingRange
from cosim.soft.body import loads, places
from cosim.soft.body.body import SoftBody
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve import equilibrium, newton_options, self_contact, state
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.newton import NewtonSolver

_RIDGE = 1e-5  # penalty on coefficients, scaled by their effect in the samples
# penalty on corrections of the coarse model by few samples on a refined mesh, and its factor for each degree,
# as few samples determine high degrees less
_FINER_RIDGE, _FINER_RISE = 0.1, 3.0
# weight of second differences over pressure; of the first one, where films with little gas hardly resist
_SMOOTHING, _FIRST_SMOOTHING = 3e-4, 1e-3
_HELD_OUT = 8  # one of this many samples is left out of the fit, to test it
_GROUPS: Final = ([0, 1], [2], [3, 4], [5])  # shear, length, bending, twist
_ALIKE = 1e-2  # relative difference of equal sections
_LEAST_SCALE = 3e-2  # of a function of gaps, over its largest scale at any pressure
_LEAST_SIZE = 0.1  # of a force, over the usual size, in weights
_BEYOND = 0.15  # of the sampled range of lengths, on either side
_FARTHEST_BEND = 1.25  # over the largest sampled bend
LARGEST_PRESSURE_Pa: Final = 45e3
"""Default end of the working range of pressure."""
METHOD: Final = 8
"""Number of the method; a new one makes models in the cache obsolete."""
_SEED = 1
_TENSION_OF_WEIGHT = 1.5
_LEAST_TENSION_N = 1.0
_COMPARED = (0.2, 0.4, 0.65, 0.9)  # pressures of the comparison over the largest one
_LEANS_rad = (0.0, 0.4, 0.8)
_PULL_OF_WEIGHT = 0.5


def fit_model(
    samples: Samples, frames: RingFrames, spline: PressureSpline, coarse: SectionModel | None = None
) -> SectionModel:
    """Return the model of a stack of units.

    Args:
        samples: of the stack, over its working range.
        frames: of its rings.
        spline: basis over the range of pressure.
        coarse: model of the same stack on a coarser mesh; its range is adopted, and its energy is corrected
            by the samples. None: the samples determine all.
    """
    spline_basis = np.array([spline.basis(p) for p in samples.pressure_Pa])  # (m, 2, size)
    levels = np.unique(samples.pressure_Pa)
    at_levels = np.array([spline.basis(p)[0] for p in levels])
    if coarse is None:
        length = np.linalg.lstsq(at_levels, samples.length_m, rcond=None)[0]
        prior_energy = np.zeros((*length.shape, COEFFICIENTS))
        limits = _limits(samples, length, spline_basis[:, 0])
        ridge = np.full(COEFFICIENTS, _RIDGE)
    else:
        length, prior_energy, limits = coarse.length, *np.split(coarse.energy, [COEFFICIENTS], axis=2)
        ridge = _FINER_RIDGE * _FINER_RISE ** np.array(DEGREES)
    energy, force_errors = prior_energy.copy(), np.empty_like(samples.strain)
    start = _Start(spline_basis[:, 0], length, prior_energy, ridge, frames.rims)
    for group in _alike(frames.rims, samples.length_m):
        energy[:, group], force_errors[:, group] = _fit_sections(samples, group, start)
    return SectionModel(
        spline,
        np.concatenate([energy, limits], axis=2),
        length,
        _fit_gas(samples, spline_basis, energy, start),
        _fit_nodes(samples, frames, spline_basis[:, 0]),
        _held_out(samples, force_errors),
        len(samples.pressure_Pa),
        samples.failures,
    )


def _is_held_out(samples: Samples) -> Mask:
    """Return which samples (m,) are left out of the fit."""
    return np.arange(len(samples.pressure_Pa)) % _HELD_OUT == _HELD_OUT - 1


def _held_out(samples: Samples, force_errors: Array) -> Array:
    """Return the errors (pressures, 5, 2) of forces in held-out samples, see `SectionModel.held_out`.

    Args:
        samples: all samples.
        force_errors: (m, s, 6), of the sections.
    """
    # samples of the free shape, without forces, are ignored
    is_held_out, rows = _is_held_out(samples) & samples.force.any(axis=(1, 2)), []
    for level in np.unique(samples.pressure_Pa):
        at_level = samples.pressure_Pa == level
        row = [level]
        for group in _GROUPS:
            rms = float(np.sqrt((samples.force[at_level][:, :, group] ** 2).sum(axis=2).mean()))
            error = np.linalg.norm(force_errors[at_level & is_held_out][:, :, group], axis=2) / max(
                rms, 1e-12
            )
            row += [float(np.median(error)), float(error.max())] if error.size else [np.nan, np.nan]
        rows.append(row)
    return np.array(rows)


def _limits(samples: Samples, length: Array, spline_basis: Array) -> Array:
    """Return splines (size, s, 3) of the limits of a section's strains, a little beyond its samples."""
    stretch = samples.strain[:, :, 2] / (spline_basis @ length) - 1.0
    bend = (samples.strain[:, :, 3:5] ** 2).sum(axis=2)
    limits = []
    for level in np.unique(samples.pressure_Pa):
        at_level = samples.pressure_Pa == level
        low, high = stretch[at_level].min(axis=0), stretch[at_level].max(axis=0)
        margin = _BEYOND * (high - low)
        limits.append(
            np.stack([low - margin, high + margin, _FARTHEST_BEND**2 * bend[at_level].max(axis=0)], axis=1)
        )
    level_basis = np.array(
        [spline_basis[samples.pressure_Pa == level][0] for level in np.unique(samples.pressure_Pa)]
    )
    splines = np.linalg.lstsq(level_basis, np.array(limits).reshape(len(limits), -1), rcond=None)[0]
    return np.asarray(splines.reshape(spline_basis.shape[1], -1, 3))


def _alike(rims: Array, length_m: Array) -> list[list[int]]:
    """Return groups of sections with one energy: sections between squares of equal size and length."""
    groups: list[list[int]] = []
    for s, rim in enumerate(rims):
        for group in groups:
            same_length = np.allclose(length_m[:, s], length_m[:, group[0]], rtol=_ALIKE)
            if rim.any() and same_length and np.allclose(rim, rims[group[0]], rtol=_ALIKE):
                group.append(s)
                break
        else:
            groups.append([s])
    return groups


@final
@dataclass(frozen=True)
class _Start:
    """Initial values of a fit.

    Args:
        spline_basis: (m, size), functions of the spline at the samples.
        length: (size, s) [m], L.
        prior: (size, s, COEFFICIENTS), coefficients from which the fit deviates as little as possible.
        ridge: (COEFFICIENTS,), penalty on a deviation.
        rims: (s, n, 2) [m], see `RingFrames.rims`.
    """

    spline_basis: Array
    length: Array
    prior: Array
    ridge: Array
    rims: Array

    def terms(self, samples: Samples, s: int) -> tuple[Array, Array]:
        """Return values (m, c) and gradients (m, 6, c) of the energy's terms of a section."""
        strain = np.ascontiguousarray(samples.strain[:, s])
        values = np.zeros((len(strain), COEFFICIENTS))
        gradients = np.zeros((len(strain), 6, COEFFICIENTS))
        basis(strain, 1.0 / (self.spline_basis @ self.length[:, s]), self.rims[s], values, gradients)
        return values, gradients

    def rows(self, samples: Samples, s: int) -> Array:
        """Return derivatives (m, 6, size (c - 1)) of a section's forces by non-constant coefficients."""
        gradients = self.terms(samples, s)[1][:, :, None, 1:]
        return np.asarray(
            (gradients * self.spline_basis[:, None, :, None]).reshape(len(self.spline_basis), 6, -1)
        )


def _fit_sections(samples: Samples, group: list[int], start: _Start) -> tuple[Array, Array]:
    """Return common coefficients (size, 1, c) of sections, and errors of their forces (m, g, 6)."""
    size, prior = start.spline_basis.shape[1], start.prior[:, group[0]]
    is_fitted, unknown = ~_is_held_out(samples), size * (COEFFICIENTS - 1)
    normal, load = np.zeros((unknown, unknown)), np.zeros(unknown)
    unexplained_force = np.empty((len(is_fitted), len(group), 6))
    for k, s in enumerate(group):
        force_derivatives, force = start.rows(samples, s), samples.force[:, s]
        unexplained_force[:, k] = force - force_derivatives @ prior[:, 1:].ravel()
        weight = _weights(samples.pressure_Pa, force)
        matrix = (force_derivatives * weight[:, :, None])[is_fitted].reshape(-1, unknown)
        normal += matrix.T @ matrix
        load += matrix.T @ (unexplained_force[:, k] * weight)[is_fitted].ravel()
    count = 6 * int(is_fitted.sum()) * len(group)
    scale = np.sqrt(np.diag(normal) / count).reshape(size, -1)
    # a function of gaps without samples at a pressure remains close to that at the next pressure
    gaps = scale[:, POLYNOMIAL - 1 :]
    np.maximum(gaps, _LEAST_SCALE * gaps.max(axis=0), out=gaps)
    scale = scale.ravel() + 1e-100
    system = normal / np.outer(scale, scale) + count * np.diag(np.tile(start.ridge[1:], size))
    system += count * _roughness(scale, size)
    solution = np.linalg.solve(system, load / scale) / scale
    coefficients = prior.copy()
    coefficients[:, 1:] += solution.reshape(size, -1)
    force_errors = np.stack([start.rows(samples, s) @ solution for s in group], axis=1) - unexplained_force
    return coefficients[:, None], force_errors


def _roughness(scale: Array, size: int) -> Array:
    """Return the penalty matrix on second differences over pressure, of coefficients times their scale.

    It avoids oscillations of splines with many knots between samples.
    Source: Eilers and Marx, Statistical Science 11 (1996) 89.
    """
    terms = len(scale) // size
    mean_scale = scale.reshape(size, terms).mean(axis=0)
    second = np.sqrt(_SMOOTHING) * np.diff(np.eye(size), n=2, axis=0)
    second[0] *= np.sqrt(_FIRST_SMOOTHING / _SMOOTHING)
    scaled_difference = np.einsum("ik,c->ikc", second, mean_scale)
    # the unknowns are coefficients times their own scale
    penalty = np.einsum("ikc,ilc->kcl", scaled_difference, scaled_difference)
    roughness = np.zeros((size, terms, size, terms))
    for c in range(terms):
        roughness[:, c, :, c] = penalty[:, c]
    return np.asarray(roughness.reshape(len(scale), -1) / np.outer(scale, scale))


def _weights(pressure: Array, force: Array) -> Array:
    """Return weights (m, 6), the inverse sizes of shear force, tension, bending moment and twist of a sample.

    So small loads have the same influence as large ones. The stiffness at small loads determines stability.
    """
    weight = np.empty_like(force)
    for level in np.unique(pressure):
        at_level = pressure == level
        for group in _GROUPS:
            size = np.linalg.norm(force[at_level][:, group], axis=1)
            rms = max(float(np.sqrt((size**2).mean())), 1e-12)
            floor = rms if group == [2] else _LEAST_SIZE * rms
            weight[np.ix_(np.flatnonzero(at_level), np.array(group))] = (1.0 / np.hypot(size, floor))[:, None]
    return weight


def _fit_gas(samples: Samples, spline_basis: Array, energy: Array, start: _Start) -> Array:
    """Return the potential (size,) whose negative slope is the volume that is not in the sections' energy."""
    remaining_volume_m3 = samples.volume_m3.copy()
    for s in range(energy.shape[1]):
        length_m = spline_basis[:, 0] @ start.length[:, s]
        values, gradients = start.terms(samples, s)
        coefficient_slopes = np.einsum("mk,kc->mc", spline_basis[:, 1], energy[:, s])
        coefficients = np.einsum("mk,kc->mc", spline_basis[:, 0], energy[:, s])
        # dF/dL at fixed strains: z = u_3 / L - 1, of the polynomial alone
        slope = np.einsum("mc,mc->m", gradients[:, 2, :POLYNOMIAL], coefficients[:, :POLYNOMIAL])
        energy_by_length = slope * samples.strain[:, s, 2] / length_m
        remaining_volume_m3 += np.einsum("mc,mc->m", values, coefficient_slopes) - energy_by_length * (
            spline_basis[:, 1] @ start.length[:, s]
        )
    # the slope of a spline determines its coefficients up to a constant
    return np.asarray(np.linalg.lstsq(-spline_basis[:, 1], remaining_volume_m3, rcond=None)[0])


def _fit_nodes(samples: Samples, frames: RingFrames, spline_basis: Array) -> Array:
    """Return weights (size, n, 2, 4): nodes as combinations of the points of the two frames next to them."""
    count, size = samples.positions.shape[1], spline_basis.shape[1]
    node_weights = np.zeros((size, count, 2, 4))
    for s in range(len(frames) - 1):
        first, second = samples.frames[:, s], samples.frames[:, s + 1]
        for fraction, columns in ((0.0, [1, 2, 3]), (1.0, [5, 6, 7]), (None, [1, 2, 3, 4, 5, 6, 7])):
            mask = frames.before == s
            mask &= (
                (frames.fraction == fraction)
                if fraction is not None
                else ((frames.fraction > 0.0) & (frames.fraction < 1.0))
            )
            if not mask.any():
                continue
            origin = second[:, 0] if fraction == 1.0 else first[:, 0]
            features = np.concatenate(
                [first[:, 1:], (second[:, 0] - first[:, 0])[:, None], second[:, 1:]], axis=1
            )[:, [c - 1 for c in columns]]
            design = np.einsum("mk,mfr->mrkf", spline_basis, features).reshape(3 * len(spline_basis), -1)
            targets = (
                (samples.positions[:, mask] - origin[:, None]).transpose(0, 2, 1).reshape(len(design), -1)
            )
            normal = design.T @ design
            normal += 1e-7 * np.diag(np.diag(normal)) + 1e-12 * np.eye(len(normal))
            coefficients = np.linalg.solve(normal, design.T @ targets).reshape(size, len(columns), -1)
            weights = np.zeros((size, int(mask.sum()), 8))
            weights[:, :, columns] = coefficients.transpose(0, 2, 1)
            # partition of unity, for all pressures: the sum of the spline's functions is one
            weights[:, :, 0] = 1.0 - weights[:, :, 4]
            if fraction == 1.0:
                weights[:, :, 0], weights[:, :, 4] = 0.0, 1.0
            node_weights[:, mask] = weights.reshape(size, -1, 2, 4)
    return _centred(node_weights, frames)


def _centred(nodes: Array, frames: RingFrames) -> Array:
    """Return the weights, corrected so that the frames of rings are reproduced exactly."""
    for f, (ring, shape) in enumerate(zip(frames.rings, frames.shapes, strict=True), start=1):
        side = int(frames.before[ring[0]] != f)
        local = nodes[:, ring, side, 1:]
        local = local - local.mean(axis=1, keepdims=True)
        spin = np.cross(shape[None], local).sum(axis=1)
        inertia = (shape**2).sum() * np.eye(3) - shape.T @ shape
        turn = np.linalg.solve(inertia, spin.T).T
        nodes[:, ring, side, 1:] = local - np.cross(turn[:, None], shape[None])
    return nodes


@final
@dataclass(frozen=True)
class Effort:
    """Number of sampled pressures, of bent poses at each, and of intervals of the splines."""

    levels: int = 14
    samples: int = 20
    intervals: int = 8

    @classmethod
    def of(cls, frames: RingFrames) -> "Effort":
        """Return the numbers for a stack; square units need more, as their contact depends on pressure."""
        return cls(18, 45, 10) if frames.rims.size else cls()


def build_model(
    body: SoftBody,
    largest_Pa: float = LARGEST_PRESSURE_Pa,
    films: self_contact.FilmContactLaw | None = None,
    coarse: SoftBody | None = None,
    effort: Effort | None = None,
    folds: bool = False,
) -> SectionModel:
    """Return the section model of a body.

    Args:
        body: one stack of units.
        largest_Pa: end of its range of pressure.
        films: law of contact between its units; None without contact.
        coarse: the same body on a coarse mesh; `body` divides every triangle into four. All poses are
            sampled on it, and some of them are continued on `body`. None: all poses are sampled on `body`.
        effort: number of samples; None for the default.
        folds: whether square units bend until they press flat on one another.

    Raises:
        InputError: there is no section model of such a body.
        MeshError: `coarse` is not that mesh.
    """
    first = coarse or body
    frames = replace(RingFrames.of(first), folds=folds)
    effort = effort or Effort.of(frames)
    spline = PressureSpline(largest_Pa, effort.intervals)
    tension = max(_TENSION_OF_WEIGHT * 9.81 * body.mass_kg, _LEAST_TENSION_N)
    work = WorkingRange(spline.pressures(effort.levels), tension, effort.samples)
    samples = Sampler(first, frames, films).collect(work, _SEED)
    model = fit_model(samples, frames, spline)
    if coarse is not None:
        frames = replace(RingFrames.of(body), folds=folds)
        finer = Sampler(body, frames, films).finer(samples, places.parents(coarse, body))
        model = fit_model(finer, frames, spline, model)
    return replace(model, tips=_tips(body, model, films))


def _tips(body: SoftBody, model: SectionModel, films: self_contact.FilmContactLaw | None) -> Array:
    """Compare film and model at loads that were not fitted; return pressure, error and length (k, 3).

    They are the pressure [Pa], the distance of the tips [m] and the length of the film [m]. The film bends
    under lateral gravity and the tension of its first cable. Loads without an equilibrium of the film, or
    beyond the model's range, are left out.
    """
    film = FilmPotential(body)
    clamp = Clamp.of_base(body)
    options = newton_options.NewtonOptions(tolerance_N=1e-6, start_tolerance_N=1e-6, iterations_max=40)
    newton = NewtonSolver(film, clamp.mask(body.nodes))
    contact = None if films is None else self_contact.SelfContact(body, films)
    solver = equilibrium.EquilibriumSolver(newton, clamp, options, contact, slides_max=0)
    chain = ChainSolver(SectionBody(body, model))
    pull = _PULL_OF_WEIGHT * 9.81 * body.mass_kg
    slack = (0.0,) * len(body.cables)
    empty = loads.Loads((), slack, (0.0, 0.0, 0.0))
    opened = solver.opened(state.SoftState.drawn(body, Pose()), Pose(), empty)
    straight = solver.solve(opened, Pose(), empty)
    tips = []
    for pressure in (fraction * model.spline.largest_Pa for fraction in _COMPARED):
        hanging_loads = loads.Loads((pressure,), slack, (0.0, 0.0, 9.81))
        try:
            hanging_film = straight = solver.follow(straight, Pose(), hanging_loads)
        except ConvergenceError:
            continue
        for lean in _LEANS_rad:
            tension = (pull * (lean > 0.0), *slack[1:]) if slack else ()
            gravity = (9.81 * float(np.sin(lean)), 0.0, 9.81 * float(np.cos(lean)))
            try:
                hanging_film = solver.follow(
                    hanging_film,
                    Pose(),
                    replace(hanging_film.loads, cable_tension_N=tension, gravity=gravity),
                )
            except ConvergenceError:
                break
            tips += [(pressure, *comparison) for comparison in _tip_off(chain, hanging_film, pressure)]
    return np.array(tips).reshape(-1, 3)


def _tip_off(chain: ChainSolver, film: state.Equilibrium, pressure_Pa: float) -> list[tuple[float, float]]:
    """Return distance of the tips and length of the film [m]; empty out of range, infinite if not solved."""
    frames = chain.section.frames.fit(film.state.positions, Pose())
    if place_in_range(chain.section, frames, pressure_Pa).fraction > 1.0:
        return []
    free = np.arange(len(frames)) > 0
    solution = chain.solve(frames, free, film.loads, 1e-6, 60)
    length = float(np.linalg.norm(np.diff(frames[:, 0], axis=0), axis=1).sum())
    if solution.outcome is not newton_options.Outcome.CONVERGED:
        return [(np.inf, length)]
    return [(float(np.linalg.norm(solution.frames[-1, 0] - frames[-1, 0])), length)]
