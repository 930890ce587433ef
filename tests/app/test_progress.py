"""What Python shows of a run: a progress line, and pictures."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

import cosim
from cosim.errors import InputError

RUN = "three_unit_inflation"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_is_shown_once_a_phase_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    result = cosim.run(RUN, observers=[cosim.ProgressBar()])
    lines = capsys.readouterr().err.splitlines()
    assert [line.split()[3] for line in lines] == list(result.stage.phase_names)
    assert "100 %" in lines[-1]
    assert lines[-1].endswith("done")


def test_progress_renews_its_line_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    cosim.run(RUN, observers=[cosim.ProgressBar()])
    assert terminal.getvalue().count("\n") == 1
    assert terminal.getvalue().startswith("\r")


def test_pictures_need_a_recording(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="recording=True"):
        cosim.picture(cosim.run(RUN))
    with pytest.raises(InputError, match=r"no recording at .*cosim run"):
        cosim.picture(tmp_path)
