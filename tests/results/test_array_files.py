"""Arrays of a run on disk: what is loaded is what was in memory, however often the run was interrupted."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from pyarrow import parquet

import cosim
from cosim.app import preparation
from cosim.errors import ConvergenceError
from cosim.results.result import RunResult
from cosim.results.run_columns import COLUMNS, FRAME_COLUMNS
from cosim.results.stored_stage import stage_of, stored_stage
from tests.cli.interrupted import Command, interrupt_at

REFERENCE = "ur5e_hexagon_arm"
SPECIMEN = {"phase.start.increments": 1, "phase.inflate.increments": 2}


def arrays_of(result: RunResult) -> dict[str, Any]:
    return {name: getattr(result, name) for name in (*COLUMNS, *FRAME_COLUMNS)}


def assert_same_arrays(found: RunResult, wanted: RunResult, *, but: tuple[str, ...] = ()) -> None:
    for name, array in arrays_of(wanted).items():
        other = getattr(found, name)
        assert (other.dtype, other.shape) == (array.dtype, array.shape), name
        assert name in but or other.tobytes() == np.ascontiguousarray(array).tobytes(), name


@pytest.fixture
def made_up(made_up_build: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(preparation, "build_simulation", made_up_build())


def test_a_loaded_run_is_the_one_in_memory(made_up: None, tmp_path: Path) -> None:
    result = cosim.run(REFERENCE, out=tmp_path / "a")
    loaded = cosim.load_run(tmp_path / "a")
    assert_same_arrays(loaded, result)
    assert loaded.summary == result.summary
    assert loaded.directory == result.directory
    assert repr(loaded) == repr(result)
    kept = [
        field.name for field in fields(type(result.stage)) if field.name not in ("shapes", "arm", "tip_paths")
    ]
    for name in kept:
        before, after = getattr(result.stage, name), getattr(loaded.stage, name)
        assert callable(before) or np.array_equal(np.asarray(after), np.asarray(before)), name
    with pytest.raises(cosim.InputError, match=r"cosim\.Simulation"):
        loaded.stage.membrane_stress(np.zeros((3, 3)))


def test_the_arrays_of_a_run_along_a_path_are_saved(made_up: None) -> None:
    stage = replace(cosim.run(REFERENCE).stage, tip_paths={1: object()})  # type: ignore[dict-item]
    stored = json.loads(json.dumps(stored_stage(stage)))
    assert stage_of(stored).phase_names == stage.phase_names
    assert not stage_of(stored).tip_paths


def test_a_specimen_without_joints_or_bodies_is_loaded_too(tmp_path: Path) -> None:
    result = cosim.run("three_unit_inflation", overrides=SPECIMEN, out=tmp_path / "a")
    loaded = cosim.load_run(tmp_path / "a")
    assert result.joint_position.shape == (len(result.tick), 0)
    assert_same_arrays(loaded, result)
    assert loaded.stage.modelled == result.stage.modelled


def test_a_run_that_failed_at_its_start_is_loaded_without_rows(
    made_up_build: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def at_tick(_tick: int) -> None:
        raise ConvergenceError("stalled", 1.0, 3)

    monkeypatch.setattr(preparation, "build_simulation", made_up_build(at_tick))
    with pytest.raises(ConvergenceError) as caught:
        cosim.run(REFERENCE, out=tmp_path / "a")
    loaded = cosim.load_run(tmp_path / "a")
    assert (loaded.status, len(loaded.tick)) == ("failed", 0)
    assert caught.value.result is not None
    assert_same_arrays(loaded, caught.value.result)


@pytest.mark.parametrize("times", [1, 2], ids=["between ticks", "in a tick"])
def test_parts_of_an_interrupted_run_make_the_whole(
    times: int, monkeypatch: pytest.MonkeyPatch, made_up_build: Callable[..., Any], tmp_path: Path
) -> None:
    whole = Command(monkeypatch, made_up_build, tmp_path / "whole")
    assert whole.start() == 0
    parts = Command(monkeypatch, made_up_build, tmp_path / "parts")
    assert parts.start(at_tick=interrupt_at(9, times=times)) == 130
    assert parts.resume("--checkpoint-every", "1e-9", at_tick=interrupt_at(18, times=times)) == 130
    assert parts.resume() == 0
    assert len(list(parts.directory.glob("arrays-*.parquet"))) > 3
    assert_same_arrays(cosim.load_run(parts.directory), cosim.load_run(whole.directory))


def test_a_new_run_takes_the_arrays_of_the_old_one_away(
    monkeypatch: pytest.MonkeyPatch, made_up_build: Callable[..., Any], tmp_path: Path
) -> None:
    command = Command(monkeypatch, made_up_build, tmp_path / "a")
    command.start("--checkpoint-every", "1e-9", at_tick=interrupt_at(9))
    assert command.start() == 0
    assert sorted(path.name for path in command.directory.glob("*.parquet")) == [
        "arrays.parquet", "frames.parquet",
    ]  # fmt: skip


def test_every_array_says_its_unit_and_meaning(made_up: None, tmp_path: Path) -> None:
    cosim.run(REFERENCE, out=tmp_path)
    schemas = [parquet.read_schema(tmp_path / f"{name}.parquet") for name in ("arrays", "frames")]
    texts = {
        field.name: {key: field.metadata[key.encode()].decode() for key in ("unit", "meaning")}
        | json.loads(field.metadata[b"cosim"])
        for schema in schemas
        for field in schema
    }
    assert texts.keys() == {*COLUMNS, *FRAME_COLUMNS}
    assert all(said["unit"] and len(said["meaning"]) > 5 for said in texts.values())
    units = {name: said["unit"] for name, said in texts.items()}
    # those at the end of a name agree with what is said
    assert (units["sag_m"], units["volume_m3"], units["power_error_W"]) == ("m", "m^3", "W")
    assert (units["joint_velocity"], units["flange_torque"], units["contacts"]) == ("rad/s", "N m", "1")
    assert texts["body_position"]["components"] == [f"{body}.{k}" for body in ("base", "tool") for k in "xyz"]
    # and other programs find them
    assert parquet.read_schema(tmp_path / "arrays.parquet").field("tip_position").metadata[b"unit"] == b"m"


def test_other_programs_read_the_columns(made_up: None, tmp_path: Path) -> None:
    result = cosim.run(REFERENCE, out=tmp_path)
    frame = pd.read_parquet(tmp_path / "arrays.parquet")
    assert frame["sag_m"].to_numpy().tobytes() == result.sag_m.tobytes()
    assert np.array_equal(np.stack(frame["tip_position"].tolist()), result.tip_position)


def test_a_run_of_the_version_before_is_refused_by_name(made_up: None, tmp_path: Path) -> None:
    cosim.run(REFERENCE, out=tmp_path)
    for path in tmp_path.glob("*.parquet"):
        path.unlink()
    version = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["cosim_version"]
    text = rf"has no arrays\.parquet.*cosim {version}.*run it again: cosim run"
    with pytest.raises(cosim.InputError, match=text):
        cosim.load_run(tmp_path)


def test_arrays_of_another_schema_are_refused_by_name(made_up: None, tmp_path: Path) -> None:
    cosim.run(REFERENCE, out=tmp_path)
    path = tmp_path / "arrays.parquet"
    table = parquet.read_table(path)
    header = json.loads(table.schema.metadata[b"cosim"]) | {"schema": 7, "cosim_version": "9.9"}
    parquet.write_table(table.replace_schema_metadata({"cosim": json.dumps(header)}), path)
    with pytest.raises(cosim.InputError, match=r"has schema 7, of cosim 9\.9; this cosim, .*, reads 1"):
        cosim.load_run(tmp_path)


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (lambda folder: (folder / "arrays.parquet").write_bytes(b"PAR1"), "arrays.parquet: cannot be read"),
        (lambda folder: (folder / "summary.json").unlink(), "has no run: summary.json is missing"),
        (lambda folder: (folder / "summary.json").write_text("[]"), "summary.json: is no summary"),
        (
            lambda folder: parquet.write_table(pa.table({"tick": [1]}), folder / "arrays.parquet"),
            "arrays.parquet: was not written by cosim",
        ),
    ],
    ids=["damaged", "no summary", "another summary", "somebody else's"],
)
def test_what_is_no_run_is_refused(
    spoil: Callable[[Path], object], text: str, made_up: None, tmp_path: Path
) -> None:
    cosim.run(REFERENCE, out=tmp_path)
    spoil(tmp_path)
    with pytest.raises(cosim.InputError, match=text):
        cosim.load_run(tmp_path)


def test_a_run_that_has_not_ended_is_refused_with_how_to_go_on(
    monkeypatch: pytest.MonkeyPatch, made_up_build: Callable[..., Any], tmp_path: Path
) -> None:
    def at_tick(tick: int) -> None:
        if tick == 15:
            raise SystemExit

    command = Command(monkeypatch, made_up_build, tmp_path / "a")
    with pytest.raises(SystemExit):
        command.start("--checkpoint-every", "1e-9", at_tick=at_tick)
    with pytest.raises(cosim.InputError, match="has not ended; resume it: cosim run --resume"):
        cosim.load_run(command.directory)
    assert command.resume() == 0
    assert cosim.load_run(command.directory).tick.tolist() == list(range(26))
