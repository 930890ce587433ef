"""The film that a run's section model was condensed from: the error of the model is how far both are apart.

At the end of a phase the film is put into the chain's shape, and both come to rest under the same loads.
"""

from dataclasses import replace
from typing import final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.coupling.robots import beam_robot, film_robot
from cosim.reduced.solve.clamp import FrameClamp, film_clamp
from cosim.soft.solve.state import Clamp, Equilibrium, SoftState


@final
class SourceFilm:
    """Puts the film where the chain is.

    Args:
        chain: of the run.
        film: new, on the mesh that its sections were condensed from.
    """

    def __init__(self, chain: beam_robot.BeamRobot, film: film_robot.FilmRobot) -> None:
        self.chain, self.film = chain, film
        self._clamps: list[tuple[FrameClamp, Clamp]] = []

    def state(self, saved: beam_robot.BeamRobotState) -> film_robot.FilmRobotState:
        """Return the film in the shape of a chain: rings that are held there are held as they are."""
        chain, film = self.chain, self.film
        chain.full_state = saved
        shape = chain.state.positions
        film.hold(self._clamp(saved.clamp, shape, saved.flange))
        soft = film.state_at_rest(shape, saved.flange)
        return replace(film.full_state, soft=soft, flange=saved.flange, loads=saved.loads)

    def _clamp(self, frames: FrameClamp, shape: Array, flange: Pose) -> Clamp:
        """Return what holds the film as some frames are held; the same one for the same frames."""
        for known, clamp in self._clamps:
            if np.array_equal(known.held, frames.held) and np.array_equal(known.offsets, frames.offsets):
                return clamp
        clamp = film_clamp(self.chain.section, frames, shape, flange)
        self._clamps.append((frames, clamp))
        return clamp

    def chain_at_rest(self, saved: beam_robot.BeamRobotState) -> Equilibrium:
        """Return where the chain comes to rest, with the loads of a state; it is there then.

        Raises:
            ConvergenceError: no equilibrium was found near it.
        """
        chain = self.chain
        chain.full_state = saved
        begin = SoftState.at_rest(chain.state.positions, chain.state.memory)
        found = chain.solve(begin, saved.flange, saved.loads)
        chain.commit(found)
        return found
