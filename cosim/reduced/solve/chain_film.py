"""The film's nodes on a chain of frames, and the chain of a film. A film that was computed from a chain is
remembered with it: pressure, points and their velocities, and those one step before. If nodes or velocities
have changed since, frames are fitted to them.
"""

import numpy as np

from cosim.base.frames import Pose
from cosim.reduced.section_model import SectionBody
from cosim.reduced.solve.chain_step import ChainState
from cosim.reduced.solve.clamp import rates_from_nodes
from cosim.soft.solve.state import SoftState


def film_of(section: SectionBody, chain: ChainState) -> SoftState:
    """Return the film's nodes on a chain."""
    pressure_Pa = chain.pressure_Pa
    parts = [chain.motion] if chain.earlier is None else [chain.motion, chain.earlier]
    return SoftState(
        section.positions(chain.frames, pressure_Pa),
        section.positions(chain.rates, pressure_Pa),
        np.concatenate([(pressure_Pa,), *(points.reshape(-1) for points in parts)]),
    )


def chain_of(section: SectionBody, film: SoftState, flange: Pose, pressure_Pa: float) -> ChainState:
    """Return the chain of a film.

    Args:
        section: whose film it is.
        film: made by `film_of`, or any other.
        flange: pose of the first frame, where frames are fitted.
        pressure_Pa: of the gas, for a film that remembers none.
    """
    frames, shape = None, (2, *section.frames.drawn.shape)
    if len(film.memory) % int(np.prod(shape)) == 1:
        pressure_Pa, (motion, *earlier) = float(film.memory[0]), film.memory[1:].reshape(-1, *shape)
        remembered = ChainState(motion, pressure_Pa, *earlier)
        remembered_film = film_of(section, remembered)
        if np.array_equal(remembered_film.positions, film.positions):
            if np.array_equal(remembered_film.velocities, film.velocities):
                return remembered
            frames = remembered.frames
    if frames is None:
        frames = section.frames.fit(film.positions, flange)
    rates = rates_from_nodes(section.frames, frames, film.velocities)
    return ChainState(np.array((frames, rates)), pressure_Pa)
