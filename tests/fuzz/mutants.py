"""Do the tests notice small faults? python -m tests.fuzz.mutants [--count 40] [--seed 11] [--rooms ROOM ...].

Draws faults from the sources, each in a line of its own, and puts one at a time into a copy of the package.
The golden runs come first, then all tests; the first failure ends a trial. Prints what nobody noticed.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.fuzz.code_faults import Fault, faults

ROOT = Path(__file__).resolve().parents[2]
AT_MOST_S = 7200.0


def draw(seed: int, count: int, rooms: Sequence[str] = (".",)) -> list[Fault]:
    """Return faults drawn at random, every line of code with one being equally likely.

    Args:
        seed: of the draw.
        count: of faults.
        rooms: folders of the package.
    """
    by_line: dict[tuple[str, int], list[Fault]] = {}
    for path in sorted({path for room in rooms for path in (ROOT / "cosim" / room).rglob("*.py")}):
        for fault in faults(str(path.relative_to(ROOT)), path.read_bytes()):
            by_line.setdefault((fault.path, fault.line), []).append(fault)
    chance = random.Random(seed)
    return [chance.choice(by_line[line]) for line in chance.sample(sorted(by_line), count)]


def noticed_by(fault: Fault, folder: Path) -> str:
    """Return the first test that fails with a fault; empty for none."""
    shutil.copytree(ROOT / "cosim", folder / "cosim", ignore=shutil.ignore_patterns("__pycache__"))
    for path in ROOT.iterdir():
        if path.name not in ("cosim", ".git", ".venv"):
            (folder / path.name).symlink_to(path)
    (folder / fault.path).write_bytes(fault.applied((ROOT / fault.path).read_bytes()))
    kernels = folder.parent / "kernels"
    kernels.mkdir(mode=0o700, exist_ok=True)
    (folder / "cosim/__pycache__").mkdir()
    (folder / "cosim/__pycache__/kernels").symlink_to(kernels)
    given = os.environ | {"OMP_NUM_THREADS": "1"}
    for tests in ("tests/golden", "tests"):
        command = [sys.executable, "-m", "pytest", "-q", "-x", "--tb=no", "-p", "no:cacheprovider", tests]
        try:
            done = subprocess.run(
                command, cwd=folder, env=given, capture_output=True, text=True, timeout=AT_MOST_S
            )
        except subprocess.TimeoutExpired:
            return "time"
        if done.returncode:
            failed = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
            return failed[1] if failed else f"exit code {done.returncode}"
    return ""


def main() -> None:
    """Draw, try and report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--rooms", nargs="+", default=["."])
    options = parser.parse_args()
    found, drawn = 0, draw(options.seed, options.count, options.rooms)
    with TemporaryDirectory() as folder:
        for k, fault in enumerate(drawn):
            by = noticed_by(fault, Path(folder) / f"fault_{k}")
            found += bool(by)
            lines = fault.difference((ROOT / fault.path).read_bytes())
            where = f"{fault.path}:{fault.line} {fault.owner}, {fault.kind}"
            print("\n".join([f"{where}: {f'found by {by}' if by else 'NOT FOUND'}", *lines]), flush=True)
    print(f"{found} of {len(drawn)} found, seed {options.seed}")


if __name__ == "__main__":
    main()
