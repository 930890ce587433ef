"""How the tip of a chain of frames moves with its loads: the implicit function theorem."""

from __future__ import annotations

from dataclasses import replace
from typing import final

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from cosim.base.frames import Array, Mask
from cosim.errors import ConvergenceError
from cosim.reduced.solve.newton import Bed, ChainSolver
from cosim.soft.body.loads import Loads
from cosim.soft.body.tip_frame import TipFrame


@final
class ChainTangent:
    """The factorised tangent of a chain.

    Args:
        solver: of the chain.
        frames: (f, 4, 3), where it is taken.
        free: (f,) frames that can move.
        loads: that act.
        pressure_Pa: of the gas; a sealed one is taken to keep it.
        bed: of an implicit step; None in statics.
        extra: (6 f, 6 f) added to it, such as contacts.

    Raises:
        LinAlgError: it is not positive definite.
    """

    def __init__(
        self,
        solver: ChainSolver,
        frames: Array,
        free: Mask,
        loads: Loads,
        pressure_Pa: float,
        bed: Bed | None = None,
        extra: Array | None = None,
    ) -> None:
        solver.evaluate(frames, loads, pressure_Pa, bed, hessian=True)
        count = len(frames)
        full = np.zeros((count, 6, count, 6))
        for f in range(count):
            full[f, :, f] = solver.diagonal[f]
            if f:
                full[f, :, f - 1] = solver.off[f]
                full[f - 1, :, f] = solver.off[f].T
        self._free = np.repeat(free, 6)
        matrix = full.reshape(6 * count, -1)
        if extra is not None:
            matrix = matrix + extra
        self._factor = cho_factor(matrix[np.ix_(self._free, self._free)])

    def solve(self, load: Array) -> Array:
        """Return the steps (k, f, 6) under loads (k, f, 6); zero where held."""
        flat = load.reshape(len(load), -1)
        result = np.zeros_like(flat)
        result[:, self._free] = cho_solve(self._factor, flat[:, self._free].T).T
        return result.reshape(load.shape)


@final
class ChainSensitivity:
    """Derivatives of an equilibrium's tip.

    Args:
        solver: of the chain.
        frames: (f, 4, 3), at equilibrium.
        free: (f,) frames that can move.
        loads: that act.
        pressure_Pa: of the gas.
        extra: (6 f, 6 f) added to the tangent; None for nothing.

    Raises:
        ConvergenceError: the equilibrium is not stable.
    """

    def __init__(
        self,
        solver: ChainSolver,
        frames: Array,
        free: Mask,
        loads: Loads,
        pressure_Pa: float,
        extra: Array | None = None,
    ) -> None:
        self._solver, self._frames, self._loads, self._pressure = solver, frames, loads, pressure_Pa
        try:
            self._tangent = ChainTangent(solver, frames, free, loads, pressure_Pa, None, extra)
        except LinAlgError as error:
            raise ConvergenceError(
                "the equilibrium is not stable (its tangent stiffness has a negative eigenvalue), so it has "
                "no useful sensitivity; change the pressure or the flange pose",
                0.0,
                0,
            ) from error
        section = solver.section
        self.tip = TipFrame.of(section.body, section.positions(frames, pressure_Pa))

    def to_gravity(self) -> Array:
        """Return d(tip motion)/d(gravity) (6, 3); the flange stays."""
        gx, gy, gz = self._loads.gravity
        return self._motion(
            [
                replace(self._loads, gravity=moved)
                for moved in ((gx + 1.0, gy, gz), (gx, gy + 1.0, gz), (gx, gy, gz + 1.0))
            ]
        )

    def to_tension(self) -> Array:
        """Return d(tip motion)/d(cable tension) (6, cables); the flange stays."""
        tension = self._loads.cable_tension_N
        if not tension:
            return np.zeros((6, 0))
        more = [tuple(t + 1.0 if k == c else t for k, t in enumerate(tension)) for c in range(len(tension))]
        return self._motion([replace(self._loads, cable_tension_N=pulled) for pulled in more])

    def _motion(self, loads: list[Loads]) -> Array:
        """Return the tip's motion (6, k) with loads that are one unit up; the gradient is linear in them."""
        still = self._solver.evaluate(self._frames, self._loads, self._pressure)
        change = [self._solver.evaluate(self._frames, load, self._pressure) - still for load in loads]
        return np.asarray(self._tangent.solve(-np.array(change))[:, -1].T)
