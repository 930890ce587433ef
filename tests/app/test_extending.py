"""The page on extending, followed to the letter: for each example a file of its own and one line."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import cosim
from tests.pages import page

PACKAGE = Path(cosim.__file__).parent
ARM = """\
[soft_robot]
file = "square_core_cables"

"""
INFLATED = """\
schema = 2
title = "an arm is inflated"
robot = "none"

[start]
flange.position_m = [0.0, 0.0, 0.5]
flange.direction = [0.0, 0.0, -1.0]

[[phase]]
name = "inflate"
duration_s = 0.04
settle_s = 0.0
pressure_Pa = 20e3

"""
RUN = """\
result = cosim.run("mine.toml", error=False)
plain = cosim.run("plain.toml", error=False)
assert abs(result.tip_position - plain.tip_position).max() > 1e-5
"""
REPORT = "print(result.summary['status'], len(result.tip_position))\n"


def blocks(title: str, language: str) -> list[str]:
    """Return what stands in a section of the page in some language."""
    (section,) = re.findall(rf"^## {title}\n(.*?)(?=^## |\Z)", page("extending"), re.M | re.S)
    return re.findall(rf"^```{language}\n(.*?)^```$", section, re.M | re.S)


def contents(*folders: Path) -> dict[str, str]:
    """Return the hash of every file in some folders, but for what Python and numba keep for themselves."""
    files = [file for folder in folders for file in folder.rglob("*") if file.is_file()]
    return {
        str(file): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in files
        if "__pycache__" not in file.parts
    }


@pytest.mark.parametrize(
    ("title", "module", "name"),
    [
        ("A kind of elements", "dashpots", "DashpotTable"),
        ("An element as a leaf", "springs", "SpringTable"),
        ("A source of commands", "sine", "SineTable"),
        ("A body from a file", "tubes", "TubeTable"),
        ("A custom body", "own_tube", "tube"),
        ("A controller", "press", "Press"),
        ("A view of a run", "tip_speed", "TipSpeed"),
    ],
)
def test_a_file_and_a_line_are_all_it_takes(title: str, module: str, name: str, tmp_path: Path) -> None:
    before = contents(PACKAGE, tmp_path)
    file, line = blocks(title, "python")
    toml = "".join(blocks(title, "toml"))
    made = re.findall(r'"(\w+\.rrd)"', line)
    start = f"import cosim\nfrom {module} import {name}\n{line}"
    if toml.startswith("["):  # of a scenario; otherwise a whole one
        plain = INFLATED + ARM
        mine = INFLATED + toml if toml.startswith("[soft_robot]") else plain + toml
        written = {"mine.toml": mine, "plain.toml": plain, "start.py": start + RUN + REPORT}
    else:
        (scenario,) = re.findall(r'"(\w+\.toml)"', line)
        written = {scenario: toml or INFLATED + ARM, "start.py": start + REPORT}
    written[f"{module}.py"] = file
    for path, text in written.items():
        (tmp_path / path).write_text(text, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(PACKAGE.parent), "PYTHONDONTWRITEBYTECODE": "1"}
    told = subprocess.run(
        [sys.executable, "start.py"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.returncode == 0, told.stderr
    assert re.fullmatch(r"completed \d\d+", told.stdout.splitlines()[-1])
    after = contents(PACKAGE, tmp_path)
    changed = {path for path in before.keys() | after.keys() if before.get(path) != after.get(path)}
    assert changed == {str(tmp_path / path) for path in (*written, *made)}


def test_another_contact_law_is_another_function_in_one_file(tmp_path: Path) -> None:
    law, check = blocks("Another contact law", "python")
    shutil.copytree(PACKAGE, tmp_path / "cosim", ignore=shutil.ignore_patterns("__pycache__"))
    file = tmp_path / "cosim" / "soft" / "contact" / "contact_law.py"
    own = r"@device_function\ndef press\(.*?\n\n\n"
    changed, count = re.subn(own, lambda _: law + "\n\n", file.read_text("utf-8"), flags=re.S)
    assert count == 1
    file.write_text(changed, encoding="utf-8")
    (tmp_path / "check.py").write_text(check, encoding="utf-8")
    told = subprocess.run(
        [sys.executable, "check.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.returncode == 0, told.stderr
    forces = {line.split()[0]: float(line.split()[2]) for line in told.stdout.splitlines()}
    assert forces["0.0004"] == pytest.approx(8.0 * forces["0.0001"], rel=1e-3)  # 4^1.5
