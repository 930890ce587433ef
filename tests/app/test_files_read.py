"""Every file that building a scenario reads counts among what its results were made of."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import pytest

import cosim
from cosim.app import preparation
from cosim.base.files import files_read, read_file
from cosim.base.resources import scenario_path
from cosim.build.arms import find_arm
from cosim.build.simulation import build_arms
from cosim.cli.main import EXIT_DONE, EXIT_INPUT, EXIT_INTERRUPTED, main
from cosim.config.plugins import register_module
from cosim.config.schema.body_sources import BodySourceTable
from cosim.config.schema.phase import CommandTable
from cosim.config.several_arms import load_arms
from cosim.config.toml.tables import adapter_of
from cosim.soft.geometry.named_mesh import NamedMesh
from cosim.soft.geometry.surface import rims
from tests.build.test_mesh_source import written
from tests.config.arm_texts import SIX_JOINTS_MJCF
from tests.soft.own_tube import tube

CUBE = """\
v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""
MODULE = """\
from dataclasses import dataclass
from typing import Literal

from cosim.config.schema.phase import CommandTable


@dataclass(frozen=True, kw_only=True)
class IdleTable(CommandTable):
    kind: Literal["idle"] = "idle"

    def source(self, given, scenario):
        return given
"""


@pytest.fixture
def executor() -> Iterator[Executor]:
    with ThreadPoolExecutor(1) as made:
        yield made


@dataclass(frozen=True, kw_only=True)
class ListedTable(BodySourceTable):
    """A tube whose scale stands in a file of a kind that cosim does not know.

    Args:
        file: holds one number.
    """

    kind: Literal["listed"] = "listed"
    file: str

    def set_names(self) -> tuple[str, ...]:
        return ("base", "tip", "side")

    def mesh(self) -> NamedMesh:
        scale = float(read_file(Path(self.file), 100))
        body = tube().body
        rings = {"base": body.base, "tip": body.tip, "side": body.cables[0].nodes}
        x, triangles = scale * body.positions, body.triangles
        return NamedMesh(x, triangles, rings, rims(triangles), "base", "tip", lines=rings)


def study(scenario: Path) -> dict[str, Any]:
    values = {"mode": "quasistatic", "phase.bend.increments": 1, "phase.bend.cable_tension_N": [0.0]}
    return {"scenario": str(scenario), "set": values, "grid": {"phase.bend.pressure_Pa": [5e3]}}


def scaled(mesh: Path, factor: float) -> None:
    lines = [line.split() for line in mesh.read_text(encoding="utf-8").splitlines()]
    text = [
        f"v {factor * float(line[1])} {factor * float(line[2])} {line[3]}" if line[:1] == ["v"] else
        " ".join(line) for line in lines
    ]  # fmt: skip
    mesh.write_text("\n".join(text), encoding="utf-8")


def test_a_sweep_runs_a_changed_body_mesh_again(executor: Executor, tmp_path: Path) -> None:
    written(tmp_path)
    of, out = study(tmp_path / "scenario.toml"), tmp_path / "out"
    assert cosim.sweep(of, out=out, engine=executor).computed == 1
    before = cosim.open_sweep(out)["volume_m3"][0]
    assert cosim.sweep(of, out=out, engine=executor).reused == 1
    scaled(tmp_path / "tube.obj", 2.0 / 3.0)
    again = cosim.sweep(of, out=out, engine=executor)
    assert (again.computed, again.reused) == (1, 0)
    # from 30 to 20 mm of radius; the film gives by some percent
    assert cosim.open_sweep(out)["volume_m3"][0] == pytest.approx(4.0 / 9.0 * before, rel=0.1)
    assert cosim.sweep(of, out=out, engine=executor).reused == 1


@pytest.fixture
def kinds_as_they_were(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Kinds that a test registers are gone after it, also from what checks files."""
    for family in (BodySourceTable, CommandTable):
        monkeypatch.setattr(family, "kinds", dict(family.kinds))
    yield
    adapter_of.cache_clear()


def test_a_new_kind_of_file_is_seen_in_a_sweep(
    executor: Executor, tmp_path: Path, kinds_as_they_were: None
) -> None:
    robot = written(tmp_path)
    cosim.register_kind(ListedTable)
    number = tmp_path / "number.txt"
    number.write_text("1.0")
    text = robot.read_text(encoding="utf-8")
    head, rest = text[: text.index("[body]")], text[text.index("[film]") :]
    body = f'[body]\nkind = "listed"\nfile = "{number}"\n\n'
    robot.write_text(head + body + rest, encoding="utf-8")
    of, out = study(tmp_path / "scenario.toml"), tmp_path / "out"
    assert cosim.sweep(of, out=out, engine=executor).statuses == {"completed": 1}
    assert cosim.sweep(of, out=out, engine=executor).reused == 1
    number.write_text("1.1")
    assert cosim.sweep(of, out=out, engine=executor).computed == 1


def test_the_module_of_a_kind_is_one_of_the_files(
    executor: Executor, tmp_path: Path, kinds_as_they_were: None
) -> None:
    written(tmp_path)
    module, file = tmp_path / "idle_commands.py", tmp_path / "scenario.toml"
    module.write_text(MODULE, encoding="utf-8")
    file.write_text(file.read_text(encoding="utf-8") + '\n[[command]]\nkind = "idle"\n', encoding="utf-8")
    of, out = study(file), tmp_path / "out"
    register_module(str(module))
    assert cosim.sweep(of, out=out, engine=executor).statuses == {"completed": 1}
    assert cosim.sweep(of, out=out, engine=executor).reused == 1
    module.write_text(MODULE + "\n# another\n", encoding="utf-8")
    assert cosim.sweep(of, out=out, engine=executor).computed == 1


def test_the_module_of_a_kind_is_one_of_the_files_of_several_arms(
    tmp_path: Path, kinds_as_they_were: None
) -> None:
    module, file = tmp_path / "idle_orders.py", tmp_path / "two.toml"
    module.write_text(MODULE.replace('"idle"', '"idle_orders"'), encoding="utf-8")
    text = scenario_path("two_arms_hold_box").read_text(encoding="utf-8")
    file.write_text(text + '\n[[arm.command]]\nkind = "idle_orders"\n', encoding="utf-8")
    register_module(str(module))
    with files_read() as found:
        build_arms(load_arms(file).arms, lambda _text: None)
    assert str(module) in found


def test_a_run_does_not_go_on_with_another_body_mesh(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    written(tmp_path)
    build = preparation.build_simulation

    class Interrupted:
        """A simulation that is interrupted after its first ticks."""

        def __init__(self, *given: Any, **more: Any) -> None:
            self._made = build(*given, **more)

        def __getattr__(self, name: str) -> Any:
            return getattr(self._made, name)

        def batches(self, **given: Any) -> Iterator[Any]:
            found = self._made.batches(most=3)
            yield next(found)
            os.kill(os.getpid(), signal.SIGINT)
            yield from found

    monkeypatch.setattr(preparation, "build_simulation", Interrupted)
    out = tmp_path / "out"
    given = ("--no-recording", "--quiet", "--out", str(out))
    assert main(["run", str(tmp_path / "scenario.toml"), *given]) == EXIT_INTERRUPTED
    monkeypatch.undo()
    mesh = (tmp_path / "tube.obj").read_bytes()
    scaled(tmp_path / "tube.obj", 2.0 / 3.0)
    assert main(["run", "--resume", str(out), "--quiet"]) == EXIT_INPUT
    assert f"{tmp_path / 'tube.obj'} was changed after the run began" in capsys.readouterr().err
    (tmp_path / "tube.obj").write_bytes(mesh)
    assert main(["run", "--resume", str(out), "--quiet"]) == EXIT_DONE


def test_files_that_an_mjcf_names_through_others_are_read_too(tmp_path: Path) -> None:
    head, tail = SIX_JOINTS_MJCF.split("<worldbody>", 1)
    parts = '<compiler meshdir="meshes"/><include file="parts/assets.xml"/><worldbody>'
    parts += '<geom type="mesh" mesh="cube"/>'
    (tmp_path / "parts").mkdir()
    (tmp_path / "meshes").mkdir()
    (tmp_path / "arm.xml").write_text(head + parts + tail)
    (tmp_path / "parts" / "assets.xml").write_text(
        '<mujoco><asset><mesh name="cube" file="cube.obj"/></asset></mujoco>'
    )
    (tmp_path / "meshes" / "cube.obj").write_text(CUBE)
    with files_read() as found:
        find_arm(str(tmp_path / "arm.xml"))
    names = {str(Path(name).relative_to(tmp_path)) for name in found}
    assert names == {"arm.xml", "parts/assets.xml", "meshes/cube.obj"}


def test_no_reader_of_a_scenarios_files_opens_them_itself() -> None:
    rooms = ("config", "build", "rigid", "kinematics", "soft", "plan", "coupling", "devices", "stepping")
    root = Path(cosim.__file__).parent
    opening = ("read_bytes(", "read_text()", "read_text(enc", ".open(", "ElementTree.parse(", "np.loadtxt(")
    files = chain.from_iterable((root / room).rglob("*.py") for room in rooms)
    found = {
        str(path.relative_to(root))
        for path in [*files, root / "base" / "solid.py"]
        if any(word in path.read_text(encoding="utf-8") for word in opening)
    }
    # what is rewritten, heads of files that are noted, figures that come with the code
    heads = {"rigid/build/urdf_arm.py", "rigid/build/mjcf_files.py"}
    known = {"config/upgrading.py", "build/expected_error.py", "devices/live/streams.py"} | heads
    assert found == known
