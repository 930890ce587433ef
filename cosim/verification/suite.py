"""The suite: every case in the order of the table, how one is run, and its results as a table and as JSON."""

import json
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

from cosim._version import __version__
from cosim.errors import InputError, SolverError
from cosim.verification import cables, films, pouches, shells, stacks, strips, vibrations
from cosim.verification.case import Case, Figure

_FAMILIES = (strips, cables, shells, pouches, films, stacks, vibrations)

CASES: tuple[Case, ...] = tuple(
    value for module in _FAMILIES for value in vars(module).values() if isinstance(value, Case)
)


@final
@dataclass(frozen=True)
class CaseResult:
    """What one case found.

    Args:
        case: which one.
        figures: its numbers; empty when it could not be solved.
        seconds: wall-clock time.
        failure: why it could not be solved; empty if it could.
    """

    case: Case
    figures: tuple[Figure, ...]
    seconds: float
    failure: str = ""

    @property
    def passed(self) -> bool:
        """Whether it was solved and every figure is within its tolerance."""
        return not self.failure and bool(self.figures) and all(figure.passed for figure in self.figures)


def select(names: Sequence[str], cases: Sequence[Case] = CASES) -> tuple[Case, ...]:
    """Return the named cases in the order asked for; all of them if none is named.

    Args:
        names: names of cases.
        cases: to choose from.

    Raises:
        InputError: there is no such case.
    """
    known = {case.name: case for case in cases}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError(f"no verification case {unknown[0]!r}; there are: {', '.join(known)}")
    return tuple(known[name] for name in names) if names else tuple(cases)


def run_case(case: Case) -> CaseResult:
    """Run one case; a case that cannot be solved has failed, and says why."""
    started = time.perf_counter()
    try:
        figures, failure = case.run(), ""
    except SolverError as error:
        figures, failure = (), str(error)
    return CaseResult(case, figures, time.perf_counter() - started, failure)


HEADER = ("quantity", "value", "reference", "error", "tolerance", "order", "")
_WIDTHS = (52, 12, 12, 9, 9, 5, 4)


def case_lines(result: CaseResult) -> str:
    """Return the table's lines of one case."""
    verdict = "pass" if result.passed else "FAIL"
    lines = [f"{result.case.name}: {result.case.title} ({result.seconds:.2f} s) {verdict}"]
    lines += ["  " + _joined(_cells(figure)) for figure in result.figures]
    if result.failure:
        lines.append(f"  not solved: {result.failure}")
    return "\n".join(lines)


def header_line() -> str:
    """Return the table's first line."""
    return "  " + _joined(HEADER)


def closing_line(results: Sequence[CaseResult]) -> str:
    """Return how many cases passed, and in which time."""
    passed = sum(result.passed for result in results)
    seconds = sum(result.seconds for result in results)
    failed = [result.case.name for result in results if not result.passed]
    tail = f"; failed: {', '.join(failed)}" if failed else ""
    return f"{passed} of {len(results)} cases passed in {seconds:.1f} s{tail}"


def as_json(results: Sequence[CaseResult]) -> str:
    """Return all results as a JSON document; numbers that are not finite become null."""
    cases = [
        {
            "name": result.case.name,
            "title": result.case.title,
            "source": result.case.source,
            "seconds": result.seconds,
            "passed": result.passed,
            "failure": result.failure or None,
            "figures": [_figure(figure) for figure in result.figures],
        }
        for result in results
    ]
    passed = all(result.passed for result in results)
    document = {"cosim": __version__, "passed": passed, "cases": cases}
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


def _figure(figure: Figure) -> dict[str, Any]:
    return {
        "quantity": figure.quantity,
        "unit": figure.unit,
        "value": _finite(figure.value),
        "reference": figure.reference,
        "error": _finite(figure.error),
        "tolerance": figure.tolerance,
        "error_is": "absolute" if figure.absolute else "relative",
        "observed_order": _finite(figure.observed_order),
        "passed": figure.passed,
    }


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _cells(figure: Figure) -> tuple[str, ...]:
    unit = "" if figure.unit == "1" else f" [{figure.unit}]"
    order = _finite(figure.observed_order)
    return (
        figure.quantity + unit,
        f"{figure.value:.6g}",
        f"{figure.reference:.6g}",
        _error(figure.error, figure.absolute),
        _error(figure.tolerance, figure.absolute),
        "" if order is None else f"{order:.2f}",
        "" if figure.passed else "FAIL",
    )


def _error(value: float, absolute: bool) -> str:
    return f"{value:.1e}" if absolute else f"{100.0 * value:.3f} %"


def _joined(cells: Sequence[str]) -> str:
    first, *others = (
        f"{cell:<{width}}" if k == 0 else f"{cell:>{width}}"
        for k, (cell, width) in enumerate(zip(cells, _WIDTHS, strict=True))
    )
    return " ".join([first, *others]).rstrip()
