"""One implicit step of a chain of frames as a matrix."""

from typing import Final

import numpy as np

from cosim.base.frames import Array, cross_matrix
from cosim.reduced.sections.chain_shape import change_frames
from cosim.reduced.sections.figures import CENTER, FIGURES, figures_of
from cosim.reduced.solve.commanded_cables import commanded, with_tensions
from cosim.reduced.solve.stability import PROBE_Pa, RestingChain
from cosim.soft.solve.linear_step import LinearStep, LoadName, RestingBody
from cosim.soft.solve.step_prediction import StepCoefficients

_MOTION_PROBE: Final = 1e-5  # of a motion, for centre and inertia


def linear_step(chain: RestingChain, coefficients: StepCoefficients) -> LinearStep:
    """Return a step of a chain.

    Args:
        chain: at rest.
        coefficients: of inertia and losses in the step.
    """
    names, slopes = _by_loads(chain)
    size = 6 * len(chain.frames)

    def supplied(gradient: Array, end: Array) -> Array:
        return _supplied(chain, gradient, end)

    body = RestingBody(
        chain.tangent, chain.mass, np.zeros((size, size)), _carried(chain.frames), slopes,
        np.repeat(chain.clamp.held, 6), supplied, _moments(chain), names, _tip(chain, names), chain.motion,
    )  # fmt: skip
    return body.linear_step(coefficients)


def _carried(frames: Array) -> Array:
    """Return R (6 f, 6): the motion of frames (f, 4, 3) fixed to the flange by a motion of the flange."""
    motion = np.zeros((len(frames), 6, 6))
    motion[:] = np.eye(6)
    for rows, frame in zip(motion, frames, strict=True):
        rows[:3, 3:] = -cross_matrix(frame[0] - frames[0, 0])
    return motion.reshape(-1, 6)


def _by_loads(chain: RestingChain) -> tuple[tuple[LoadName, ...], Array]:
    """Return the names of loads for commands, and the gradient's derivatives (6 f, loads) by them."""
    names, columns, loads = list[LoadName](), list[Array](), chain.point.loads
    if chain.solver.section.gas(chain.loads) is None:
        up, down = (chain.gradient_at(chain.pressure_Pa + probe_Pa) for probe_Pa in (PROBE_Pa, -PROBE_Pa))
        names.append(("pressure_Pa", 0))
        columns.append((up - down) / (2.0 * PROBE_Pa))
    for c in sorted({*range(len(loads.cable_tension_N))} - {*commanded(chain.loads)}):
        pulled = with_tensions(loads, tuple(pull + (c == d) for d, pull in enumerate(loads.cable_tension_N)))
        names.append(("cable_tension_N", c))
        columns.append(chain.solver.evaluate(chain.frames, pulled, chain.pressure_Pa) - chain.gradient)
    return tuple(names), np.array(columns).reshape(len(columns), 6 * len(chain.frames)).T


def _supplied(chain: RestingChain, gradient: Array, end: Array) -> Array:
    """Return the change (6, columns) of the wrench on held frames, about the flange.

    The gradient by (dr, phi) of a turned frame is that of before, its change by the symmetric tangent,
    and phi x g / 2, as turns do not commute. A lever turns with its frame.
    """
    gradient_at_rest, change = chain.gradient, np.zeros((6, end.shape[1]))
    for f in np.flatnonzero(chain.clamp.held):
        wrench, frame_motion = gradient[6 * f : 6 * f + 6], end[6 * f : 6 * f + 6]
        lever = chain.frames[f, 0] - chain.frames[0, 0]
        change += wrench
        change[3:] -= 0.5 * cross_matrix(gradient_at_rest[f, 3:]) @ frame_motion[3:]
        change[3:] += cross_matrix(lever) @ wrench[:3]
        change[3:] -= cross_matrix(gradient_at_rest[f, :3]) @ (frame_motion[:3] - end[:3])
    return change


def _moments(chain: RestingChain) -> Array:
    """Return the derivatives (12, 6 f) of centre and inertia of the mass."""
    count, mass, columns = len(chain.frames), chain.solver.section.mass, []
    nothing, moved_frames = np.zeros((count, 6)), np.empty_like(chain.frames)
    for k in range(6 * count):
        step, ends = np.zeros((count, 6)), []
        step.reshape(-1)[k] = _MOTION_PROBE
        for sign in (1.0, -1.0):
            change_frames(chain.frames, step, sign, moved_frames)
            ends.append(figures_of(moved_frames, chain.clamp.free, mass, nothing)[CENTER:FIGURES])
        columns.append((ends[0] - ends[1]) / (2.0 * _MOTION_PROBE))
    return np.array(columns).T


def _tip(chain: RestingChain, names: tuple[LoadName, ...]) -> Array:
    """Return the derivatives (3, 6 f + loads) of the tip's position."""
    section, tip = chain.solver.section, chain.solver.section.body.tip
    derivatives = np.concatenate([chain.motion[tip].mean(axis=0), np.zeros((3, len(names)))], axis=1)
    if names and names[0] == ("pressure_Pa", 0):
        up, down = (
            section.positions(chain.frames, chain.pressure_Pa + probe_Pa)[tip].mean(axis=0)
            for probe_Pa in (PROBE_Pa, -PROBE_Pa)
        )
        derivatives[:, chain.motion.shape[2]] = (up - down) / (2.0 * PROBE_Pa)
    return derivatives
