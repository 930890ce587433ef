"""Folders of runs and sweeps whose files are short, deep or of another kind are refused by name."""

from __future__ import annotations

import json
import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from pyarrow import parquet

import cosim
from cosim.cli.main import EXIT_INPUT, main
from cosim.results.arrow_files import read_header

SPECIMEN = {"phase.start.increments": 2, "phase.inflate.increments": 3}
STUDY = {
    "scenario": "three_unit_inflation",
    "set": {"phase.start.increments": 1, "phase.inflate.increments": 1},
    "grid": {"phase.inflate.pressure_Pa": [9e3]},
}
DEEP = "[" * 100_000 + "]" * 100_000


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "made"
    cosim.run("three_unit_inflation", overrides=SPECIMEN, out=folder)
    return folder


@pytest.fixture
def run(made: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made, tmp_path / "run")


def rewrite(path: Path, change: Any) -> None:
    """Change the table of a Parquet file; what it says of itself stays."""
    parquet.write_table(change(parquet.read_table(path)), path)


def twice(table: pa.Table) -> pa.Table:
    return pa.concat_tables([table, table.slice(len(table) - 1)])


@pytest.mark.parametrize("file", ["arrays.parquet", "frames.parquet"])
@pytest.mark.parametrize(
    "change",
    [lambda table: table.slice(0, 1), lambda table: table.slice(1), lambda table: table.slice(0, 0), twice],
    ids=["the first row", "without the first row", "no row", "a row twice"],
)
def test_files_of_too_few_or_many_rows_are_refused(run: Path, file: str, change: Any) -> None:
    wanted = len(parquet.read_table(run / file))
    rewrite(run / file, change)
    found = len(parquet.read_table(run / file))
    text = rf"{file}: has {found} rows; must have {wanted}, since .*; run it again: cosim run {run}/scenario"
    with pytest.raises(cosim.InputError, match=text):
        cosim.load_run(run)


def test_rows_of_other_ticks_are_refused(run: Path) -> None:
    table = parquet.read_table(run / "arrays.parquet")
    order = [0, *range(2, len(table)), 1]
    rewrite(run / "arrays.parquet", lambda table: table.take(order))
    with pytest.raises(cosim.InputError, match=r"arrays\.parquet: has rows of other ticks.*cosim run"):
        cosim.load_run(run)


def test_rounded_and_missing_numbers_are_refused(run: Path) -> None:
    def rounded(table: pa.Table) -> pa.Table:
        place = table.schema.get_field_index("sag_m")
        field = pa.field("sag_m", pa.float32(), metadata=table.schema.field(place).metadata)
        return table.set_column(place, field, table["sag_m"].cast(pa.float32()))

    rewrite(run / "arrays.parquet", rounded)
    with pytest.raises(cosim.InputError, match=r"arrays\.parquet: cannot be read: .*has type float"):
        cosim.load_run(run)


def test_a_changed_byte_of_an_array_is_noticed(run: Path) -> None:
    path = run / "arrays.parquet"
    assert read_header(path)["frames_per_s"] == 60.0
    data, group = path.read_bytes(), parquet.read_metadata(path).row_group(0)
    columns = {group.column(k).path_in_schema: group.column(k) for k in range(group.num_columns)}
    for name in ("sag_m", "tip_position.list.element"):
        end = columns[name].data_page_offset + columns[name].total_compressed_size
        for place in range(end - 24, end):
            path.write_bytes(data[:place] + bytes([data[place] ^ 16]) + data[place + 1 :])
            with pytest.raises(cosim.InputError, match=r"arrays\.parquet: cannot be read"):
                cosim.load_run(run)


def test_a_changed_word_of_what_a_file_says_of_itself_is_noticed(run: Path) -> None:
    path = run / "arrays.parquet"
    table = parquet.read_table(path)
    said = {**table.schema.metadata}
    said[b"cosim"] = said[b"cosim"].replace(b'"mode": "quasistatic"', b'"mode": "quasistatik"')
    assert said != table.schema.metadata
    parquet.write_table(table.replace_schema_metadata(said), path)
    with pytest.raises(cosim.InputError, match=r"arrays\.parquet: is damaged"):
        cosim.load_run(run)


def _without(*keys: str) -> Any:
    def change(summary: dict[str, Any]) -> None:
        for key in keys:
            del summary[key]

    return change


@pytest.mark.parametrize(
    "change",
    [
        _without("phases"), _without("ticks"),
        lambda summary: summary["phases"][0].pop("chambers"),
        lambda summary: summary.update(phases={"a": 1}),
        lambda summary: summary["phases"][-1].update(sag_m="long"),
        lambda summary: summary.update(ticks=[5]),
        lambda summary: summary.update(warnings=3),
        lambda summary: summary.update(status="fine"),
    ],
)  # fmt: skip
def test_a_summary_without_its_figures_is_refused_when_it_is_loaded(run: Path, change: Any) -> None:
    path = run / "summary.json"
    summary = json.loads(path.read_text(encoding="utf-8"))
    assert cosim.load_run(run)._repr_html_().count("<tr>") == 1 + len(summary["phases"])
    change(summary)
    path.write_text(json.dumps(summary), encoding="utf-8")
    with pytest.raises(cosim.InputError, match=r"summary\.json: is no complete summary.*run it again: cosim"):
        cosim.load_run(run)


def test_deep_json_is_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (run / "summary.json").write_text(DEEP, encoding="utf-8")
    with pytest.raises(cosim.InputError, match=r"summary\.json: cannot be read"):
        cosim.load_run(run)
    assert main(["export", str(run), "--csv"]) == EXIT_INPUT
    assert main(["run", "--resume", str(run)]) == EXIT_INPUT  # has no checkpoint
    assert "checkpoint" in capsys.readouterr().err


def test_rows_of_a_sweep_that_are_no_rows_are_computed_again(tmp_path: Path) -> None:
    with ThreadPoolExecutor(1) as engine:
        assert cosim.sweep(STUDY, out=tmp_path, engine=engine).computed == 1
        path = tmp_path / "rows.jsonl"
        row = json.loads(path.read_text(encoding="utf-8"))
        whole = cosim.open_sweep(tmp_path)
        for wrong in (
            {**row, "figures": [1]}, {**row, "status": None}, {**row, "files": {"a": 1}}, {**row, "more": 1},
            {**row, "wall_s": "long"}, {"design": row["design"]}, [], None,
        ):  # fmt: skip
            path.write_text(json.dumps(wrong) + "\n", encoding="utf-8")
            assert cosim.sweep(STUDY, out=tmp_path, engine=engine).computed == 1, wrong
            assert cosim.open_sweep(tmp_path).equals(whole), wrong
        path.write_text(DEEP + "\n" + json.dumps(row) + "\n", encoding="utf-8")
        assert cosim.sweep(STUDY, out=tmp_path, engine=engine).reused == 1
        path.write_bytes(json.dumps(row).encode().replace(b"completed", b"comple\xffed") + b"\n")
        assert cosim.sweep(STUDY, out=tmp_path, engine=engine).computed == 1


@pytest.mark.parametrize("words", [["run", "three_unit_inflation", "--out"], ["run", "--resume"], ["export"]])
def test_a_name_longer_than_any_is_named(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / ("x" * 300)
    assert main([*words, str(path), *(["--csv"] if words == ["export"] else [])]) == EXIT_INPUT
    told = capsys.readouterr().err
    assert str(path) in told
    if "--out" in words:
        assert "give a shorter one" in told
        with pytest.raises(cosim.InputError, match="give a shorter one"):
            cosim.run("three_unit_inflation", out=path)


def test_a_marker_leads_to_no_file_elsewhere(run: Path, tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.write_text("mine", encoding="utf-8")
    with (run / ".cosim").open("a", encoding="utf-8") as file:
        file.write(f"../precious\n{precious}\n")
    cosim.run("three_unit_inflation", overrides=SPECIMEN, out=run)
    assert precious.read_text(encoding="utf-8") == "mine"
    (run / ".cosim").write_bytes(os.urandom(64) + b"\xff")
    assert main(["run", "three_unit_inflation", "--out", str(run)]) == EXIT_INPUT
