"""Sweeps of small designs: what two workers gain, what a design costs beside its run, engines, a kill.

200 designs of a specimen (5 of them cannot be built) run on one and on two processes in turn, on a Dask
cluster of two workers, and on two processes that are killed in the middle and started again. Tables must be
equal to the bit. On a shared machine wall time says little: the gain is told of the wall, and of CPU time, as
the work of all runs on one worker over that of the busier of two, and of the same two over the busier. What a
design costs beside its run is CPU time of all processes without that of the runs, as a slope over the number
of designs, and what a run costs in a worker more than alone.
"""

from __future__ import annotations

import json
import resource
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import cosim

PAIRS = 3
COUNT, REFUSED = 195, 5


class Took(NamedTuple):
    """What a sweep took.

    Args:
        wall_s: from its start to its end.
        cpu_s: of all its processes.
        runs_s: CPU time of the runs themselves.
        busiest_s: CPU time of the runs of the busiest worker.
    """

    wall_s: float
    cpu_s: float
    runs_s: float
    busiest_s: float


def grid(path: Path, count: int, refused: int) -> Path:
    """Write a study of pressures, the last ones below vacuum; return its path."""
    pressures = [5e3 + 25.0 * k for k in range(count)] + [-2e5 - k for k in range(refused)]
    text = (
        'scenario = "three_unit_inflation"\n'
        "set = { phase.start.increments = 10, phase.inflate.increments = 75 }\n"
        f"[grid]\nphase.inflate.pressure_Pa = {pressures}\n"
    )
    path.write_text(text, encoding="utf-8")
    return path


def rows(out: Path) -> list[dict[str, Any]]:
    """Return the rows of a sweep's journal."""
    lines = (out / "rows.jsonl").read_text(encoding="utf-8").splitlines()
    return [json.loads(line) for line in lines if line.endswith("}")]


def command(path: Path, out: Path, *words: str) -> list[str]:
    """Return the command of a sweep."""
    return [sys.executable, "-m", "cosim", "sweep", str(path), "--out", str(out), "--quiet", *words]


def took(path: Path, out: Path, *words: str) -> Took:
    """Run a sweep in processes of its own and return what it took."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command(path, out, *words), check=True)
    after, wall_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - began
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    by_worker: Counter[str] = Counter()
    for row in rows(out):
        by_worker[row["worker"]] += row["cpu_s"]
    return Took(wall_s, cpu_s, by_worker.total(), max(by_worker.values()))


def table(out: Path) -> bytes:
    """Return the table of a sweep as it is on disk."""
    return (out / "sweep.parquet").read_bytes()


def gain(folder: Path) -> None:
    """Print what two workers gain over one, in pairs taken in turn."""
    path = grid(folder / "study.toml", COUNT, REFUSED)
    walls, works, shares, tables = [], [], [], set()
    for pair in range(PAIRS):
        one, two = (took(path, folder / f"{n}-{pair}", "--workers", str(n)) for n in (1, 2))
        tables |= {table(folder / f"{n}-{pair}") for n in (1, 2)}
        walls.append(one.wall_s / two.wall_s)
        works.append(one.busiest_s / two.busiest_s)
        shares.append(two.runs_s / two.busiest_s)
        for name, found in (("one worker", one), ("two workers", two)):
            print(
                f"  {name:<12} {found.wall_s:6.1f} s wall, {found.cpu_s:6.1f} s CPU, "
                f"{found.runs_s:6.1f} s of runs, busiest worker {found.busiest_s:6.1f} s"
            )
    print(
        f"two workers over one: wall {median(walls):.2f}, CPU of the busier one {median(works):.2f}, "
        f"the same runs over the busier one {median(shares):.2f}"
    )
    print(f"tables of {2 * PAIRS} sweeps: {len(tables)} different")


def beside(folder: Path) -> None:
    """Print what a design costs beside its run."""
    few, many = 20, 120
    other = []
    for count in (few, many):
        found = took(grid(folder / f"{count}.toml", count, 0), folder / f"count-{count}", "--workers", "1")
        other.append(found.cpu_s - found.runs_s)
        own_s = found.runs_s / count
    slope_s = (other[1] - other[0]) / (many - few)
    set_ = {"phase.start.increments": 10, "phase.inflate.increments": 75}
    alone: list[float] = []
    for k in range(many):
        began = time.process_time()
        cosim.run("three_unit_inflation", overrides={**set_, "phase.inflate.pressure_Pa": 5e3 + 25.0 * k})
        alone.append(time.process_time() - began)
    alone_s, once_s = sum(alone[1:]) / (many - 1), other[0] - few * slope_s
    print(f"a run: {1e3 * own_s:.0f} ms in a worker, {1e3 * alone_s:.0f} ms by cosim.run alone")
    print(f"beside it, in all processes: {1e3 * slope_s:.1f} ms a design, and {once_s:.1f} s once")


def cluster(folder: Path) -> None:
    """Print whether a Dask cluster of two workers makes the same table."""
    from distributed import LocalCluster

    path, out = folder / "study.toml", folder / "dask"
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1") as made:
        began = time.perf_counter()
        outcome = cosim.sweep(path, out=out, engine=made.scheduler_address)
        wall_s = time.perf_counter() - began
    same = table(out) == table(folder / "1-0")
    print(
        f"Dask, two workers: {outcome.computed} computed in {wall_s:.1f} s; the same table to the bit: {same}"
    )


def killed(folder: Path) -> None:
    """Print whether a sweep killed in the middle goes on to the same table, and how much it ran twice."""
    path, out = folder / "study.toml", folder / "killed"
    started = subprocess.Popen(command(path, out, "--workers", "2"))
    while not (out / "rows.jsonl").is_file() or len(rows(out)) < COUNT // 2:
        time.sleep(0.01)
    started.send_signal(signal.SIGKILL)
    started.wait()
    first = len(rows(out))
    subprocess.run(command(path, out, "--workers", "2"), check=True)
    names = Counter(row["design"] for row in rows(out))
    twice = sum(count > 1 for count in names.values())
    print(f"killed after {first} of {COUNT}, {len(rows(out)) - first} computed after it, {twice} twice; "
          f"the same table to the bit: {table(out) == table(folder / '1-0')}")  # fmt: skip


def refused(folder: Path) -> None:
    """Print what became of the designs that cannot be built."""
    frame = cosim.open_sweep(folder / "1-0")
    shown = frame[frame["status"] == "refused"]
    print(
        f"{len(frame)} rows: {dict(frame['status'].value_counts())}; first reason: {shown['reason'].iloc[0]}"
    )


if __name__ == "__main__":
    with TemporaryDirectory() as made:
        place = Path(made)
        gain(place)
        refused(place)
        beside(place)
        cluster(place)
        killed(place)
