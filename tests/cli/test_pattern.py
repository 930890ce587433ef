"""`cosim pattern` and `cosim new --pattern`, as a user types them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.base.drawing import Drawing, read_drawing
from cosim.base.resources import soft_robot_path
from cosim.cli.main import main

pytest.importorskip("ezdxf", reason="needs the extra pattern")
FINGER = soft_robot_path("pouch_finger").with_suffix(".svg")


def lengths(drawing: Drawing, layer: str) -> list[float]:
    """Return the lengths [m] of the lines of a layer, sorted."""
    return sorted(
        float(np.linalg.norm(np.diff(line.points, axis=0), axis=1).sum()) for line in drawing.layers[layer]
    )


def test_a_pattern_is_told_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    png = tmp_path / "finger.png"
    assert main(["pattern", "check", "pouch_finger", "--png", str(png)]) == 0
    said = capsys.readouterr().out
    for part in ("in mm", "SEAL 11", "30.00 x 120.00 mm, 36.00 cm^2", "seams:   420.00 mm", "base, 20 nodes"):
        assert part in said
    assert png.read_bytes()[:4] == b"\x89PNG"


def test_a_pattern_that_is_written_and_read_again_has_its_lengths(tmp_path: Path) -> None:
    out = tmp_path / "finger.dxf"
    assert main(["pattern", "export", "pouch_finger", str(out)]) == 0
    before, after = read_drawing(FINGER), read_drawing(out)
    for layer in before.layers:
        assert lengths(after, layer) == pytest.approx(lengths(before, layer), abs=1e-6)
        ends = [
            np.concatenate([line.points for line in drawing.layers[layer]]).max(axis=0)
            for drawing in (before, after)
        ]
        assert ends[1] == pytest.approx(ends[0], abs=1e-6)


def test_a_robot_and_a_scenario_are_written_for_a_drawing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("finger.svg").write_bytes(FINGER.read_bytes())
    assert main(["new", "--pattern", "finger.svg"]) == 0
    assert main(["check", "finger.toml", "finger_robot.toml"]) == 0
    assert main(["new", "--pattern", "finger.svg"]) == 2
    assert "finger_robot.toml is there and is not overwritten" in capsys.readouterr().err


STIFF_BACK = """
[[group]]
name = "back"

[group.film]
law = "wrinkling"
young_modulus_Pa = 3e9
poisson_ratio = 0.35
thickness_m = 0.4e-3
density_kg_m3 = 1390.0
"""


def test_a_drawn_finger_bends_by_the_direction_of_its_tip(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    draw_finger(Path("finger.dxf"))
    assert main(["new", "--pattern", "finger.dxf"]) == 0
    robot = Path("finger_robot.toml")
    robot.write_text(robot.read_text(encoding="utf-8") + STIFF_BACK, encoding="utf-8")
    run = cosim.run("finger.toml", error=False, overrides={"phase.inflate.increments": 8})
    down = np.array([0.0, 0.0, -1.0])
    bent = np.degrees(np.arccos(run.tip_direction @ down))
    assert bent[0] == pytest.approx(0.0, abs=1e-3)
    # the last pouch, from seam to seam; the middle of its front is not a straight continuation of it
    along = (run.node_position[0] - run.flange_position[0]) @ down
    tip, last = (np.abs(along - place) < 1e-4 for place in (0.108, 0.082))
    pouch = run.node_position[-1][tip].mean(axis=0) - run.node_position[-1][last].mean(axis=0)
    own = np.degrees(np.arccos(pouch @ down / np.linalg.norm(pouch)))
    assert own > 44.0  # the chord from base to tip: 25 degrees
    assert bent[-1] == pytest.approx(own, abs=2.0)
    assert "mm at the tip" in run.summary["tip_measured_by"]


def draw_finger(path: Path) -> None:
    """Draw the finger of docs/pattern.md."""
    import ezdxf

    document = ezdxf.new(units=4)
    space = document.modelspace()
    corners = [(0, 0), (44, 0), (44, 112), (0, 112)]
    for layer in ("CUT", "SEAL"):
        space.add_lwpolyline(corners, close=True, dxfattribs={"layer": layer})
    for y in (34, 60, 86):
        for ends in ([(0, y), (17, y)], [(27, y), (44, y)]):
            space.add_lwpolyline(ends, dxfattribs={"layer": "SEAL"})
    space.add_circle((22, 20), 1, dxfattribs={"layer": "PORT"})
    space.add_lwpolyline([(0, 0), (44, 0), (44, 8), (0, 8)], close=True, dxfattribs={"layer": "BASE"})
    space.add_lwpolyline([(0, 112), (44, 112)], dxfattribs={"layer": "TIP"})
    document.saveas(path)


def test_what_is_no_pattern_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["pattern", "check", "hexagon_arm"]) == 2
    assert "hexagon_arm: has no cut pattern; [stack] draws it" in capsys.readouterr().err
    assert main(["pattern", "export", "pouch_finger", str(tmp_path / "finger.svg")]) == 2
    assert "must end in .dxf" in capsys.readouterr().err
    assert main(["new"]) == 2


@pytest.mark.parametrize("library", ["shapely", "pythoncdt", "svgelements"])
def test_a_missing_library_is_named_with_its_extra(
    library: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    assert main(["pattern", "check", "pouch_finger"]) == 2
    assert f"this needs {library}: pip install 'cosim[pattern]'" in capsys.readouterr().err
