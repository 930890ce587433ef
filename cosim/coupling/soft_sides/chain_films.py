"""Films on chains of frames: the nodes of a chain, and the chain of some nodes."""

from __future__ import annotations

from collections import deque
from typing import final

import numpy as np

from cosim.base.frames import Pose
from cosim.reduced.section_model import SectionBody
from cosim.reduced.solve.kinematics import rates_from_nodes
from cosim.reduced.solve.state import ChainState
from cosim.soft.solve.state import SoftState

_REMEMBERED = 8
_NO_ANGLES = np.zeros(0)  # a chain has no hinges


@final
class ChainFilms:
    """Makes the film's nodes from frames, and finds the frames of nodes again.

    The latest films are remembered with their chains, so that one that is handed back is taken up exactly;
    any other is fitted.

    Args:
        section: whose film it is.
    """

    def __init__(self, section: SectionBody) -> None:
        self._section = section
        self._known: deque[tuple[SoftState, ChainState, float]] = deque(maxlen=_REMEMBERED)

    def film(self, chain: ChainState, pressure_Pa: float) -> SoftState:
        """Return the film's nodes on a chain."""
        section = self._section
        film = SoftState(
            section.positions(chain.frames, pressure_Pa),
            section.positions(chain.rates, pressure_Pa),
            _NO_ANGLES,
        )
        self._known.append((film, chain, pressure_Pa))
        return film

    def chain(self, film: SoftState, flange: Pose, pressure_Pa: float) -> tuple[ChainState, float]:
        """Return the chain of a film, and the gas pressure it was made with.

        Args:
            film: the nodes.
            flange: pose of the first frame.
            pressure_Pa: returned for a film that is not remembered.
        """
        for known, chain, pressure in self._known:
            if known is film:
                return chain, pressure
        layout = self._section.frames
        frames = layout.fit(film.positions, flange)
        rates = rates_from_nodes(layout, frames, film.velocities)
        return ChainState(np.array((frames, rates))), pressure_Pa
