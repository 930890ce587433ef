"""Forged checkpoints: a run goes on from files that were damaged or made up, each in a process of its own.

    python benchmarks/faults/forged_checkpoints.py [COUNT] [SEED]

Each file is the checkpoint of a short run with one thing changed: bits of the file or of an array, an array
of another size, kind or order, numbers that are not finite, parts missing, added or exchanged, other
versions, packed or torn archives. A process that crashes, a traceback, and a wait above a minute are faults;
that the run is refused in one line, fails by name, or goes on, are none. Prints what became of them.
"""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.faults.forgeries import forge

SHORT: dict[str, tuple[str, tuple[str, ...]]] = {
    "lumped": (
        "ur5e_hexagon_arm",
        ("clock.tick_s=0.01", "phase.hang.duration_s=0.05", "phase.hang.settle_s=0.0"),
    ),
    "touching": ("gripper_lifts_roll", ("phase.inflate.duration_s=0.02", "phase.inflate.settle_s=0.0")),
    "statics": ("three_unit_inflation", ("phase.1.increments=8",)),
    "section": (
        "ur5e_hexagon_arm",
        ("fidelity=section", "phase.hang.duration_s=0.05", "phase.hang.settle_s=0.0"),
    ),
}
"""Runs that are interrupted: scenario and changes."""

WORKER = """
import contextlib, os, signal, sys, traceback
import cosim.cli.running as running
from cosim.app.driver import build_simulation
from cosim.cli.main import main

class Stop:
    def __init__(self, inner): self.inner, self.stage = inner, inner.stage
    def __getattr__(self, name): return getattr(self.inner, name)
    def batches(self): return self.inner.batches(most=3)
running.build_simulation = lambda scenario, **_given: Stop(build_simulation(scenario))
go_on = lambda place: main(["run", "--resume", place, "--no-recording", "--quiet"])

# what is loaded and compiled here, no child has to
with contextlib.redirect_stdout(sys.stderr):
    assert go_on(sys.argv[1]) == 0
print("ready", flush=True)
for line in sys.stdin:
    child = os.fork()
    if child == 0:
        signal.alarm(60)
        report = open(line.strip() + "/said", "w")
        os.dup2(report.fileno(), 1); os.dup2(report.fileno(), 2)
        try:
            code = go_on(line.strip())
        except BaseException:
            traceback.print_exc(); code = 99
        report.flush(); os._exit(code)
    print(os.waitpid(child, 0)[1], flush=True)
"""


def interrupted_run(name: str, folder: Path) -> Path:
    """Return the directory of a run that was interrupted after a few ticks."""
    scenario, changes = SHORT[name]
    words = [word for change in changes for word in ("--set", change)]
    code = (
        "import sys\n"
        "from cosim.cli.screen import Interruption\n"
        "from cosim.cli.main import main\n"
        "from cosim.stepping import stepped_run\n"
        "stepped_run._SHOWN_S = 0.0  # each step is shown, and the reason asked for, by itself\n"
        "asked = []\n"
        "def reason(self):\n"
        "    asked.append(0)\n"
        "    return 'SIGINT' if len(asked) > 4 else None\n"
        "Interruption.reason = reason\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    out = folder / name
    command = [
        sys.executable,
        "-c",
        code,
        "run",
        scenario,
        "--out",
        str(out),
        "--no-recording",
        "--quiet",
        *words,
    ]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode != 130:
        raise RuntimeError(f"{name}: {done.stderr}")
    return out


def outcome_of(status: int, said: str) -> str:
    """Return in a word what became of a run: what begins with "FAULT" must not be."""
    if status & 0x7F:
        return f"FAULT {signal.Signals(status & 0x7F).name}"
    code = status >> 8
    if "Traceback" in said or code not in (0, 1, 2):
        return f"FAULT code {code}"
    return {0: "goes on", 1: "fails by name", 2: "refused"}[code]


def try_forgeries(run: Path, count: int, seed: int, folder: Path) -> list[tuple[str, str, str]]:
    """Return (forgery, outcome, what was said) of so many forged checkpoints of a run."""
    random = np.random.default_rng(seed)
    results = []
    sound = shutil.copytree(run, folder / f"{run.name}-sound")
    with subprocess.Popen(
        [sys.executable, "-c", WORKER, str(sound)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as worker:
        assert worker.stdin is not None
        assert worker.stdout is not None
        if worker.stdout.readline() != "ready\n":
            raise RuntimeError("the worker did not start")
        for number in range(count):
            place = folder / f"{run.name}-{number}"
            shutil.copytree(run, place)
            kind, data = forge(run / "checkpoint.npz", random)
            (place / "checkpoint.npz").write_bytes(data)
            worker.stdin.write(f"{place}\n")
            worker.stdin.flush()
            status = int(worker.stdout.readline())
            said = (place / "said").read_text(encoding="utf-8", errors="replace")
            results.append((kind, outcome_of(status, said), said))
            if not results[-1][1].startswith("FAULT"):
                shutil.rmtree(place)
    return results


def main(count: int = 500, seed: int = 1) -> int:
    """Try forged checkpoints of all runs; return 1 if there was a fault."""
    folder = Path(tempfile.mkdtemp(prefix="forged-"))
    results = []
    for number, name in enumerate(SHORT):
        run = interrupted_run(name, folder)
        results += try_forgeries(run, count // len(SHORT), seed + number, folder)
        print(f"{name}: {dict(Counter(outcome for _, outcome, _ in results))}", flush=True)
    faults = [(kind, outcome, said) for kind, outcome, said in results if outcome.startswith("FAULT")]
    for kind, outcome, said in faults:
        print(f"{kind}: {outcome}: {said.strip().splitlines()[-1:]}")
    print(f"{len(results)} forged checkpoints: {len(faults)} faults; those are in {folder}")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
