"""`cosim.sweep` on an executor of one's own: rows, refusals, what is run again and what is not."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyarrow import parquet

import cosim
from cosim.cli.main import main
from cosim.cli.sweep_line import sweep_line
from cosim.config import studies
from cosim.sweeps import worker
from cosim.sweeps.figure_names import check_figures
from cosim.sweeps.study_run import SweepProgress

SET = {"phase.start.increments": 1, "phase.inflate.increments": 2}
PRESSURES = [8e3, 9e3, 1e4]
STUDY: dict[str, Any] = {
    "scenario": "three_unit_inflation",
    "set": SET,
    "grid": {"phase.inflate.pressure_Pa": PRESSURES},
}


@pytest.fixture
def executor() -> Iterator[Executor]:
    with ThreadPoolExecutor(2) as made:
        yield made


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return what notes every design that is run."""
    noted: list[Any] = []
    run = worker._run

    def noting(scenario: Any, task: Any) -> Any:
        noted.append(task)
        return run(scenario, task)

    monkeypatch.setattr(worker, "_run", noting)
    return noted


def table_bytes(directory: Path) -> bytes:
    return (directory / "sweep.parquet").read_bytes()


def test_a_row_is_what_the_run_alone_returns(executor: Executor, tmp_path: Path) -> None:
    outcome = cosim.sweep(STUDY, out=tmp_path, engine=executor)
    assert (outcome.count, outcome.computed, outcome.reused) == (3, 3, 0)
    assert dict(outcome.statuses) == {"completed": 3}
    frame = cosim.open_sweep(tmp_path)
    assert frame["phase.inflate.pressure_Pa"].tolist() == PRESSURES
    alone = cosim.run(STUDY["scenario"], overrides={**SET, "phase.inflate.pressure_Pa": 9e3})
    assert frame["volume_m3"][1] == alone.volume_m3[-1]
    assert (
        frame[[f"tip_position_m.{axis}" for axis in "xyz"]].to_numpy()[1].tolist()
        == alone.tip_position[-1].tolist()
    )
    assert frame["newton_iterations"][1] == alone.summary["newton_iterations"]
    # what depends on the clock is not in the table
    assert not {"wall_s", "startup_s", "command_s", "compiling_s", "real_time_factor"} & set(frame.columns)


def test_every_column_has_its_unit(executor: Executor, tmp_path: Path) -> None:
    cosim.sweep(STUDY, out=tmp_path, engine=executor)
    units = cosim.open_sweep(tmp_path).attrs["units"]
    shown = {name: units[name] for name in ("phase.inflate.pressure_Pa", "volume_m3", "tip_position_m.z")}
    assert shown == {"phase.inflate.pressure_Pa": "Pa", "volume_m3": "m^3", "tip_position_m.z": "m"}
    assert units["flange_wrench.torque_Nm.x"] == "N m"
    schema = parquet.read_schema(tmp_path / "sweep.parquet")
    assert all(field.metadata[b"unit"] and field.metadata[b"meaning"] for field in schema)


def test_what_cannot_be_built_or_solved_is_a_row_with_its_reason(executor: Executor, tmp_path: Path) -> None:
    designs = [
        {"phase.inflate.pressure_Pa": -1e9},  # below vacuum: the file format refuses it
        {"soft_robot": "nobody"},
        {"phase.inflate.pressure_Pa": 9e3},
        {"soft_robot.film.poisson": 0.7},
        {"phase.inflate.pressure_Pa": 9e6, "solver.search_iterations_max": 1},
    ]
    seen: list[SweepProgress] = []
    study = {**{key: STUDY[key] for key in ("scenario", "set")}, "design": designs}
    outcome = cosim.sweep(study, out=tmp_path, engine=executor, tell=seen.append)
    frame = cosim.open_sweep(tmp_path)
    assert frame["status"].tolist() == ["refused", "refused", "completed", "refused", "failed"]
    reasons = frame["reason"].tolist()
    assert reasons[0].startswith("ScenarioError: phase.inflate.pressure_Pa: -1e+09 is out of bounds")
    assert "no soft robot 'nobody'" in reasons[1]
    assert "soft_robot.film.poisson" in reasons[3]
    assert reasons[4].startswith("ConvergenceError: ")
    assert sum(outcome.reasons.values()) == 4
    assert (seen[-1].done, seen[-1].count, dict(seen[-1].statuses)) == (5, 5, dict(outcome.statuses))
    # a failed run has the figures up to where it failed
    assert np.isfinite(frame["ticks"][4])


def test_what_is_known_is_not_run_again(executor: Executor, runs: list[Any], tmp_path: Path) -> None:
    cosim.sweep(STUDY, out=tmp_path, engine=executor)
    before = table_bytes(tmp_path)
    again = cosim.sweep(STUDY, out=tmp_path, engine=executor)
    assert (again.computed, again.reused, len(runs)) == (0, 3, 3)
    assert table_bytes(tmp_path) == before
    wider = {**STUDY, "grid": {"phase.inflate.pressure_Pa": [7e3, *PRESSURES]}}
    wider_outcome = cosim.sweep(wider, out=tmp_path, engine=executor)
    assert (wider_outcome.computed, wider_outcome.reused, len(runs)) == (1, 3, 4)


def test_designs_of_the_same_contents_are_run_once(
    executor: Executor, runs: list[Any], tmp_path: Path
) -> None:
    study = {**STUDY, "grid": {"phase.inflate.pressure_Pa": [9e3, 9000, 9e3]}}
    outcome = cosim.sweep(study, out=tmp_path, engine=executor)
    assert (outcome.computed, outcome.count, len(runs)) == (1, 3, 1)
    assert len(set(cosim.open_sweep(tmp_path)["volume_m3"])) == 1


def test_other_code_is_another_content(
    executor: Executor, runs: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cosim.sweep(STUDY, out=tmp_path, engine=executor)
    monkeypatch.setattr("cosim.sweeps.study_run.code_identity", lambda: {"source": "other"})
    assert cosim.sweep(STUDY, out=tmp_path, engine=executor).computed == 3
    assert len(runs) == 6


def test_a_killed_sweep_continues_from_its_journal(
    executor: Executor, runs: list[Any], tmp_path: Path
) -> None:
    cosim.sweep(STUDY, out=tmp_path / "whole", engine=executor)
    cosim.sweep(STUDY, out=tmp_path / "killed", engine=executor)
    path = tmp_path / "killed" / "rows.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines()
    # killed in the middle of writing the second row
    path.write_text(lines[0] + "\n" + lines[1][: len(lines[1]) // 2], encoding="utf-8")
    (tmp_path / "killed" / "sweep.parquet").unlink()
    runs.clear()
    outcome = cosim.sweep(STUDY, out=tmp_path / "killed", engine=executor)
    assert (outcome.computed, outcome.reused, len(runs)) == (2, 1, 2)
    assert table_bytes(tmp_path / "killed") == table_bytes(tmp_path / "whole")


def test_figures_are_chosen_by_name(executor: Executor, tmp_path: Path) -> None:
    study = {**STUDY, "figures": ["phases.start.volume_m3", "tip_position_m"]}
    cosim.sweep(study, out=tmp_path, engine=executor)
    columns = list(cosim.open_sweep(tmp_path).columns)
    assert columns == [
        "design", "phase.inflate.pressure_Pa", "status", "reason", "phases.start.volume_m3",
        "tip_position_m.x", "tip_position_m.y", "tip_position_m.z", "identity",
    ]  # fmt: skip
    with pytest.raises(cosim.InputError, match="no design has 'tip'; there are"):
        cosim.sweep({**STUDY, "figures": ["tip"]}, out=tmp_path, engine=executor)


def test_a_figure_that_no_run_has_is_refused_before_anything_runs(
    runs: list[Any], executor: Executor, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = ["max_contact_force", "phases.inflat.sag_m", "tip_error_m"]  # the last phase has no target
    with pytest.raises(cosim.InputError, match="no design has 'max_contact_force'"):
        cosim.sweep({**STUDY, "figures": names}, out=tmp_path / "out", engine=executor)
    assert not runs
    study = tmp_path / "study.toml"
    grid = "[grid]\nphase.inflate.pressure_Pa = [8e3, 9e3]\n"
    study.write_text(f"scenario = 'three_unit_inflation'\nfigures = {names}\n{grid}", "utf-8")
    assert main(["check", str(study)]) == 2
    told = capsys.readouterr().out.splitlines()
    assert [line.split("'")[1] for line in told] == names
    assert told[0].endswith("did you mean 'max_contact_force_N'?")
    assert told[1].endswith("did you mean 'phases.inflate.sag_m'?")
    study.write_text(f"scenario = 'three_unit_inflation'\nfigures = ['sag_m']\n{grid}", "utf-8")
    assert main(["check", str(study)]) == 0


def test_all_figures_of_a_run_are_known_before_it(executor: Executor, tmp_path: Path) -> None:
    cosim.sweep(STUDY, out=tmp_path, engine=executor)
    frame = cosim.open_sweep(tmp_path)
    there = [name for name in frame.columns if name not in {"design", "status", "reason", "identity"}]
    figures = [name for name in there if name not in STUDY["grid"]]
    figures += [f"phases.{phase}" for phase in ("start", "inflate")]
    check_figures(studies.load_study({**STUDY, "figures": figures}))


def test_a_custom_measure_adds_columns(executor: Executor, runs: list[Any], tmp_path: Path) -> None:
    file = tmp_path / "own.py"
    text = "def stretch(result):\n    return {{'length_m': {} * result.tip_position[-1, 2]}}\n"
    file.write_text(text.format("1.0"), encoding="utf-8")
    study = {**STUDY, "measure": f"{file}:stretch"}
    cosim.sweep(study, out=tmp_path / "a", engine=executor)
    frame = cosim.open_sweep(tmp_path / "a")
    assert frame["length_m"].tolist() == frame["tip_position_m.z"].tolist()
    assert frame.attrs["units"]["length_m"] == "m"
    with pytest.raises(cosim.InputError, match="has no function 'width'"):
        cosim.sweep({**STUDY, "measure": f"{file}:width"}, out=tmp_path / "b", engine=executor)


def test_a_measure_that_fails_is_the_reason_of_its_row(executor: Executor, tmp_path: Path) -> None:
    def wrong(_result: Any) -> Any:
        return {"length_m": "long"}

    outcome = cosim.sweep(STUDY, out=tmp_path, engine=executor, measure=wrong)
    (reason,) = outcome.reasons
    assert "returned for length_m a str; return a number" in reason


def test_a_measure_that_cannot_travel_is_refused_before_anything_runs(tmp_path: Path) -> None:
    with pytest.raises(cosim.InputError, match="cannot be sent to other processes: define it in a module"):
        cosim.sweep(STUDY, out=tmp_path / "a", workers=1, measure=lambda result: {"rows": len(result.tick)})
    assert not (tmp_path / "a").exists()


def test_runs_are_saved_on_request(executor: Executor, tmp_path: Path) -> None:
    study = {**STUDY, "grid": {"phase.inflate.pressure_Pa": [9e3]}, "keep_runs": True}
    cosim.sweep(study, out=tmp_path, engine=executor)
    (row,) = cosim.open_sweep(tmp_path).to_dict("records")
    assert cosim.load_run(tmp_path / row["identity"]).volume_m3[-1] == row["volume_m3"]


def test_columns_are_drawn_with_their_units(executor: Executor, tmp_path: Path) -> None:
    cosim.sweep(STUDY, out=tmp_path, engine=executor)
    key = "phase.inflate.pressure_Pa"
    figure = cosim.plot_sweep(tmp_path, key, "volume_m3", "sag_m", colour="newton_iterations")
    axes = figure.axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == (f"{key} [Pa]", "volume_m3 [m^3]")
    points = axes.collections[0].get_offsets()
    assert np.array_equal(points[:, 0], PRESSURES)
    with pytest.raises(cosim.InputError, match="no column of numbers 'reason'; there are design"):
        cosim.plot_sweep(tmp_path, key, "reason")


def test_the_command_says_what_came_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "study.toml"
    path.write_text(
        "scenario = 'three_unit_inflation'\n[grid]\nphase.inflate.pressure_Pa = [-1e9, -2e9]\n", "utf-8"
    )
    # nothing can be built: no process is needed to say so
    assert main(["sweep", str(path), "--out", str(tmp_path / "out")]) == 1
    shown = capsys.readouterr().err.splitlines()
    assert shown[0] == "2 of 2 designs: 2 refused"
    assert shown[1] == "2 designs: 2 refused; 0 computed, 0 known before"
    assert shown[2].startswith("1 times: ScenarioError: phase.inflate.pressure_Pa: -")
    assert shown[-1] == f"table: {tmp_path / 'out' / 'sweep.parquet'}"
    assert cosim.open_sweep(tmp_path / "out")["status"].tolist() == ["refused", "refused"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--engine", "ray"], "--engine ray: give 'processes', or the address of a Dask scheduler"),
        (["--workers", "0"], "--workers 0: must be at least 1"),
        (
            ["--engine", "tcp://127.0.0.1:1", "--workers", "2"],
            "--workers 2: counts the processes of this machine",
        ),
    ],
)
def test_engines_that_are_none_are_refused(
    words: list[str], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "study.toml"
    path.write_text("scenario = 'three_unit_inflation'\n[grid]\nmode = ['dynamic']\n", "utf-8")
    assert main(["sweep", str(path), "--out", str(tmp_path / "out"), *words]) == 2
    assert text in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_study_can_be_checked_without_running_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fine, wrong = tmp_path / "fine.toml", tmp_path / "wrong.toml"
    fine.write_text("scenario = 'three_unit_inflation'\n[grid]\nmode = ['dynamic']\n", "utf-8")
    wrong.write_text("scenario = 'three_unit_inflation'\n[grid]\nmode = 'dynamic'\n", "utf-8")
    assert main(["check", str(fine)]) == 0
    assert main(["check", str(wrong)]) == 2
    assert capsys.readouterr().out.splitlines() == [
        f"{fine}: fine", f"{wrong}: grid.mode: is 'dynamic'; give a list of values",
    ]  # fmt: skip


def test_what_is_no_sweep_is_refused(executor: Executor, tmp_path: Path) -> None:
    with pytest.raises(cosim.InputError, match=r"has no sweep\.parquet; make one: cosim sweep"):
        cosim.open_sweep(tmp_path)
    (tmp_path / "mine.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(cosim.InputError, match="has files that are not known to be results"):
        cosim.sweep(STUDY, out=tmp_path, engine=executor)
    shutil.rmtree(tmp_path)


def test_the_line_shows_the_time_left_at_the_present_rate() -> None:
    line = sweep_line(SweepProgress(200, 60, 21, {"refused": 5, "completed": 55}, 40.0))
    assert line == "60 of 200 designs: 55 completed, 5 refused, 4:40 left"
    assert "left" not in sweep_line(SweepProgress(200, 1, 1, {"completed": 1}, 0.0))


def test_the_journal_says_who_computed_what_and_for_how_long(executor: Executor, tmp_path: Path) -> None:
    cosim.sweep(STUDY, out=tmp_path, engine=executor)
    text = (tmp_path / "rows.jsonl").read_text(encoding="utf-8")
    rows = [json.loads(line) for line in text.splitlines() if line]
    assert len(rows) == len({row["design"] for row in rows}) == 3
    assert all(row["wall_s"] > 0.0 and row["cpu_s"] > 0.0 and row["worker"] for row in rows)
