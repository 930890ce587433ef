"""The search, within one tick, for the loads on which both sides agree: trials from the same start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, SixNumbers
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.schemes.interface_loads import UNIT, InterfaceLoads
from cosim.coupling.schemes.interface_tangent import contact_tangent
from cosim.coupling.schemes.momentum_balance import received_bodies, received_flange
from cosim.coupling.schemes.quasi_newton import QuasiNewton
from cosim.coupling.soft_sides.soft_side import SoftReply
from cosim.errors import ConvergenceError, SolverError
from cosim.soft.body.loads import Loads
from cosim.soft.solve.time_scheme import StepAim

_SOFT_SHARE = 0.1  # of the interface's residual: what the soft step's own may be
_SMALLEST_N = 1.0  # loads below it count as this large: rounding of the film's forces is far below 1e-9 N
_RENEWED_AFTER = 6  # trials; the contacts are others by then than those the inverse was made for


@final
@dataclass(frozen=True)
class IterationOptions:
    """When the loads between both sides agree.

    Args:
        tolerance: largest residual over the size of the loads.
        iterations_max: trials of a tick before it counts as failed.
    """

    tolerance: float = 1e-9
    iterations_max: int = 30


@final
@dataclass(frozen=True)
class Trial:
    """One trial of a tick.

    Args:
        load: (n,) that acted on the rigid side.
        answered: (n,) by the soft side.
        residual: (n,), what has not acted yet.
        size: of the residual over that of the loads.
        reply: of the soft side.
        received: read back from MuJoCo: on the flange, on bodies, about the world's origin.
    """

    load: Array
    answered: Array
    residual: Array
    size: float
    reply: SoftReply
    received: tuple[SixNumbers, SixNumbers]


@final
class InterfaceSearch:
    """Trials of one tick; after `run`, both sides stand at its end.

    Args:
        interface: at the start of the tick, servos commanded.
        vector: how loads are read and written, begun for this tick.
        rigid_half: takes that of the tick, with a wrench (6,) at the flange's origin.
        loads: on the soft body at the end of the tick.
        options: when loads agree.
        inverse: of dr/dl, as the last tick left it; None for none.
    """

    def __init__(
        self,
        interface: Interface,
        vector: InterfaceLoads,
        rigid_half: Callable[[Array], None],
        loads: Loads,
        options: IterationOptions,
        inverse: Array | None,
    ) -> None:
        self._interface, self._vector, self._soft_loads = interface, vector, loads
        self._rigid_half, self._options, self.inverse = rigid_half, options, inverse
        self._rigid, self._before = interface.scene.save_state(), interface.soft.state
        self._contact = None if interface.contact is None else interface.contact.save_state()
        self._mobility = interface.scene.mobility(vector.bodies)
        self._scale = _SMALLEST_N
        self._reached: Array | None = None
        self.trials = self.newton_iterations = 0

    def run(self, guess: Array, fallback: Array, owed: Array) -> Trial:
        """Return the trial in which the loads agree.

        Args:
            guess: (n,), loads to begin with.
            fallback: (n,), those where the guess has no solution.
            owed: u (n,), that acts besides what the soft side answers.

        Raises:
            ConvergenceError: the loads do not agree after all trials; both sides stand at the start.
            InstabilityError: the rigid side is not finite under the loads of the start either.
        """
        best, load, quasi_newton, error = None, guess, None, None
        while self.trials < self._options.iterations_max:
            try:
                trial = self._take(load, owed)
            except SolverError as failure:
                error = failure
                load = fallback if best is None else 0.5 * (load + best.load)
                continue
            if trial.size <= self._options.tolerance:
                self._learn(quasi_newton)
                return trial
            if best is None or trial.size < best.size:
                best = trial
            if quasi_newton is None or self.trials % _RENEWED_AFTER == 0:
                quasi_newton = QuasiNewton(self._inverse_here())
            load = load + quasi_newton.step(load, trial.residual)
        self._go_back()
        if best is None and error is not None:
            raise error
        size = np.inf if best is None else best.size
        raise ConvergenceError(
            f"the loads between both sides do not agree after {self.trials} trials of a tick: they differ by "
            f"{size:.3g} of their size, above coupling.tolerance = {self._options.tolerance:g}; try a "
            "shorter tick, or coupling.scheme = 'staggered'",
            size * self._scale,
            self.newton_iterations,
        )

    def _take(self, load: Array, owed: Array) -> Trial:
        """Take the tick under loads (n,)."""
        interface, vector, scene = self._interface, self._vector, self._interface.scene
        if self.trials:
            self._go_back()
        self.trials += 1
        vector.apply(load)
        received = received_flange(scene), received_bodies(scene)
        self._rigid_half(UNIT * load[:6])
        aim = StepAim(_SOFT_SHARE * self._options.tolerance * self._scale, self._reached)
        reply = interface.advance_soft(self._soft_loads, aim)
        self._reached = interface.soft.state.positions
        self.newton_iterations += reply.iterations
        answered = vector.answered()
        residual = answered + owed - load
        sizes = (float(np.abs(answered).max()), interface.touched.normal_force_N, _SMALLEST_N)
        self._scale = max(sizes)
        size = float(np.abs(residual).max()) / self._scale
        return Trial(load, answered, residual, size, reply, received)

    def _go_back(self) -> None:
        """Return both sides to the start of the tick; the soft side keeps its factorisation."""
        interface = self._interface
        interface.scene.restore_state(self._rigid)
        interface.soft.restore(self._before)
        if interface.contact is not None and self._contact is not None:
            interface.contact.restore_state(self._contact)

    def _learn(self, quasi_newton: QuasiNewton | None) -> None:
        """Keep for the next tick what the secants of this one have shown."""
        if quasi_newton is not None:
            self.inverse = quasi_newton.inverse(self._scale)

    def _inverse_here(self) -> Array:
        """Return -(1 + h^2 S W)^-1 (n, n); that of the tick before where no body that can move is touched."""
        interface, vector = self._interface, self._vector
        step_s = interface.scene.tick_s
        touching = None
        if interface.contact is not None:
            touching = contact_tangent(
                interface.contact, interface.soft, vector.bodies, vector.points, step_s
            )
        if touching is None and self.inverse is not None and self.trials < _RENEWED_AFTER:
            return self.inverse
        mass = np.zeros((len(vector), len(vector))) if touching is None else step_s**2 * touching
        weight = step_s**2 * interface.soft.inertia_weight(step_s)
        mass[:6, :6] = weight * interface.soft.mass_properties().spatial(vector.points[0])
        unit = np.tile(UNIT, len(vector) // 6)
        product = (mass @ self._mobility) * (unit / unit[:, None])
        return -np.linalg.inv(np.eye(len(vector)) + product)
