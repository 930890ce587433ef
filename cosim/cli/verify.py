"""The command `cosim verify`: runs cases with known answers and prints which of them fail."""

import time
from collections.abc import Sequence

from cosim.bench.known_answers import CASES
from cosim.errors import InputError, SolverError

_ROW = "{:<22}{:<44}{:>14}{:>14}{:>11}  {}".format


def verify_command(names: Sequence[str]) -> int:
    """Run cases, print their table and return the exit code: 0 if all pass, 1 if any fails.

    Args:
        names: names of the cases; empty for all.

    Raises:
        InputError: a case is unknown; nothing was run.
    """
    unknown = [name for name in names if name not in CASES]
    if unknown:
        raise InputError(f"no verification case {unknown[0]!r}; there are: {', '.join(CASES)}")
    chosen, failed, began = names or tuple(CASES), [], time.perf_counter()
    print(_ROW("case", "quantity", "found", "expected", "tolerance", "passes"), flush=True)
    for name in chosen:
        try:
            figures = CASES[name]()
        except SolverError as error:
            print(f"{name}: not solved: {error}", flush=True)
            failed.append(name)
            continue
        for each in figures:
            numbers = f"{each.found:.7g}", f"{each.expected:.7g}", f"{100.0 * each.tolerance:g} %"
            print(_ROW(name, each.quantity, *numbers, "yes" if each.passed else "NO"), flush=True)
        if not all(each.passed for each in figures):
            failed.append(name)
    tail = f"; failed: {', '.join(failed)}" if failed else ""
    passed, seconds = len(chosen) - len(failed), time.perf_counter() - began
    print(f"{passed} of {len(chosen)} cases passed in {seconds:.1f} s{tail}")
    return 1 if failed else 0
