"""What a camera of 320 x 240 costs while the reference scenario runs, and pictures a second by themselves.

python benchmarks/cameras.py [--pairs N]
"""

from __future__ import annotations

import argparse
import time
from typing import Any, Final

import cosim

_SCENARIO: Final = "ur5e_hexagon_arm"
_CAMERA: Final = {
    "name": "view", "position_m": [1.4, -1.2, 0.9], "direction": [-1.0, 1.1, -0.5], "rate_Hz": 30.0,
}  # fmt: skip
_PICTURES: Final = 100


def main() -> None:
    """Run the scenario with and without a camera in turn, and print the processor time of both."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--pairs", type=int, default=2, help="runs with and without the camera")
    pairs = parser.parse_args().pairs
    run([])  # kernels and the plan
    for _ in range(pairs):
        (plain_s, _), (seen_s, result) = run([]), run([_CAMERA])
        count, simulated_s = len(result.images["view"].tick), result.time_s[-1]
        print(
            f"{simulated_s:g} s simulated: {plain_s:.2f} s of processor time without a camera, {seen_s:.2f} s"
        )
        print(
            f"  with {count} pictures: {count / seen_s:.0f} a second, {simulated_s / seen_s:.2f} x real time"
        )
    here = cosim.Simulation(_SCENARIO, overrides={"camera": [_CAMERA]})
    here.image("view")
    began = time.process_time()
    for _ in range(_PICTURES):
        here.image("view")
    print(f"{_PICTURES / (time.process_time() - began):.0f} pictures a second by themselves")


def run(cameras: list[dict[str, Any]]) -> tuple[float, cosim.RunResult]:
    """Return the processor time of a run [s], and what it returned."""
    began = time.process_time()
    result = cosim.run(_SCENARIO, overrides={"camera": cameras}, error=False)
    return time.process_time() - began, result


if __name__ == "__main__":
    main()
