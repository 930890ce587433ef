"""What a study varies: grids, lists, samples; and what is refused before anything runs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from cosim.cli.main import main
from cosim.config.studies import designs_of, load_study, varied_keys
from cosim.errors import InputError, ScenarioError

SCENARIO = "three_unit_inflation"


def study(text: str, folder: Path) -> Any:
    path = folder / "study.toml"
    path.write_text(f'scenario = "{SCENARIO}"\n{text}', encoding="utf-8")
    return load_study(path)


def test_a_grid_has_every_combination_the_last_key_fastest(tmp_path: Path) -> None:
    table = study(
        "[grid]\nmode = ['dynamic', 'quasistatic']\nphase.inflate.pressure_Pa = [1e3, 2e3]\n", tmp_path
    )
    assert varied_keys(table) == ["mode", "phase.inflate.pressure_Pa"]
    assert [tuple(design.values()) for design in designs_of(table)] == [
        ("dynamic", 1e3), ("dynamic", 2e3), ("quasistatic", 1e3), ("quasistatic", 2e3),
    ]  # fmt: skip


def test_lists_grids_and_samples_combine(tmp_path: Path) -> None:
    table = study(
        "[[design]]\nphase.start.pressure_Pa = 1.0\n[[design]]\nmode = 'dynamic'\n"
        "[grid]\nfidelity = ['lumped', 'rigid']\n"
        "[samples]\ncount = 3\nrange = { soft_robot.film.thickness_m = [1e-4, 2e-4] }\n",
        tmp_path,
    )
    designs = designs_of(table)
    assert len(designs) == 2 * 2 * 3
    assert varied_keys(table) == [
        "phase.start.pressure_Pa", "mode", "fidelity", "soft_robot.film.thickness_m",
    ]  # fmt: skip
    assert [set(design) - {"fidelity", "soft_robot.film.thickness_m"} for design in designs[::6]] == [
        {"phase.start.pressure_Pa"}, {"mode"},
    ]  # fmt: skip
    # every combination sees the same samples
    assert designs[0]["soft_robot.film.thickness_m"] == designs[3]["soft_robot.film.thickness_m"]


def test_values_that_are_lists_or_tables_stay_complete(tmp_path: Path) -> None:
    table = study(
        "[grid]\nphase.lift.cable_tension_N = [[0.0, 1.0], [1.0, 0.0]]\n"
        "soft_robot.stiffener = [{ kind = 'none' }, { kind = 'rigid' }]\n",
        tmp_path,
    )
    assert designs_of(table)[1] == {
        "phase.lift.cable_tension_N": [0.0, 1.0], "soft_robot.stiffener": {"kind": "rigid"},
    }  # fmt: skip


@pytest.mark.parametrize("method", ["latin_hypercube", "sobol", "halton"])
def test_samples_fill_their_ranges_and_follow_from_the_seed(method: str, tmp_path: Path) -> None:
    text = (
        f"[samples]\nmethod = '{method}'\ncount = 64\nseed = {{}}\n[samples.range]\na.b_m = [1, 3]\n"
        "c = {{ low = 1e-3, high = 10.0, scale = 'log' }}\nd = {{ low = 2, high = 5, integer = true }}\n"
    )
    designs = designs_of(study(text.format(7), tmp_path))
    assert designs == designs_of(study(text.format(7), tmp_path))
    assert designs != designs_of(study(text.format(8), tmp_path))
    # stratified or of low discrepancy: every sixteenth of a range has samples, on the scale of the range
    for values in (
        [(d["a.b_m"] - 1.0) / 2.0 for d in designs],
        [math.log10(d["c"] / 1e-3) / 4.0 for d in designs],
    ):
        assert {min(int(16.0 * value), 15) for value in values} == set(range(16))
    whole = [design["d"] for design in designs]
    assert {type(value) for value in whole} == {int}
    assert {value: whole.count(value) for value in set(whole)}.keys() == {2, 3, 4, 5}
    assert all(12 <= whole.count(value) <= 20 for value in (2, 3, 4, 5))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "nothing is varied"),
        ("[grid]\nmode = 'dynamic'\n", r"grid\.mode: is 'dynamic'; give a list of values"),
        ("[grid]\nmode = []\n", r"grid\.mode: is \[\]; give a list of values"),
        ("[gird]\nmode = ['dynamic']\n", "gird: unknown key; did you mean grid"),
        ("set = { mode = 'dynamic' }\n[grid]\nmode = ['dynamic']\n", r"grid\.mode: is in set as well"),
        (
            "[samples]\ncount = 2\nrange = { a = [2.0, 1.0] }\n",
            r"samples\.range\.a\.high: is 1; must be above low, 2",
        ),
        (
            "[samples]\ncount = 2\nrange = { a = [1.0] }\n",
            r"samples\.range\.a: is \[1\.0\]; give \[low, high\]",
        ),
        ("[samples]\ncount = 2\nrange = { a = 1.0 }\n", r"samples\.range\.a: is 1\.0; give \[low, high\]"),
        (
            "[samples]\ncount = 2\nrange = { a = { low = 0.0, high = 1.0, scale = 'log' } }\n",
            r"samples\.range\.a\.low: is 0; must be above 0 with scale = 'log'",
        ),
        (
            "[samples]\ncount = 2\nrange = { a = { low = 0.5, high = 3.0, integer = true } }\n",
            r"samples\.range\.a: ends at 0\.5 and 3; integer = true needs whole numbers",
        ),
        ("[samples]\ncount = 0\nrange = { a = [0.0, 1.0] }\n", r"samples\.count"),
    ],
)
def test_wrong_studies_are_refused_by_key(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=message):
        study(text, tmp_path)


def test_a_study_that_is_not_there_or_too_large_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no study '.*none\.toml'; give the path of a \.toml file"):
        load_study(tmp_path / "none.toml")
    values = list(range(200))
    table = load_study({"scenario": SCENARIO, "grid": {"a": values, "b": values, "c": values}})
    with pytest.raises(InputError, match="has 8000000 designs; at most 1000000"):
        designs_of(table)


def checked(text: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """Return what `cosim check` says of a study, without the file's name."""
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    code = main(["check", str(path)])
    lines = [line.removeprefix(f"{path}: ") for line in capsys.readouterr().out.splitlines()]
    assert code == (0 if lines == ["fine"] else 2)
    return lines


def test_check_loads_and_builds_every_design(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    grid = f'scenario = "{SCENARIO}"\n[grid]\nphase.inflate.pressure_Pa = [8e3, {{}}, 1e4]\n'
    assert checked(grid.format("9e3"), tmp_path, capsys) == ["fine"]
    (line,) = checked(grid.format("-1e9"), tmp_path, capsys)
    assert line.startswith(
        "design 2 of 3 (phase.inflate.pressure_Pa = -1000000000.0): phase.inflate.pressure_Pa: -1e+09 is out"
    )
    robots = f"scenario = '{SCENARIO}'\n[grid]\nsoft_robot = ['square_core', 'nobody']\n"
    told = checked(robots, tmp_path, capsys)
    assert all(line.startswith("design 2 of 2 (soft_robot = 'nobody'): ") for line in told)


def test_check_says_what_all_designs_share_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = "scenario = '{}'\nset.fidelity = 'finest'\n[grid]\nsolver.search_iterations_max = [50, 60, 0]\n"
    told = checked(text.format(SCENARIO), tmp_path, capsys)
    assert [line.partition(": ")[0] for line in told] == [
        "all 3 designs",
        "design 3 of 3 (solver.search_iterations_max = 0)",
    ]
    (line,) = checked(text.format("nowhere.toml"), tmp_path, capsys)
    assert line.startswith("all 3 designs: ")
    assert "nowhere.toml" in line


def test_check_builds_the_arm_around_each_design(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = "scenario = 'ur5e_hexagon_arm'\n[grid]\nstart.flange.position_m = {}\n"
    (line,) = checked(scenario.format("[[0.3, 0.0, 0.7], [2.0, 0.0, 0.7]]"), tmp_path, capsys)
    assert line.startswith(
        "design 2 of 2 (start.flange.position_m = [2.0, 0.0, 0.7]): start.flange: arm 'ur5e'"
    )


def test_paths_in_a_study_are_seen_from_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "folder").mkdir()
    path = tmp_path / "folder" / "study.toml"
    path.write_text(
        "scenario = 'own.toml'\nmeasure = 'own.py:stretch'\n[grid]\nmode = ['dynamic']\n", "utf-8"
    )
    table = load_study(path)
    assert table.scenario == str(tmp_path / "folder" / "own.toml")
    assert table.measure == f"{tmp_path / 'folder' / 'own.py'}:stretch"


def test_a_robot_in_the_folder_of_a_study_is_found_from_everywhere(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("schema = 2\n", encoding="utf-8")
    table = study("set.soft_robot = 'mine.toml'\ngrid.robot = ['mine.toml', 'ur5e']\n", tmp_path)
    assert table.set["soft_robot"] == str(tmp_path / "mine.toml")
    assert table.grid["robot"] == [str(tmp_path / "mine.toml"), "ur5e"]
