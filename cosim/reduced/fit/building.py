"""Builds the section model of a soft body: samples it, fits, and compares the two at other loads."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from cosim.base.frames import Pose
from cosim.errors import ConvergenceError
from cosim.reduced.fit.fitting import fit_model
from cosim.reduced.fit.sampling import Sampler, WorkingRange
from cosim.reduced.section_model import SectionBody, SectionModel
from cosim.reduced.sections.pressure_spline import PressureSpline
from cosim.reduced.sections.ring_frames import RingFrames
from cosim.reduced.solve.newton import ChainSolver
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions, Outcome
from cosim.soft.solve.state import Clamp, Equilibrium, SoftState

LARGEST_PRESSURE_Pa: Final = 45e3
"""Working range of pressure, unless more is asked for."""
METHOD: Final = 1
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
    """How much is sampled: at so many pressures, so many bent poses at each, splines of so many intervals."""

    levels: int = 14
    samples: int = 24
    intervals: int = 8


def build_model(
    body: SoftBody, largest_Pa: float = LARGEST_PRESSURE_Pa, effort: Effort | None = None
) -> SectionModel:
    """Return the section model of a body.

    Args:
        body: one stack of units.
        largest_Pa: end of its range of pressure.
        effort: how much is sampled.

    Raises:
        InputError: there is no section model of such a body.
    """
    frames = RingFrames.of(body)
    effort = effort or Effort()
    spline = PressureSpline(largest_Pa, effort.intervals)
    tension = max(_TENSION_OF_WEIGHT * 9.81 * body.mass_kg, _LEAST_TENSION_N)
    samples = Sampler(body, frames).collect(
        WorkingRange(spline.pressures(effort.levels), tension, samples=effort.samples), _SEED
    )
    fits = [fit_model(samples, frames, spline, smoothing) for smoothing in _SMOOTHINGS]
    # none whose equilibria are lost between the sampled pressures, and of the others the nearest to the film
    lost = [_lost_equilibria(body, model) for model in fits]
    compared = [
        _compared(body, model) for model, failures in zip(fits, lost, strict=True) if failures == min(lost)
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


def _compared(body: SoftBody, model: SectionModel) -> SectionModel:
    """Return the model with the largest distance of its tip from the film's, and that over the film's length.

    The film leans by gravity to the side and is pulled by its first cable; loads without an equilibrium of
    the film do not count.
    """
    system = SoftSystem(body)
    clamp = Clamp.of_base(body)
    options = NewtonOptions(tolerance_N=1e-6, start_tolerance_N=1e-6, iterations_max=40)
    newton = NewtonSolver(system, clamp.mask(body.nodes))
    solver = EquilibriumSolver(newton, clamp, options, slides_max=0)
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
