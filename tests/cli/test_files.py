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
        "mine.toml: fine; only a run shows: whether the tip can follow phase 'lift'; whether the planned "
        "motion is free of collisions (plan.collision); whether the film has a section model (fidelity)\n"
    )


def test_each_fault_is_a_line_and_a_later_file_is_still_checked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong, broken = tmp_path / "wrong.toml", tmp_path / "broken.toml"
    text = scenario_path("ur5e_hexagon_arm").read_text(encoding="utf-8")
    wrong.write_text(
        text.replace("tick_s = 0.01 ", "tick_ms = 2 ").replace("schema = 2", "schema = 2\narm_base = 1")
    )
    broken.write_text("schema = ")
    assert main(["check", str(wrong), str(broken), "sealed_arm"]) == 2
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert lines[0].startswith(f"{wrong}: arm_base: expected a table")
    assert lines[1].startswith(f"{wrong}: clock.tick_ms: unknown key")
    assert lines[2].startswith(f"{broken}: is not TOML")
    assert lines[3] == "sealed_arm: fine"


BENCH = """
scenario = "bending_angle"
[[parameter]]
key = "soft_robot.film.young_modulus_Pa"
low = 0.5e9
high = 4e9
[[series]]
name = "extension"
file = "inflated.csv"
quantity = "length_m"
measured = "length_mm"
loads.pressure_Pa = "pressure_kPa"
noise = 0.05
"""
DESIGN = """
scenario = "bending_angle"
[[parameter]]
key = "pull"
low = 0.05
high = 3.0
start = 0.5
[[case]]
name = "bent"
loads = { pressure_Pa = 10e3, "cable_tension_N.corner_0" = "pull" }
[goal]
quantity = "bending_angle_rad"
"""


def test_files_of_identify_and_design_are_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("inflated.csv").write_text("pressure_kPa,length_mm\n2,17.4\n4,21.4\n")
    Path("bench.toml").write_text(BENCH)
    Path("design.toml").write_text(DESIGN)
    assert main(["check", "bench.toml", "design.toml"]) == 0
    assert capsys.readouterr().out == (
        "bench.toml: fine; which values the curves determine: cosim identify bench.toml --check\n"
        "design.toml: fine\n"
    )
    Path("bench.toml").write_text(BENCH.replace('length_m"', 'lenght_m"'))
    Path("design.toml").write_text(DESIGN.replace("start = 0.5", ""))
    assert main(["check", "bench.toml", "design.toml"]) == 2
    bench, design = capsys.readouterr().out.splitlines()
    assert bench.startswith("bench.toml: ")
    assert "lenght_m" in bench
    assert design == "design.toml: pull: needs a start, as no file has a value of it"


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


@pytest.mark.parametrize("name", ["../mine", "mine.toml", "", "a b", "-", 65 * "a"])
def test_a_name_that_is_none_is_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", name]) == 2
    assert "give a letter followed by letters, digits, '_' or '-', 64 characters" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("there", ["mine.toml", "cosim-scenario.schema.json"])
def test_nothing_is_overwritten(
    there: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(there).write_bytes("kostbar: größer".encode("latin-1"))
    assert main(["new", "mine"]) == 2
    assert "is not overwritten" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [there]
    assert Path(there).read_bytes() == "kostbar: größer".encode("latin-1")
