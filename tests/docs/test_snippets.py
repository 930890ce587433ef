"""Every snippet and command of the README, the first pages and the how-to pages is run, in order.

A block of Python runs in the namespace of those before it on the page, or is the file `# NAME.py`; a block of
TOML or CSV whose first line is `# NAME.toml` is that file, `# appended to NAME.toml` adds to it; a line of a
shell block that begins with `cosim` is run, and ends with code 0 unless it says `# exit code N`. What takes
long runs in fewer increments or longer ticks, of the paper's model: other tests run it as it is.
"""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

import cosim
from cosim.cli.main import main
from tests.pages import page as page_text

ROOT = Path(__file__).resolve().parents[2]
INCREMENTS = {"hang": 1, "inflate": 5, "turn": 5, "lift": 4, "reach": 2}
LONG: dict[str, dict[str, Any]] = {
    "ur5e_hexagon_arm": {"mode": "quasistatic", "model.published": True}
    | {f"phase.{name}.increments": count for name, count in INCREMENTS.items()},
    "path.toml": {"mode": "quasistatic"},
    "tip_path_on_rail": {
        "mode": "quasistatic",
        "model.published": True,
        "phase.reach.increments": 4,
        "phase.follow.increments": 4,
        "phase.follow.tip_path.points_m": [[0.5, 0.25, 0.85], [0.5, 0.55, 0.85]],
    },
    "gripper_lifts_roll": {
        "model.published": True,
        "clock.tick_s": 0.008,
        "phase.shake.duration_s": 1.5,
        "phase.hold.duration_s": 0.1,
    },
    "pouch_gripper_lifts_ball": {"phase.shake.duration_s": 1.5, "phase.hold.duration_s": 0.1},
    "mine.toml": {"model.published": True, "clock.tick_s": 0.01},
    "payload.toml": {"model.published": True},
    "light_hexagon_arm": {"model.published": True, "clock.tick_s": 0.01},
}
"""Scenarios that take too long for a test, and what is changed for it."""
UNVERIFIED = ("sag.toml",)
"""Studies of designs that are not solved on the refined mesh as well: the others are."""
OTHERS = (
    "dask ", "OMP_NUM_THREADS=1 dask ", "pip install ", "make", "python3", ".venv/bin/", "source",
    "python benchmarks/",
)  # fmt: skip
"""What shell blocks may hold besides: installing, the Makefile's targets and benchmarks, tested elsewhere."""
NOT_HERE = re.compile(
    r"cosim (view|video|verify|trade) |cosim run .*(--resume|--live|--web)|cosim verify$|"
    r"cosim sweep (.*--engine|grip)|cosim run path.toml --set mode=quasistatic"
)
"""Commands with tests of their own, which take long, need something to draw with, or an interrupted run.

And one that `LONG` makes the same as the next.
"""
WEEKLY = ("grasp_an_object", "follow_tip_path", "damp_a_swing", "design")
"""Pages whose commands take longest; golden runs and tests of exports, linear models and designs
run the like of them."""
TESTED_ELSEWHERE = {
    "extending": "tests/app/test_extending.py and the tests of each kind of extension",
    "snapshots": "tests/app/test_simulation.py, tests/cli/test_resume.py",
    "own_arm_and_cell": "tests/app/test_own_arm_and_cell.py",
    "two_arms": "tests/app/test_run_arms.py",
    "tutorial": "tests/docs/test_site.py",
    "own_robot": "tests/docs/test_site.py, which runs every notebook",
    "identify_robot": "tests/docs/test_site.py, which runs every notebook",
    "contributing": "what it names are the Makefile's targets",
}


def _listed(*captions: str) -> list[str]:
    """Return the pages under some captions of the index."""
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    tables = dict(re.findall(r"^:caption: (.+)\n:maxdepth: 1\n\n((?:[\w-]+\n)+)", index, re.MULTILINE))
    return [name for caption in captions for name in tables[caption].split()]


PAGES = {
    "README": ROOT / "README.md",
    **{
        name: ROOT / "docs" / f"{name}.md"
        for name in _listed("Start here", "How-to")
        if name not in TESTED_ELSEWHERE
    },
}


def _text(name: str) -> str:
    """Return a page, with the files that it includes as blocks."""
    return PAGES[name].read_text("utf-8") if name == "README" else page_text(name)


def _commands(shell: str) -> list[tuple[str, int]]:
    """Return the commands of a shell block that are run, with their exit codes; all others must be known."""
    found = []
    for line in shell.replace("\\\n", " ").splitlines():
        command, _, comment = (part.strip() for part in line.partition(" #"))
        if not command or command.startswith("#"):
            continue
        assert command.startswith(("cosim ", *OTHERS)), f"no test knows how to run: {command}"
        if command.startswith("cosim ") and not NOT_HERE.match(command):
            code = re.fullmatch(r"exit code (\d+)", comment)
            found.append((command, int(code[1]) if code else 0))
    return found


def _run(command: str, code: int) -> None:
    words = shlex.split(command)[1:]
    if words[0] == "run":
        changes = LONG.get(words[1], {}).items()
        words += [word for key, value in changes for word in ("--set", f"{key}={str(value).lower()}")]
        words.append("--quiet")
    words += ["--unverified"] * (words[0] == "design" and words[1] in UNVERIFIED)
    assert main(words) == code, command


@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=pytest.mark.long) if page in WEEKLY else page for page in PAGES]
)
def test_every_snippet_of_a_page_runs(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    run = cosim.run

    def shortened(scenario: str, *, overrides: Mapping[str, Any] | None = None, **given: Any) -> Any:
        return run(scenario, overrides={**(overrides or {}), **LONG.get(scenario, {})}, **given)

    monkeypatch.setitem(vars(cosim), "run", shortened)
    names: dict[str, object] = {"__name__": "__main__"}
    blocks = re.findall(r"^```(\w+)\n(.*?)^```$", _text(page), re.M | re.S)
    left = Counter(each for language, text in blocks if language == "sh" for each in _commands(text))
    begun: set[tuple[str, int]] = set()
    for language, text in blocks:
        if language == "python" and (named := re.match(r"# (\w+\.py)\n", text)):
            Path(named[1]).write_text(text, encoding="utf-8")
        elif language == "python":
            exec(compile(text, f"{page}.md", "exec"), names)
        elif language == "sh":
            for command, code in _commands(text):
                left[command, code] -= 1
                # of one that comes again, the first and the last time: files have grown in between
                if (command, code) not in begun or not left[command, code]:
                    _run(command, code)
                begun.add((command, code))
        elif named := re.match(r"# (appended to )?(\w+\.(?:toml|csv))\n", text):
            before = Path(named[2]).read_text(encoding="utf-8") if named[1] else ""
            Path(named[2]).write_text(before + text, encoding="utf-8")
    capsys.readouterr()


ENDS = {
    name: re.findall(r"^```text\n(tip:.*?)^```$", PAGES[name].read_text("utf-8"), re.M | re.S)
    for name in PAGES
}
"""What pages show of the end of a run."""


def _in_words(line: str) -> str:
    """Return a line with its numbers left out: they are those of a machine, or change with the model."""
    return re.sub(r"\d+(\.\d+)?", "#", line)


@pytest.mark.parametrize("page", ["README", "own_scenario"])
def test_pages_show_all_lines_of_the_end_of_a_run(page: str) -> None:
    (shown,) = ENDS[page]
    heads = [line.split(":")[0] for line in shown.splitlines()]
    target = [] if page == "own_scenario" else ["target"]  # the reference scenario reaches for one
    last = ["films", "error", "stability", "modelled", "warnings", "time", "files"]
    assert heads == ["tip", *target, *last]


@pytest.mark.error_bars
def test_the_end_of_the_first_own_run_is_as_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    toml = re.search(
        r"^```toml\n(# mine\.toml\n.*?)^```$", PAGES["own_scenario"].read_text("utf-8"), re.M | re.S
    )
    assert toml is not None
    Path("mine.toml").write_text(toml[1], encoding="utf-8")
    assert main(["run", "mine.toml", "--out", "runs/mine"]) == 0
    said = capsys.readouterr().err.splitlines()[-8:]
    assert list(map(_in_words, said)) == list(map(_in_words, ENDS["own_scenario"][0].splitlines()))
