"""The film of a run's section model. At the end of a phase, film and chain come to rest under the same loads;
the error of the model is their difference.
"""

from dataclasses import replace
from typing import final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.coupling.robots import beam_robot, film_robot
from cosim.reduced.solve.clamp import FrameClamp, film_clamp
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.state import Equilibrium, SoftState


@final
class SourceFilm:
    """Sets the film in the shape of the chain.

    Args:
        chain: of the run.
        film: new, on the mesh of the section model.
    """

    def __init__(self, chain: beam_robot.BeamRobot, film: film_robot.FilmRobot) -> None:
        self.chain, self.film = chain, film
        self._clamps: list[tuple[FrameClamp, Clamp]] = []

    def state(self, saved: beam_robot.BeamRobotState) -> film_robot.FilmRobotState:
        """Return the film in the shape of a chain, with the same rings held."""
        chain, film = self.chain, self.film
        chain.full_state = saved
        shape = chain.state.positions
        film.hold(self._clamp(saved.clamp, shape, saved.flange))
        soft = film.state_at_rest(shape, saved.flange)
        return replace(film.full_state, soft=soft, flange=saved.flange, loads=saved.loads)

    def _clamp(self, frames: FrameClamp, shape: Array, flange: Pose) -> Clamp:
        """Return the clamp of the film for held frames; the same object for the same frames."""
        for known, clamp in self._clamps:
            if np.array_equal(known.held, frames.held) and np.array_equal(known.offsets, frames.offsets):
                return clamp
        clamp = film_clamp(self.chain.section, frames, shape, flange)
        self._clamps.append((frames, clamp))
        return clamp

    def chain_at_rest(self, saved: beam_robot.BeamRobotState) -> Equilibrium:
        """Return the chain's equilibrium near a saved state, with its loads, and set it.

        Raises:
            ConvergenceError: no equilibrium was found near it.
        """
        chain = self.chain
        chain.full_state = saved
        begin = SoftState.at_rest(chain.state.positions, chain.state.memory)
        rest = chain.solve(begin, saved.flange, saved.loads)
        chain.commit(rest)
        return rest
