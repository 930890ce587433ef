"""Bound of the work of one tick."""

from typing import Final, final

from cosim.errors import TickWorkError

TICK_ITERATIONS_MAX: Final = 1000
"""New tangents of one tick, including further attempts to factorise one, before the tick fails.

A tangent with contact counts more, by its number of multiplications relative to the film's alone.
"""
TICK_DIVISIONS_MAX: Final = 64


@final
class TickWork:
    """Bounds the work of one tick, including repeated and divided steps; counts are deterministic."""

    def __init__(self) -> None:
        self.iterations, self.divisions = 0.0, 0
        self._depth = 0

    def __enter__(self) -> None:
        """Begin one tick, or a part of the one in progress."""
        if not self._depth:
            self.iterations, self.divisions = 0.0, 0
        self._depth += 1

    def __exit__(self, *_raised: object) -> None:
        """End the tick, or the part of it."""
        self._depth -= 1

    def spend(self, iterations: float, residual_N: float) -> None:
        """Count iterations with a new tangent, and further attempts to factorise one.

        Args:
            iterations: since the last call, in factorisations of a film that nothing touches.
            residual_N: largest out-of-balance component that is left.

        Raises:
            TickWorkError: no more are left.
        """
        self.iterations += iterations
        if self._depth and self.iterations > TICK_ITERATIONS_MAX:
            bound_text = f"{TICK_ITERATIONS_MAX} new tangents (those of films in contact count for more)"
            raise self._used_up(bound_text, residual_N)

    def divide(self, residual_N: float) -> None:
        """Count a division of a step.

        Args:
            residual_N: see `spend`.

        Raises:
            TickWorkError: no more are left.
        """
        self.divisions += 1
        if self._depth and self.divisions > TICK_DIVISIONS_MAX:
            raise self._used_up(f"{TICK_DIVISIONS_MAX} divisions of its steps", residual_N)

    def _used_up(self, bound_text: str, residual_N: float) -> TickWorkError:
        return TickWorkError(
            f"the soft step reached the bound of a tick, {bound_text}, with {residual_N:.3g} N out of "
            "balance: the motion or the loads change too fast for it. Spread the command over more time (a "
            "ramp, not a jump), take a shorter tick (clock.tick_s; the timestep of an attached model), or "
            "raise solver.damping_per_s",
            residual_N,
            round(self.iterations),
        )
