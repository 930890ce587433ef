"""The documentation is built without a warning, and shows and finds what it should.

It stays in build/docs. Its notebooks are run as it is built. Its search, by its own scripts, has the right
page first for what users type.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS, HTML = ROOT / "docs", ROOT / "build" / "docs"
SEARCH = Path(__file__).with_name("search.cjs")
WANTED = {
    "install": "install",
    "change pressure": "install",
    "sag": "own_scenario",
    "soft robot datasheet": "own_soft_robot",
    "own robot arm": "own_arm_and_cell",
    "urdf": "own_arm_and_cell",
    "conveyor belt": "own_arm_and_cell",
    "tip path": "follow_tip_path",
    "send path to robot": "follow_tip_path",
    "urscript export": "to_the_robot",
    "ros bag": "to_the_robot",
    "robot motion": "to_the_robot",
    "grasp object": "grasp_an_object",
    "pick and place": "grasp_an_object",
    "closed loop python": "in_the_loop",
    "reinforcement learning": "in_the_loop",
    "speed accuracy": "speed_and_accuracy",
    "time step": "speed_and_accuracy",
    "how fast": "performance",
    "cluster sweep": "sweeps",
    "parameter study": "sweeps",
    "plot results": "results",
    "csv export": "results",
    "video": "looking",
    "run failed": "failing_runs",
    "convergence error": "failing_runs",
    "resume interrupted run": "snapshots",
    "save state": "snapshots",
    "pump": "actuation",
    "friction": "contact",
    "wrinkling": "mesh_study",
    "summary.json": "summary",
    "not modelled": "limits",
}
"""What is typed, and the page that answers it."""


def build() -> None:
    """Build the documentation from nothing, as users see it."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    environment.pop("MPLBACKEND", None)
    options = ["--fail-on-warning", "--keep-going", "--quiet", "--fresh-env"]
    command = [sys.executable, "-m", "sphinx", *options, "--builder", "html", str(DOCS), str(HTML)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]


def assert_the_tutorial_shows_what_it_says() -> None:
    nbformat = pytest.importorskip("nbformat")
    cells = nbformat.read(HTML.parent / "jupyter_execute" / "tutorial.ipynb", as_version=4).cells
    shown = [output for cell in cells if cell.cell_type == "code" for output in cell.outputs]
    texts = [str(output.get("data", {}).get("text/plain", output.get("text", ""))) for output in shown]
    assert any("100 %" in text and "done" in text for text in texts), "no progress line"
    assert any("the tip sags by" in text for text in texts)
    assert sum("image/png" in output.get("data", {}) for output in shown) >= 2
    failed = [output for output in shown if output.output_type == "error"]
    assert [error.ename for error in failed] in ([], ["OutputError"]), failed  # without a driver to draw with


def found() -> dict[str, list[str]]:
    """Return the pages that each query finds, best first."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs node, to run the search as a browser does")
    done = subprocess.run([node, str(SEARCH), str(HTML), *WANTED], check=True, capture_output=True, text=True)
    lines = map(json.loads, done.stdout.splitlines())
    return {query: [page for page, _, _ in line] for query, line in zip(WANTED, lines, strict=True)}


def test_it_is_built_and_shows_and_finds_what_it_should() -> None:
    # one test, so that one worker builds the documentation, once
    for name in ("sphinx", "myst_nb", "furo"):
        pytest.importorskip(name, reason="needs what makes the documentation: cosim[docs]")
    build()
    assert_the_tutorial_shows_what_it_says()
    pages = {query: list(dict.fromkeys(pages))[:4] for query, pages in found().items()}
    assert {query: best for query, best in pages.items() if best[:1] != [WANTED[query]]} == {}


def test_the_order_names_pages_that_are_there() -> None:
    lists = re.findall(r"const \w+ = \[(.*?)\]", (DOCS / "search_score.js").read_text("utf-8"), re.DOTALL)
    named = re.findall(r'"(\w+)"', "".join(lists))
    assert len(named) > 10
    assert [name for name in named if not list(DOCS.glob(f"{name}.*"))] == []
