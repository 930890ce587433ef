"""The page on an arm and a cell of one's own is followed: its files are written, its commands run."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from cosim.cli.main import main
from tests.pages import page


def test_the_page_is_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shown = page("own_arm_and_cell")
    texts = re.findall(r"```(?:xml|toml)\n(.*?)```", shown, re.DOTALL)
    for name, text in zip(("arm.toml", "cell.xml", "press.toml"), texts, strict=True):
        assert f"`{name}`" in shown
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    commands = "".join(re.findall(r"```sh\n(.*?)```", shown, re.DOTALL)).splitlines()
    assert [command.split()[1] for command in commands] == ["check", "check", "run"]
    for command in commands:
        assert main(command.split()[1:]) == 0
    said = capsys.readouterr().out
    assert "fine: 8 joints; flange 'arm_tool_link'" in said
    assert "at home: start.flange = {" in said
    assert (tmp_path / "runs/press/recording.rrd").stat().st_size > 0
    summary = json.loads((tmp_path / "runs/press/summary.json").read_text(encoding="utf-8"))
    assert summary["status"] == "completed"
    assert summary["arm"]["planned"]["clearance"]["links"]["distance_m"] > 0.02
    assert summary["max_contact_force_N"] > 0.1
