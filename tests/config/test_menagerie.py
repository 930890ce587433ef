"""Arms of MuJoCo Menagerie are found where the packages that fetch them put them; nothing is downloaded."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.base.files import files_read
from cosim.build.arms import find_arm
from cosim.cli.main import main
from cosim.config.loading import load_scenario
from cosim.errors import InputError, ScenarioError
from tests.config.arm_texts import SIX_JOINTS_MJCF, scenario_with

NOWHERE = "menagerie:acme_six is not on this machine"
SCENE = '<mujoco><include file="six.xml"/></mujoco>'


@pytest.fixture(autouse=True)
def _empty(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("MENAGERIE_ROOT", "MENAGERIE_CACHE_DIR", "ROBOT_DESCRIPTIONS_CACHE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def put(folder: Path, **files: str) -> None:
    folder.mkdir(parents=True)
    for name, text in files.items():
        (folder / f"{name}.xml").write_text(text, encoding="utf-8")


PLACES = {
    "fetched": ("cache/mujoco_menagerie/models/acme_six-0123456789abcdef", None),
    "elsewhere": ("fetched/models/acme_six-0123456789abcdef", ("MENAGERIE_CACHE_DIR", "fetched")),
    "cloned": ("cache/robot_descriptions/mujoco_menagerie/acme_six", None),
    "clones elsewhere": ("clones/mujoco_menagerie/acme_six", ("ROBOT_DESCRIPTIONS_CACHE", "clones")),
    "checkout": ("checkout/acme_six", ("MENAGERIE_ROOT", "checkout")),
}


@pytest.mark.parametrize("place", PLACES)
def test_a_model_is_found(place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=f"{NOWHERE}.*no model found.*prefetch acme_six"):
        find_arm("menagerie:acme_six")
    where, variable = PLACES[place]
    put(tmp_path / where, six=SIX_JOINTS_MJCF, scene=SCENE, hand="<mujoco/>")
    if variable is not None:
        monkeypatch.setenv(variable[0], str(tmp_path / variable[1]))
    if "fetched" in where or "models" in where:
        with pytest.raises(InputError, match=NOWHERE):  # it is still being fetched
            find_arm("menagerie:acme_six")
        (tmp_path / where / ".complete").touch()
    arm = find_arm("menagerie:acme_six")
    assert (arm.name, len(arm.joint_names)) == ("acme_six", 6)
    assert arm.path == (tmp_path / where / "six.xml").resolve()
    assert find_arm("menagerie:acme_six/six").path == arm.path
    with pytest.raises(InputError, match=r"which of its files\? .* is one of .*six"):
        find_arm("menagerie:acme_six/seven")
    with pytest.raises(InputError, match="did you mean 'acme_six'"):
        find_arm("menagerie:acme_sic")


def test_a_scenario_and_an_arm_toml_name_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    put(tmp_path / "cache/robot_descriptions/mujoco_menagerie/acme_six", six=SIX_JOINTS_MJCF)
    path = tmp_path / "s.toml"
    path.write_text(scenario_with("menagerie:acme_six"), encoding="utf-8")
    scenario = load_scenario(path)
    assert scenario.robot == "menagerie:acme_six"
    with files_read() as found:
        find_arm(scenario.robot)
    assert any(name.endswith("six.xml") for name in found)
    table = tmp_path / "arm.toml"
    table.write_text('file = "menagerie:acme_six"\nadapter.position_m = [0.0, 0.0, 0.1]\n', encoding="utf-8")
    assert find_arm(str(table)).path == find_arm("menagerie:acme_six").path
    assert main(["check", "menagerie:acme_six"]) == 0
    assert "fine: 6 joints" in capsys.readouterr().out


def test_several_files_without_a_scene_are_asked_for(tmp_path: Path) -> None:
    put(
        tmp_path / "cache/robot_descriptions/mujoco_menagerie/acme_six", six=SIX_JOINTS_MJCF, hand="<mujoco/>"
    )
    with pytest.raises(InputError, match=r"which of its files.*hand, six"):
        find_arm("menagerie:acme_six")


def test_what_is_not_there_is_a_fault_of_the_scenario(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text(scenario_with("menagerie:acme_six"), encoding="utf-8")
    with pytest.raises(ScenarioError, match=f"^robot: {NOWHERE}"):
        load_scenario(path)
