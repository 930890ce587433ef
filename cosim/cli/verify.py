"""`cosim verify`: runs cases with known answers and says which numbers fall short."""

import sys
from collections.abc import Sequence
from pathlib import Path

from cosim.build.kernel_modules import compile_kernels
from cosim.errors import InputError
from cosim.soft.beams import ring_kernels
from cosim.soft.contact import obstacle_contact
from cosim.soft.elements import eyelets, frame_ring
from cosim.soft.linear import fronts
from cosim.verification.case import Case
from cosim.verification.suite import CASES, as_json, case_lines, closing_line, header_line, run_case, select


def verify_command(names: Sequence[str], json_path: Path | None, *, cases: Sequence[Case] = CASES) -> int:
    """Run cases, print their table and return the exit code: 0 if all pass, 1 if any falls short.

    Args:
        names: of the cases; none means all.
        json_path: file for the results; None writes none.
        cases: to choose from.

    Raises:
        InputError: an unknown case, or a file that cannot be written; nothing was run.
    """
    chosen = select(names, cases)
    if json_path is not None:
        _check_writable(json_path)
    some = fronts, ring_kernels, frame_ring, eyelets, obstacle_contact
    compile_kernels(lambda text: print(text, file=sys.stderr), some)
    print(header_line(), flush=True)
    results = []
    for case in chosen:
        results.append(run_case(case))
        print(case_lines(results[-1]), flush=True)
    print(closing_line(results))
    if json_path is not None:
        json_path.write_text(as_json(results), encoding="utf-8")
    return 0 if all(result.passed for result in results) else 1


def list_command() -> int:
    """Print the names, titles and sources of all cases."""
    width = max(len(case.name) for case in CASES)
    for case in CASES:
        print(f"{case.name:<{width}}  {case.title}\n{'':<{width}}  {case.source}")
    return 0


def _check_writable(path: Path) -> None:
    """Refuse a file that cannot be written before minutes are spent on what goes into it."""
    if path.is_dir():
        raise InputError(f"--json {path} is a directory; give a file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    except OSError as error:
        raise InputError(f"--json {path} cannot be written: {error.strerror}") from error
