"""The suite passes, and it can fail: a wrong number, a case that cannot be solved, a wrong name."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import get_args

import pytest

from cosim.cli.main import main
from cosim.cli.verify import verify_command
from cosim.errors import ConvergenceError
from cosim.soft.solve.state import Integrator
from cosim.verification.case import Case, Figure, observed_order
from cosim.verification.suite import CASES, run_case
from cosim.verification.vibrations import THEORY

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "verification.md"


def made_up(figure: Figure | None) -> Case:
    """Return a case with one given figure, or none because it cannot be solved."""

    def run() -> tuple[Figure, ...]:
        if figure is None:
            raise ConvergenceError("no equilibrium found", 1.0, 60)
        return (figure,)

    return Case("made_up", "Made up", "nobody", run)


GOOD = Figure("height", "m", 1.004, 1.0, 5e-3)


def documented() -> dict[str, dict[str, float]]:
    """Return the tolerance of every quantity in the document's table, by case."""
    found: dict[str, dict[str, float]] = {}
    name = ""
    for line in DOCUMENT.read_text(encoding="utf-8").partition("## Table of the last run")[2].splitlines():
        if line.startswith(("| `", "|  |")):
            cells = [cell.strip() for cell in line.split("|")[1:-1]]
            name, (number, *percent) = cells[0].strip("`") or name, cells[5].split()
            found.setdefault(name, {})[cells[1]] = float(number) * (0.01 if percent else 1.0)
    return found


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_case_passes(case: Case) -> None:
    result = run_case(case)
    assert not result.failure
    short = [f"{f.quantity}: {f.value} instead of {f.reference}" for f in result.figures if not f.passed]
    assert short == []
    assert result.passed
    # what is compared, at which load and how closely, is what the document says, in which it is rounded
    own = {f.quantity + ("" if f.unit == "1" else f" [{f.unit}]"): f.tolerance for f in result.figures}
    assert len(own) == len(result.figures)
    assert own == pytest.approx(documented()[case.name], rel=0.05, abs=6e-5)


def test_every_case_has_a_name_of_its_own_and_a_source() -> None:
    assert len({case.name for case in CASES}) == len(CASES)
    assert all(case.title and case.source for case in CASES)


def test_the_document_names_every_case_in_text_and_table() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    described, _, table = text.partition("## Table of the last run")
    assert [case.name for case in CASES if f"`{case.name}`" not in described] == []
    assert [case.name for case in CASES if f"| `{case.name}` |" not in table] == []


def test_every_integrator_is_verified() -> None:
    assert set(THEORY) == set(get_args(Integrator))


def test_a_figure_is_judged_by_its_error() -> None:
    assert GOOD.passed
    assert GOOD.error == pytest.approx(4e-3)
    assert not Figure("height", "m", 1.006, 1.0, 5e-3).passed
    assert not Figure("height", "m", 0.994, 1.0, 5e-3).passed
    assert not Figure("height", "m", math.nan, 1.0, 5e-3).passed
    # a relative error has no meaning where the reference is zero
    assert not Figure("drift", "m", 0.0, 0.0, 5e-3).passed
    assert Figure("drift", "m", 1e-3, 0.0, 5e-3, absolute=True).passed
    assert not Figure("drift", "m", 6e-3, 0.0, 5e-3, absolute=True).passed


def test_the_observed_order_is_the_exponent_of_the_error() -> None:
    assert observed_order(0.09, 0.01, ratio=3.0) == pytest.approx(2.0)
    assert observed_order(-0.04, 0.01) == pytest.approx(2.0)
    assert math.isnan(observed_order(0.04, 0.0))


@pytest.mark.parametrize(
    ("figure", "code", "word"),
    [
        (GOOD, 0, "1 of 1 cases passed"),
        (Figure("height", "m", 1.006, 1.0, 5e-3), 1, "failed: made_up"),
        (None, 1, "not solved: no equilibrium found"),
    ],
)
def test_exit_code_and_files(
    figure: Figure | None, code: int, word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "new" / "results.json"
    assert verify_command([], path, cases=[made_up(figure)]) == code
    assert word in capsys.readouterr().out
    document = json.loads(path.read_text(encoding="utf-8"))
    assert document["passed"] is (code == 0)
    (case,) = document["cases"]
    assert case["passed"] is (code == 0)
    assert len(case["figures"]) == (figure is not None)


def test_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "results.json"
    assert main(["verify", "capstan", "roll_up", "--json", str(path)]) == 0
    assert "2 of 2 cases passed" in capsys.readouterr().out
    names = [case["name"] for case in json.loads(path.read_text(encoding="utf-8"))["cases"]]
    assert names == ["capstan", "roll_up"]
    assert main(["verify", "--list"]) == 0
    assert all(case.name in capsys.readouterr().out for case in CASES[:1])


def test_wrong_input_runs_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", "capstan", "nonsense"]) == 2
    assert main(["verify", "capstan", "--json", str(tmp_path)]) == 2
    shown = capsys.readouterr()
    assert "nonsense" in shown.err
    assert "is a directory" in shown.err
    assert shown.out == ""
