"""Where designs run makes no difference to the table; a sweep that is killed goes on; workers may die."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import cosim
from cosim.sweeps import engines, sweeping
from cosim.sweeps import engines as fan_out
from cosim.sweeps.designs import Row, Task
from cosim.sweeps.engines import Engine, Pool

STUDY = """
scenario = "three_unit_inflation"
set = { phase.start.increments = 1, phase.inflate.increments = 2 }
[grid]
phase.inflate.pressure_Pa = [8e3, 9e3, -1e9]
[samples]
count = 8
range = { soft_robot.film.thickness_m = [0.1e-3, 0.2e-3] }
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("study") / "study.toml"
    path.write_text(STUDY, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def wanted(study: Path) -> bytes:
    """Return the table as this process alone makes it."""
    with ThreadPoolExecutor(1) as executor:
        cosim.sweep(study, out=study.parent / "here", engine=executor)
    return (study.parent / "here" / "sweep.parquet").read_bytes()


def rows(directory: Path) -> list[dict[str, Any]]:
    lines = (directory / "rows.jsonl").read_text(encoding="utf-8").splitlines()
    return [json.loads(line) for line in lines if line.endswith("}")]


def command(study: Path, out: Path, workers: int) -> list[str]:
    words = ["sweep", str(study), "--out", str(out), "--workers", str(workers)]
    return [sys.executable, "-m", "cosim", *words]


def test_a_sweep_on_processes_is_killed_and_continues_to_the_same_table(
    study: Path, wanted: bytes, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    started = subprocess.Popen(command(study, out, 1), stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 300.0
    while not (out / "rows.jsonl").is_file() or len(rows(out)) < 3:
        assert started.poll() is None, "it has ended before it was killed"
        assert time.monotonic() < deadline
        time.sleep(0.002)
    started.kill()
    started.wait()
    first = rows(out)
    workers = {int(row["worker"].rpartition(":")[2]) for row in first}
    assert 3 <= len(first) < 16
    assert not (out / "sweep.parquet").exists()
    for worker in workers:  # they end with the process that started them
        while time.monotonic() < deadline and is_alive(worker):
            time.sleep(0.01)
        assert not is_alive(worker)
    subprocess.run(command(study, out, 2), check=True, stderr=subprocess.DEVNULL)
    assert (out / "sweep.parquet").read_bytes() == wanted
    # nothing is computed twice, and by two workers
    assert len(rows(out)) == len({row["design"] for row in rows(out)}) == 16
    assert len({row["worker"] for row in rows(out)[len(first) :]}) == 2


def is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{process}/stat")
    return not state.is_file() or state.read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"


def test_a_dask_cluster_makes_the_same_table(study: Path, wanted: bytes, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="needs the extra: pip install 'cosim[dask]'")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        outcome = cosim.sweep(study, out=tmp_path, engine=cluster.scheduler_address)
    assert outcome.computed == 16
    assert (tmp_path / "sweep.parquet").read_bytes() == wanted
    assert os.getpid() not in {int(row["worker"].rpartition(":")[2]) for row in rows(tmp_path)}


def test_a_cluster_that_does_not_answer_is_refused(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(engines, "_CONNECT_S", 0.2)
    with pytest.raises(cosim.InputError, match=r"no scheduler answers there .* start one: dask scheduler"):
        cosim.sweep(study, out=tmp_path, engine="tcp://127.0.0.1:1")


class Breaking(Executor):
    """Runs tasks at once; breaks, with all that follow, where one is called `deadly`."""

    def __init__(self) -> None:
        self.broken = False

    def submit(self, function: Any, /, *arguments: Any, **_given: Any) -> Future[Any]:
        if self.broken:
            raise BrokenExecutor
        future: Future[Any] = Future()
        if arguments[0].directory == "deadly":
            self.broken = True
            future.set_exception(BrokenExecutor())
        else:
            future.set_result(Row("completed", arguments[0].directory))
        return future


class BreakingEngine:
    """Makes executors that break; `pools` counts them."""

    def __init__(self, *, replaceable: bool) -> None:
        self.pools, self._replaceable = 0, replaceable

    @contextmanager
    def pool(self) -> Iterator[Pool]:
        self.pools += 1
        yield Pool(Breaking(), 3, self._replaceable)


NAMES = ("a", "b", "deadly", "c", "d", "e")


def unused(_task: Task) -> Row:
    raise AssertionError("the executor answers by itself")


def statuses(engine: Any) -> dict[str, str]:
    tasks = [engines.IdentifiedTask(name, Task(b"", directory=name)) for name in NAMES]
    found = list(fan_out.rows_of(engine, unused, tasks))
    assert len(found) == len(NAMES)
    return {name: row.status for name, row in found}


def test_a_design_that_kills_its_worker_is_lost_and_the_others_are_not() -> None:
    engine = BreakingEngine(replaceable=True)
    assert statuses(engine) == {name: "lost" if name == "deadly" else "completed" for name in NAMES}
    assert engine.pools > 2


def test_designs_left_when_a_users_executor_breaks_are_lost() -> None:
    engine = BreakingEngine(replaceable=False)
    found = statuses(engine)
    assert {found[name] for name in ("a", "b")} == {"completed"}
    assert {found[name] for name in ("deadly", "d", "e")} == {"lost"}
    assert engine.pools == 1


def test_lost_designs_are_run_again(tmp_path: Path, study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with ThreadPoolExecutor(1) as executor:
        with monkeypatch.context() as patch:
            patch.setattr(sweeping, "run_task", lost)
            outcome = cosim.sweep(study, out=tmp_path, engine=executor)
        assert outcome.statuses == {"lost": 16, "refused": 8}
        assert cosim.sweep(study, out=tmp_path, engine=executor).computed == 16


def lost(_task: Task) -> Row:
    raise OSError("the network is gone")


def test_processes_compute_with_one_thread_and_leave_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MKL_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    with Engine(workers=1).pool() as pool:
        there = pool.executor.submit(os.getenv, "MKL_NUM_THREADS").result()
        ignored = pool.executor.submit(signal.getsignal, signal.SIGINT).result()
    assert there == "1"
    assert ignored == signal.SIG_IGN
    assert (os.environ["MKL_NUM_THREADS"], os.environ.get("OPENBLAS_NUM_THREADS")) == ("7", None)
