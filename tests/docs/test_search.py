"""The search of the built documentation, by its own scripts, has the right page first for what users type."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
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


def found(html: Path) -> dict[str, list[str]]:
    """Return the pages that each query finds, best first; the documentation is made in a folder."""
    if importlib.util.find_spec("sphinx") is None:
        pytest.skip("needs what makes the documentation: cosim[docs]")
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs node, to run the search as a browser does")
    plain = ("-D", "nb_execution_mode=off", "-D", "html_theme=basic", "--builder", "html")
    build = ["-m", "sphinx", "--quiet", *plain, str(DOCS), str(html)]
    subprocess.run([sys.executable, *build], check=True, cwd=DOCS.parent)
    done = subprocess.run([node, str(SEARCH), str(html), *WANTED], check=True, capture_output=True, text=True)
    lines = map(json.loads, done.stdout.splitlines())
    return {query: [page for page, _, _ in line] for query, line in zip(WANTED, lines, strict=True)}


def test_the_right_page_is_first(tmp_path: Path) -> None:
    # one test, so that one worker makes the documentation
    pages = {query: list(dict.fromkeys(pages))[:4] for query, pages in found(tmp_path).items()}
    assert {query: best for query, best in pages.items() if best[:1] != [WANTED[query]]} == {}


def test_the_order_names_pages_that_are_there() -> None:
    lists = re.findall(r"const \w+ = \[(.*?)\]", (DOCS / "search_score.js").read_text("utf-8"), re.DOTALL)
    named = re.findall(r'"(\w+)"', "".join(lists))
    assert len(named) > 10
    assert [name for name in named if not list(DOCS.glob(f"{name}.*"))] == []
