"""Opens film that is slack in its frames, from a drawn shape in which it fits them.

Put at once into smaller frames, or pushed apart by frames that are higher than the drawn units, slack film
crumples in one of many ways. So frames shrink from the drawn rims to their size in steps, under a low
pressure and without contact of frames. Each film opens to a cone that takes up the slack. Then the pressure
is let off.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final, Protocol

from cosim.base.frames import Array, Pose
from cosim.errors import ConvergenceError
from cosim.soft.beams.beam_rings import BeamRings
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.frame_ring import FrameRings
from cosim.soft.elements.frame_stops import FrameStops
from cosim.soft.solve.state import Equilibrium, SoftState

_PRESSURE_Pa: Final = 500.0  # keeps film of some 0.1 mm and 50 mm taut
_FIRST: Final = 0.05  # step, as a share of the slack; doubled after each one that is found
_LEAST: Final = 1e-3  # step at which the search ends
_SLACK: Final = 1e-9  # share of a rim's length; smaller differences are rounding


class Statics(Protocol):
    """Equilibria of one body, see `EquilibriumSolver`."""

    def solve(self, state: SoftState, world_from_flange: Pose, loads: Loads, /) -> Equilibrium:
        """Find the equilibrium near a state."""

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads, /) -> Equilibrium:
        """Follow an equilibrium to other loads."""


def is_slack(body: SoftBody) -> bool:
    """Return whether the film of a body is drawn wider than a frame, and so is slack in it."""
    pairs = _lengths(body.of_kind(BeamRings), body) + _lengths(body.of_kind(FrameRings), body)
    return any(lengths.sum() < (1.0 - _SLACK) * drawn.sum() for lengths, drawn in pairs)


def open_film(
    statics_of: Callable[[SoftBody], Statics],
    body: SoftBody,
    state: SoftState,
    world_from_flange: Pose,
    loads: Loads,
) -> SoftState:
    """Return the state at rest to which slack film opens, without contact of frames.

    Args:
        statics_of: body -> its statics, held as this one.
        body: with slack film.
        state: drawn shape on the flange.
        world_from_flange: pose of the flange.
        loads: without pressure.

    Raises:
        ConvergenceError: an equilibrium was not found on the way.
    """
    chambers = max(1, len(body.gas_chambers))
    filled = replace(loads, pressure_Pa=(_PRESSURE_Pa,) * chambers)
    free, reached, step = body.with_other(FrameStops), 0.0, _FIRST
    while True:
        share = min(1.0, reached + step)
        statics = statics_of(_shrunk(free, share))
        try:
            found = statics.solve(state, world_from_flange, filled)
        except ConvergenceError:
            step *= 0.5
            if step < _LEAST:
                raise
            continue
        state, reached, step = found.state, share, 2.0 * step
        if reached == 1.0:
            empty = replace(loads, pressure_Pa=(0.0,) * chambers)
            return statics.follow(found, world_from_flange, empty).state


def _lengths(frames: Sequence[BeamRings | FrameRings], body: SoftBody) -> list[tuple[Array, Array]]:
    """Return lengths without loads, and those drawn, of beams or chords."""
    return [(each.lengths, each.drawn_lengths(body.positions)) for each in frames]


def _shrunk(body: SoftBody, share: float) -> SoftBody:
    """Return a body whose frames have a share of their difference from the drawn rims."""
    beams, stiff = body.of_kind(BeamRings), body.of_kind(FrameRings)
    beams_m, stiff_m = (
        [drawn + share * (own - drawn) for own, drawn in _lengths(frames, body)] for frames in (beams, stiff)
    )
    body = body.with_other(BeamRings, *(replace(b, lengths=m) for b, m in zip(beams, beams_m, strict=True)))
    return body.with_other(FrameRings, *(replace(f, lengths=m) for f, m in zip(stiff, stiff_m, strict=True)))
