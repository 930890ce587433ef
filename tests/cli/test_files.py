"""`cosim check` and `cosim new`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cosim.base.resources import scenario_path, soft_robot_path
from cosim.cli.main import main


def test_fine_files_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    robot = str(soft_robot_path("hexagon_arm"))
    assert main(["check", "ur5e_hexagon_arm", robot]) == 0
    left = "only a run shows: whether the tip can follow phase 'lift', 'reach'"
    assert capsys.readouterr().out == f"ur5e_hexagon_arm: fine; {left}\n{robot}: fine\n"


def test_what_a_check_leaves_to_runs_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    text = scenario_path("light_hexagon_arm").read_text(encoding="utf-8")
    Path("mine.toml").write_text(f'fidelity = "section"\nplan.collision = "refuse"\n{text}')
    assert main(["check", "mine.toml"]) == 0
    assert capsys.readouterr().out == (
        "mine.toml: fine; only a run shows: whether the tip can follow phase 'lift'; whether the way is "
        "clear (plan.collision); whether the film has a section model (fidelity)\n"
    )


def test_each_fault_is_a_line_and_a_later_file_is_still_checked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong, broken = tmp_path / "wrong.toml", tmp_path / "broken.toml"
    text = scenario_path("ur5e_hexagon_arm").read_text(encoding="utf-8")
    wrong.write_text(text.replace("tick_s = 0.002", "tick_ms = 2").replace('"ur5e"', '"ur6e"'))
    broken.write_text("schema = ")
    assert main(["check", str(wrong), str(broken), "sealed_arm"]) == 2
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert lines[0].startswith(f"{wrong}: clock.tick_ms: unknown key")
    assert lines[1].startswith(f"{wrong}: robot: no arm 'ur6e'")
    assert lines[2].startswith(f"{broken}: is not TOML")
    assert lines[3] == "sealed_arm: fine"


def test_a_file_that_is_not_there_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "nothing.toml"]) == 2
    assert main(["upgrade", "nothing.toml"]) == 2
    assert "nothing.toml" in capsys.readouterr().err


def test_a_new_scenario_is_fine_and_names_its_schema(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "mine"]) == 0
    assert main(["new", "second"]) == 0
    files = {"cosim-scenario.schema.json", "mine.toml", "second.toml"}
    assert {path.name for path in tmp_path.iterdir()} == files
    first, *_ = Path("mine.toml").read_text(encoding="utf-8").splitlines()
    assert first == "#:schema ./cosim-scenario.schema.json"
    capsys.readouterr()
    assert main(["schema"]) == 0
    text = capsys.readouterr().out
    assert json.loads(Path("cosim-scenario.schema.json").read_text(encoding="utf-8")) == json.loads(text)
    assert main(["check", "mine.toml"]) == 0


def test_a_new_scenario_runs_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "mine"]) == 0
    assert main(["run", "mine.toml", "--set", "mode=quasistatic", "--out", "out", "--quiet"]) == 0
    assert json.loads(Path("out/summary.json").read_text(encoding="utf-8"))["status"] == "completed"


@pytest.mark.parametrize("name", ["../mine", "mine.toml", "", "a b", "-"])
def test_a_name_that_is_none_is_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", name]) == 2
    assert "give a letter" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("there", ["mine.toml", "cosim-scenario.schema.json"])
def test_nothing_is_overwritten(
    there: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(there).write_text("precious")
    assert main(["new", "mine"]) == 2
    assert "is not overwritten" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [there]
    assert Path(there).read_text() == "precious"
