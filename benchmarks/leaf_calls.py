"""What each part of a scene costs a tick: calls of compiled functions (leaves) from Python, and microseconds.

    python benchmarks/leaf_calls.py [NAME ...] [--page docs/performance.md]

Three units of the default arm hang still from a UR5e; one thing is added at a time. Python's profiler counts
the calls over ticks at rest, so they do not depend on the machine. Times are of further ticks without it, all
situations in turn, the least of several rounds. A step is arm, film, exchange and snapshot.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from types import CodeType, FrameType
from typing import Any, Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import cosim
from benchmarks.measure.page_tables import put_table

SCENARIO: Final = """
schema = 2
title = "Three units of the default arm hang still"
robot = "ur5e"
soft_robot = {{ file = "hexagon_arm", stack = {{ units = {units} }}{cables} }}
fidelity = "lumped"
contact = {{ self_contact = {pairs}, only_in_reach = {left_out} }}
start = {{ flange = {{ position_m = [0.4, 0.0, 0.5], direction = [0.0, 0.0, -1.0] }}, pressure_Pa = 5e3 }}
phase = [{{ name = "hang", duration_s = 10.0 }}]
object = [{block}]
"""
BLOCK: Final = (
    '{{ name = "block", shape = "box", size_m = [0.3, 0.3, 0.1], position_m = [0.4, {y_m}, {z_m}]{mass} }}'
)
TOUCHES_m: Final = 0.42048
"""Height of the block's centre at which it meets the still arm."""
SITUATIONS: Final[dict[str, dict[str, Any]]] = {
    "bare film": {},
    "two cables": {"cables": True},
    "block beyond reach": {"z_m": 0.05, "y_m": 0.6, "left_out": True},
    "block far": {"z_m": 0.05},
    "block far, movable": {"z_m": 0.05, "mass_kg": 0.5},
    "block 3 mm away": {"z_m": TOUCHES_m - 3e-3},
    "block 0.5 mm away": {"z_m": TOUCHES_m - 5e-4},
    "block touches": {"z_m": TOUCHES_m + 5e-5},
    "film pairs, none near (one unit)": {"units": 1, "pairs": True},
    "film pairs near": {"pairs": True},
}
"""What differs in each situation from the bare film, see `scenario_text`."""
PARTS: Final[dict[str, tuple[str, ...]]] = {
    "cables": ("soft.elements.cable.", "soft.elements.eyelets."),
    "objects": (
        "coupling.contact.", "rigid.distance.", "soft.contact.obstacle_contact.", "soft.contact.contact_law.",
        "soft.contact.contact_points.",
    ),
    "film pairs": ("soft.contact.", "soft.solve.self_contact."),
    "film": ("soft.",),
    "arm": ("",),
}  # fmt: skip
"""Part of the model to which a leaf belongs: that with the first beginning of its name that fits."""
EVALUATION: Final = "soft.elements.mass_terms.add_gravity"
"""Called once per evaluation of the film."""
_SETTLED: Final = 100
_COUNTED: Final = 50
_TIMED: Final = 200
_ROUNDS: Final = 7


def scenario_text(changes: Mapping[str, Any]) -> str:
    """Return a scenario's text.

    Args:
        changes: `units`; `cables`: whether it has its two; `pairs`: whether films touch one another; `z_m`,
            `y_m`, `mass_kg` of the block; `left_out`: whether contact beyond reach is left out.
    """
    block = ""
    if "z_m" in changes:
        mass = f", mass_kg = {changes['mass_kg']}" if "mass_kg" in changes else ""
        block = BLOCK.format(y_m=changes.get("y_m", 0.0), z_m=changes["z_m"], mass=mass)
    return SCENARIO.format(
        units=changes.get("units", 3),
        cables="" if changes.get("cables") else ", cable = []",
        pairs=str(changes.get("pairs", False)).lower(),
        # without a block the floor is all that the film could touch, and it is beyond reach
        left_out=str(changes.get("left_out", not block)).lower(),
        block=block,
    )


def simulation(changes: Mapping[str, Any]) -> cosim.Simulation:
    """Return a simulation of a situation, some ticks after its start."""
    with TemporaryDirectory() as folder:
        file = Path(folder, "still.toml")
        file.write_text(scenario_text(changes), encoding="utf-8")
        still = cosim.Simulation(file)
    still.step(ticks=_SETTLED)
    return still


def calls_a_tick(still: cosim.Simulation, ticks: int = _COUNTED) -> dict[str, float]:
    """Return how often Python calls each leaf in a tick, by module and name, such as `soft.film.add`.

    Args:
        still: simulation, which is stepped.
        ticks: counted.
    """
    names, found = {id(code): name for code, name in _leaves()}, Counter[str]()

    def count(frame: FrameType, event: str, called: Any) -> None:
        if event == "call" and id(frame.f_code) in names:  # by way of numba's look at the types of arguments
            found[names[id(frame.f_code)]] += 1
        elif event == "c_call" and str(getattr(called, "__module__", "")).startswith("cosim."):
            found[f"{called.__module__}.{called.__name__}".removeprefix("cosim.")] += 1

    for _ in range(ticks):
        sys.setprofile(count)
        try:
            still.step()
        finally:
            sys.setprofile(None)
    return {name: times / ticks for name, times in sorted(found.items())}


def by_part(calls: Mapping[str, float]) -> dict[str, float]:
    """Return the calls a tick of each of `PARTS`."""
    found = dict.fromkeys(PARTS, 0.0)
    for name, times in calls.items():
        found[next(part for part, begins in PARTS.items() if name.startswith(begins))] += times
    return found


def ticks_us(still: Sequence[cosim.Simulation]) -> list[float]:
    """Return the processor time of a tick of each simulation [us], the least of several rounds over all."""
    spent = [[_tick_us(each) for each in still] for _ in range(_ROUNDS)]
    return [min(times) for times in zip(*spent, strict=True)]


def _tick_us(still: cosim.Simulation) -> float:
    began = time.process_time()
    still.step(ticks=_TIMED)
    return 1e6 * (time.process_time() - began) / _TIMED


def _leaves() -> Iterator[tuple[CodeType, str]]:
    """Return the Python code of every leaf that is loaded, and its name."""
    for module in [module for name, module in sys.modules.items() if name.startswith("cosim.")]:
        for value in vars(module).values():
            if getattr(value, "fixed_signature", None) is not None:
                code = value.py_func.__code__
                yield code, f"{value.__module__}.{value.__name__}".removeprefix("cosim.")


def main() -> None:
    """Count, measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", help=f"of {', '.join(SITUATIONS)}; default: all")
    parser.add_argument("--leaves", action="store_true", help="print every leaf too")
    parser.add_argument("--page", type=Path)
    options = parser.parse_args()
    head = ("added", "evaluations", "all leaves", *PARTS, "us a tick")
    names = options.names or list(SITUATIONS)
    still = [simulation(SITUATIONS[name]) for name in names]
    counted = [calls_a_tick(each) for each in still]
    rows = [f"| {' | '.join(head)} |", "|---|" + "---:|" * (len(head) - 1)]
    for name, calls, us in zip(names, counted, ticks_us(still), strict=True):
        counts = (calls[EVALUATION], sum(calls.values()), *by_part(calls).values())
        rows.append(f"| {name} | {' | '.join(f'{each:.3g}' for each in counts)} | {us:.0f} |")
        if options.leaves:
            print(name, *(f"{times:8.2f} {leaf}" for leaf, times in calls.items()), sep="\n", file=sys.stderr)
    print("\n".join(rows))
    if options.page:
        put_table(options.page, "leaf calls", "\n".join(rows))


if __name__ == "__main__":
    main()
