"""The automatic exchange: iterated where the staggered one would need an algorithmic mass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.coupling.contact.body_stiffness import RATIO_BOUND
from cosim.coupling.schemes.fixed_point_search import IterationOptions
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.schemes.iterated import IteratedCoupling, IteratedState
from cosim.coupling.schemes.scheme import Coupling
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.coupling.ticks import Servos
from cosim.coupling.ticks_taken import TicksTaken
from cosim.soft.body.loads import Loads

_FLANGE_RATIO_BOUND = 0.5  # of the stability ratio, above which ticks are iterated


@final
@dataclass(frozen=True)
class AutomaticState:
    """Where an `AutomaticCoupling` is.

    Args:
        iterated: its iterated scheme; the staggered one has no state of its own, as it carries no mass.
        iterates: whether the last tick was iterated.
    """

    iterated: IteratedState
    iterates: bool


@final
class AutomaticCoupling(Coupling):
    """Decides before every tick, by the stability ratios of flange and touched bodies.

    Args:
        interface: between the sides.
        options: when the iterated scheme's loads agree.
    """

    def __init__(self, interface: Interface, options: IterationOptions | None = None) -> None:
        super().__init__(interface)
        self._staggered = StaggeredCoupling(interface, np.inf, bodies_carry=False)
        self._iterated = IteratedCoupling(interface, options)
        self._iterates = False

    def advance(self, servos: Servos, loads: Sequence[Loads]) -> TicksTaken:
        interface = self.interface
        if interface.to_be_weighed:
            interface.update_stability_ratio()
        iterates = interface.ratio > _FLANGE_RATIO_BOUND or interface.contact_ratio > RATIO_BOUND
        if iterates and not self._iterates:
            self._iterated.begin_again()
        self._iterates = iterates
        return (self._iterated if iterates else self._staggered).advance(servos.some(0, 1), loads[:1])

    def save_state(self) -> AutomaticState:
        return AutomaticState(self._iterated.save_state(), self._iterates)

    def restore_state(self, state: AutomaticState) -> None:
        self._iterated.restore_state(state.iterated)
        self._iterates = state.iterates
