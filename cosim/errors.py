"""Every error that cosim raises on purpose.

CosimError
├── InputError              the user's data is wrong; nothing has run yet (exit code 2)
│   ├── ScenarioError       a scenario or robot file: carries the path of every wrong key
│   ├── SceneError          the rigid engine refuses a body of the scene: carries the body's name
│   ├── MeshError           degenerate, inverted or unconnected meshes
│   └── UnreachableError    no configuration reaches the wanted pose; carries the closest one
├── WorkerError             a process of a batch has ended; the text names its runs
├── OutputError             the results cannot be written (exit code 3)
└── SolverError             the physics could not be solved (exit code 1)
    ├── ConvergenceError    Newton's method stopped; carries residual and iterations
    │   ├── OutOfRangeError what is asked for lies beyond what a section model was built from; carries where
    │   └── TickWorkError   one tick took more work than any should: the motion is too fast for the tick
    ├── SensitivityError    an equilibrium has no derivative by a parameter: a fold, a slip, a kink
    └── InstabilityError    a non-finite number or runaway state appeared
RunInterrupted              Ctrl-C during `cosim.run`; a KeyboardInterrupt, no CosimError

All of them can be pickled. What ends `cosim.run` or `Simulation.step` early carries `result`.
"""

from typing import Any, Final, Self

MOST_LINES: Final = 20
"""Faults of a file that one message lists."""


class CosimError(Exception):
    """Base of every error that cosim raises on purpose.

    `result` holds the arrays that a run had computed until this error ended it; None where no run was ended.
    """

    result: Any = None

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to make the error again: by what it holds, whatever its constructor asks for."""
        return _made_anew, (type(self), self.args, vars(self))


class InputError(CosimError):
    """The user's data is wrong; nothing has been run or written."""


class ScenarioError(InputError):
    """A scenario or robot file holds wrong keys or values; `path` names the first one of `faults`.

    Args:
        path: of the key.
        message: its fault, and the allowed values.
        further: (path, message) of the others; the text of the error has a line for each of the first ones.
    """

    def __init__(self, path: str, message: str, further: tuple[tuple[str, str], ...] = ()) -> None:
        self.path = path
        self.faults = ((path, message), *further)
        lines = [f"{place}: {problem}" if place else problem for place, problem in self.faults[:MOST_LINES]]
        if len(self.faults) > MOST_LINES:
            lines.append(f"... and {len(self.faults) - MOST_LINES} more")
        super().__init__("\n".join(map(_in_one_line, lines)))


def _in_one_line(text: str) -> str:
    """Return a text with escapes for what would not show: names in it may be anybody's."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class SceneError(InputError):
    """The rigid engine refuses the scene; `body` names the object or wire, None: the whole scene."""

    def __init__(self, message: str, body: str | None) -> None:
        self.body = body
        super().__init__(message)


class MeshError(InputError):
    """A mesh is degenerate, inverted, or refers to nodes that do not exist."""


class UnreachableError(InputError):
    """No allowed configuration reaches the wanted pose; `closest` is the best one found."""

    def __init__(self, message: str, closest: Any = None) -> None:
        self.closest = closest
        super().__init__(message)


class OutputError(CosimError):
    """Results cannot be written, for want of room or of the directory; the text names the saved files."""


class WorkerError(CosimError):
    """A process that held runs of a batch has ended, and these with it; the text names both."""


class SolverError(CosimError):
    """The physics could not be solved."""

    def at(self, where: str) -> Self:
        """Put before the message where it has happened, or what was tried; return the error.

        Args:
            where: put before the message, and a colon.
        """
        self.args = (f"{where}: {self}", *self.args[1:])
        return self


class ConvergenceError(SolverError):
    """Newton's method stopped before the residual fell below its bound."""

    def __init__(self, message: str, residual_N: float, iterations: int) -> None:
        self.residual_N = residual_N
        self.iterations = iterations
        super().__init__(message)


class OutOfRangeError(ConvergenceError):
    """A section model ends before the load that is asked for; `place` says which section, and where."""

    def __init__(self, message: str, residual_N: float, iterations: int, place: str) -> None:
        self.place = place
        super().__init__(message, residual_N, iterations)


class TickWorkError(ConvergenceError):
    """One tick took more Newton iterations, or divisions of its steps, than any should; its begin is kept."""


class SensitivityError(SolverError):
    """An equilibrium has no derivative by a parameter: at a fold, where something begins to slip or touch."""


class InstabilityError(SolverError):
    """A non-finite number or a runaway state appeared."""


class RunInterrupted(KeyboardInterrupt):
    """The user has interrupted a run; `result` holds the arrays up to the last tick that was shown."""

    result: Any = None


def _made_anew(kind: type[CosimError], args: tuple[Any, ...], held: dict[str, Any]) -> CosimError:
    error = kind.__new__(kind, *args)
    error.args = args
    vars(error).update(held)
    return error
