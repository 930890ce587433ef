"""What a live view costs the simulating process: CPU time of runs with one and without, taken in turn.

    python benchmarks/live_view.py [--pairs 10] [--scenario ur5e_hexagon_arm]

Both write their recording; the one that is shown sends it to a viewer's page as well, a process of its own
that is not counted. The paper's lumped model is taken: its ticks are the cheapest of a film, so that a view
costs most.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from cosim.app.driver import Options, build_simulation, execute, prepared, rerun_recorder
from cosim.config.loading import load_scenario
from cosim.recording.viewer import start_viewer


def main() -> None:
    """Print the ratio of both, pair by pair, and its median."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--scenario", default="ur5e_hexagon_arm")
    options = parser.parse_args()
    scenario = load_scenario(options.scenario, {"model.published": True})
    scenario = prepared(scenario, print, recording=True)
    viewer = start_viewer("page")

    def cpu_s(address: str | None) -> float:
        with TemporaryDirectory() as directory:
            make_recorder = partial(rerun_recorder, viewer=address)
            began = time.process_time()
            outcome = execute(
                scenario, build_simulation, Options(Path(directory, "run"), make_recorder), began
            )
            assert outcome.error is None, outcome.error
            return time.process_time() - began

    try:
        cpu_s(None)
        ratios = []
        for pair in range(options.pairs):
            order = (viewer.address, None) if pair % 2 else (None, viewer.address)
            found = {address: cpu_s(address) for address in order}
            ratios.append(found[viewer.address] / found[None])
            print(
                f"{found[None]:.2f} s, live {found[viewer.address]:.2f} s: {ratios[-1] - 1:+.1%}", flush=True
            )
    finally:
        viewer.stop()
    low, middle, high = np.percentile(ratios, [0, 50, 100]) - 1.0
    print(f"median of {len(ratios)} pairs {middle:+.1%}, from {low:+.1%} to {high:+.1%}")


if __name__ == "__main__":
    main()
