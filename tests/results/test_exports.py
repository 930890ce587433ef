"""What a run saw, for other programs: tables, meshes of the film, curves, notebooks."""

from __future__ import annotations

import base64
import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import cosim
from cosim.app import preparation
from cosim.cli.main import main
from cosim.results.result import panels

REFERENCE = "ur5e_hexagon_arm"


@pytest.fixture
def result(
    made_up_build: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> cosim.RunResult:
    monkeypatch.setattr(preparation, "build_simulation", made_up_build())
    overrides = {"clock.tick_s": 0.01, "recording.frames_per_s": 50}
    return cosim.run(REFERENCE, overrides=overrides, out=tmp_path / "run")


def numbers(piece: ElementTree.Element, name: str) -> Any:
    """Return an array of a VTK file: eight bytes of length, then the numbers, in base 64."""
    (found,) = (entry for entry in piece.iter("DataArray") if entry.get("Name") == name)
    data = base64.b64decode(found.text or "")
    assert int.from_bytes(data[:8], "little") == len(data) - 8
    kind = {"Float64": "<f8", "Int64": "<i8"}[str(found.get("type"))]
    return np.frombuffer(data[8:], kind).reshape(-1, int(str(found.get("NumberOfComponents"))))


def test_the_table_holds_every_number_of_every_tick(
    result: cosim.RunResult, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(tmp_path / "run"), "--csv"]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'run' / 'arrays.csv'}\n"
    with (tmp_path / "run" / "arrays.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))

    def numbers_of(*heads: str) -> Any:
        return np.array([[float(row[head]) for head in heads] for row in rows])

    assert numbers_of("tick").ravel().tolist() == result.tick.tolist()
    assert numbers_of("sag_m [m]").tobytes() == result.sag_m.tobytes()
    assert np.array_equal(numbers_of(*(f"tip_position.{k} [m]" for k in "xyz")), result.tip_position)
    assert np.array_equal(numbers_of("body_position.tool.z [m]")[:, 0], result.body_position[:, 1, 2])
    assert np.array_equal(numbers_of("joint_position.joint_3 [rad]")[:, 0], result.joint_position[:, 3])


def test_the_film_is_written_at_chosen_times(result: cosim.RunResult, tmp_path: Path) -> None:
    words = ["--vtk", "--at", "0.058", "0.2", "--out", str(tmp_path / "vtk")]
    assert main(["export", str(tmp_path / "run"), *words]) == 0
    listed = ElementTree.parse(tmp_path / "vtk" / "film.pvd").findall(".//DataSet")
    # frames every 20 ms: the nearest one is taken
    assert [(float(entry.get("timestep", "")), entry.get("file")) for entry in listed] == [
        (pytest.approx(0.06), "film-0000.vtp"), (pytest.approx(0.2), "film-0001.vtp"),
    ]  # fmt: skip
    piece = ElementTree.parse(tmp_path / "vtk" / "film-0001.vtp").getroot().find(".//Piece")
    assert piece is not None
    frame = 10
    assert np.array_equal(numbers(piece, "position_m"), result.node_position[frame])
    moved = result.node_position[frame] - result.node_position[0]
    assert np.array_equal(numbers(piece, "displacement_m"), moved)
    polys, lines = piece.find("Polys"), piece.find("Lines")
    assert polys is not None
    assert lines is not None
    assert numbers(polys, "connectivity").ravel().tolist() == result.stage.soft_triangles.ravel().tolist()
    assert numbers(polys, "offsets").ravel().tolist() == [3]
    assert numbers(lines, "connectivity").ravel().tolist() == [0, 1]


def test_all_frames_are_written_and_go_with_a_new_run(result: cosim.RunResult, tmp_path: Path) -> None:
    assert main(["export", str(tmp_path / "run"), "--vtk", "--csv", "--plot"]) == 0
    assert len(list((tmp_path / "run").glob("film-*.vtp"))) == len(result.frame_time_s)
    assert (tmp_path / "run" / "curves.png").read_bytes().startswith(b"\x89PNG")
    cosim.run(REFERENCE, out=tmp_path / "run")
    left = {path.suffix for path in (tmp_path / "run").iterdir()}
    assert not left & {".vtp", ".pvd", ".csv", ".png"}


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ([], "say what to write: --csv, --vtk, --plot"),
        (["--csv", "--at", "0.1"], "give --vtk as well"),
        (["--vtk", "--at", "7"], "--at 7: the run has the times 0 to 0.25 s"),
    ],
)
def test_what_cannot_be_exported_is_refused(
    words: list[str], text: str, result: cosim.RunResult, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(tmp_path / "run"), *words]) == 2
    assert text in capsys.readouterr().err


def test_the_usual_curves_are_drawn_with_units_and_phases(result: cosim.RunResult) -> None:
    figure = result.plot()
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels[:2] == ["tip position [mm]", "sag [mm]"]
    assert "chamber pressure [kPa]" in labels
    # nothing touches in this run: an empty panel would say less than none
    assert not any("contact" in label for label in labels)
    tip = figure.axes[0].lines[:3]
    assert np.allclose(np.array([line.get_ydata() for line in tip]).T, 1e3 * result.tip_position, rtol=1e-15)
    assert [line.get_label() for line in tip] == ["x", "y", "z"]
    changes = result.time_s[np.flatnonzero(np.diff(result.phase))]
    for axes in figure.axes:
        marks = [line.get_xdata()[0] for line in axes.lines if line.get_xdata()[0] == line.get_xdata()[-1]]
        assert marks == changes.tolist()
    assert len(changes) == 4  # phases after the first


def test_chosen_curves_are_drawn_even_if_they_are_zero(result: cosim.RunResult) -> None:
    (panel,) = panels(result, ["contact_force_N"])
    assert (panel.title, panel.unit, panel.values.shape) == ("contact force", "N", (26, 1))
    with pytest.raises(cosim.InputError, match="no array 'tip' over the ticks; there are tick, time_s"):
        result.plot("tip")


def test_notebooks_show_outcome_and_phases(result: cosim.RunResult) -> None:
    shown = result._repr_html_()
    root = ElementTree.fromstring(shown.replace("<br>", "<br/>"))
    rows = [[cell.text for cell in row] for row in root.findall(".//tbody/tr")]
    assert [row[0] for row in rows] == list(result.stage.phase_names)
    last = result.summary["phases"][-1]
    assert rows[-1][-1] == f"{1e3 * last['sag_m']:.1f}"
    assert "completed" in shown


def test_texts_of_a_run_cannot_become_markup(result: cosim.RunResult) -> None:
    result.summary["reason"] = "<script>alert(1)</script>"
    assert "<script>" not in result._repr_html_()
