"""One step of a soft robot: its reply to the flange, and the halving of steps that do not converge."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias, final

from cosim.base.frames import Pose, Wrench
from cosim.errors import ConvergenceError, TickWorkError
from cosim.soft.body.loads import Loads
from cosim.soft.solve import tick_work
from cosim.soft.solve.step_scheme import StepAccuracy

_HALVINGS_MAX: Final = 5

StepInput: TypeAlias = tuple[Pose, Loads]
"""Pose of the flange, and loads, at one instant."""
StepFunction: TypeAlias = Callable[[StepInput, StepInput, float, StepAccuracy | None], int]


@final
@dataclass(frozen=True)
class SoftReply:
    """Result of a step of the soft robot.

    Args:
        wrench: on the flange, at its origin, world axes.
        residual_N: largest out-of-balance component.
        iterations: Newton iterations.
        films_work_J: work of self-contact on the films.
        eyelets_J: energy lost at eyelets with a known direction of sliding.
    """

    wrench: Wrench
    residual_N: float
    iterations: int
    films_work_J: float = 0.0
    eyelets_J: float = 0.0


def step_with_halving(
    stepper: tuple[StepFunction, Callable[[], None], tick_work.TickWork],
    begin: StepInput,
    end: StepInput,
    step_s: float,
    accuracy: StepAccuracy | None,
    final: type[ConvergenceError] = TickWorkError,
) -> int:
    """Take one step, or two half steps if it does not converge; return the number of Newton iterations.

    Args:
        stepper: function that takes a step between two inputs, or raises and keeps the state; function that
            restarts a two-step integrator, as the step length changes; counter of the tick's work.
        begin: flange pose and loads at the start.
        end: flange pose and loads at the end.
        step_s: length [s].
        accuracy: None for an ordinary step.
        final: a kind of error after which no halves are tried.

    Raises:
        ConvergenceError: the shortest steps do not converge either.
    """

    def take(
        begin: StepInput, end: StepInput, step_s: float, accuracy: StepAccuracy | None, halvings: int
    ) -> int:
        try:
            return step(begin, end, step_s, accuracy)
        except ConvergenceError as error:
            if isinstance(error, final | TickWorkError):
                raise
            if halvings == 0:
                raise error.at(f"even in steps of {1e3 * step_s:.3g} ms") from None
            iterations, residual_N = error.iterations, error.residual_N
        work.divide(residual_N)
        middle = (begin[0].interpolated(end[0], 0.5), begin[1].interpolated(end[1], 0.5))
        restart()
        accuracy = None if accuracy is None else StepAccuracy(accuracy.tolerance_N)
        for half_begin, half_end in ((begin, middle), (middle, end)):
            iterations += take(half_begin, half_end, 0.5 * step_s, accuracy, halvings - 1)
        restart()
        return iterations

    step, restart, work = stepper
    return take(begin, end, step_s, accuracy, _HALVINGS_MAX)
