"""Kinds of one's own reach the command line by `--import`, or from an installed package."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

import cosim
from cosim.cli.main import main
from cosim.config.plugins import GROUP
from cosim.config.schema.phase import CommandTable
from cosim.config.schema.soft_robot import ElementTable
from cosim.config.toml import quantities
from cosim.config.toml.tables import adapter_of
from tests.devices import sine_commands
from tests.devices.sine_commands import SineTable

SCENARIO = """
schema = 2
title = "a tension that swings"
robot = "none"
soft_robot = "hexagon_arm"
model.published = true

[start]
flange.position_m = [0.0, 0.0, 0.5]
flange.direction = [0.0, 0.0, -1.0]

[[command]]
kind = "sine"
cable = "left"
amplitude_N = 0.4
frequency_Hz = 2.5

[[phase]]
name = "hold"
duration_s = 0.1
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with a scenario that needs a kind, and the module that holds it."""
    for family in (CommandTable, ElementTable):
        monkeypatch.setattr(family, "kinds", {})
    (tmp_path / "swing.toml").write_text(SCENARIO, encoding="utf-8")
    own = Path(sine_commands.__file__ or "").read_text(encoding="utf-8")
    (tmp_path / "own_sine.py").write_text(own, encoding="utf-8")
    yield tmp_path
    sys.modules.pop("own_sine", None)
    adapter_of.cache_clear()


def test_a_module_is_imported_for_a_command(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = str(folder / "swing.toml")
    assert main(["check", file]) == 2
    assert "kind 'sine' is not known; there are: none; register it with --import" in capsys.readouterr().out
    assert main(["check", file, "--import", str(folder / "own_sine.py")]) == 0
    assert main(["schema", "--import", "tests.devices.sine_commands"]) == 2
    assert "kind 'sine' is that of own_sine.SineTable" in capsys.readouterr().err
    CommandTable.kinds.clear()
    assert main(["schema", "--import", "tests.devices.sine_commands"]) == 0
    assert '"SineTable"' in capsys.readouterr().out


def test_an_installed_package_offers_its_kinds(folder: Path) -> None:
    package = folder / "own_sine-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: own-sine\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text(f"[{GROUP}]\nsine = own_sine\n")
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); from cosim.cli.main import main; "
        "sys.exit(main(['check', sys.argv[2]]))"
    )
    arguments = [sys.executable, "-c", code, str(folder), str(folder / "swing.toml")]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    (package / "entry_points.txt").write_text(f"[{GROUP}]\nsine = no_such_module\n")
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "entry point 'sine'" in done.stderr
    assert "ModuleNotFoundError" in done.stderr


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (None, "FileNotFoundError"),
        ("1 / 0", "cannot be imported: ZeroDivisionError"),
        ("from cosim.config.schema.phase import CommandTable", "holds no kind of tables"),
    ],
)
def test_a_module_without_kinds_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str], text: str | None, told: str
) -> None:
    module = folder / "nothing_known.py"
    if text is not None:
        module.write_text(text)
    assert main(["check", "sealed_arm", "--import", str(module)]) == 2
    assert told in capsys.readouterr().err
    sys.modules.pop(module.stem, None)


def test_a_kind_is_named_and_only_one_class_has_it(folder: Path) -> None:
    @dataclass(frozen=True, kw_only=True)
    class Nameless(ElementTable):
        pass

    @dataclass(frozen=True, kw_only=True)
    class Other(CommandTable):
        kind: str = "sine"

    with pytest.raises(cosim.InputError, match="Nameless names no kind"):
        cosim.register_kind(Nameless)
    cosim.register_kind(SineTable)
    cosim.register_kind(SineTable)
    with pytest.raises(cosim.InputError, match=r"kind .sine. is that of tests\.devices\.sine_commands"):
        cosim.register_kind(Other)
    assert ElementTable.kinds == {}


def test_types_of_values_are_found_where_they_were_with_a_warning() -> None:
    with pytest.warns(DeprecationWarning, match="import Positive from cosim.config.toml.quantities"):
        from cosim.config.toml.keys import Positive
    assert Positive is quantities.Positive
