"""The short cases of `cosim verify` pass, and it can fail: a fault, a case without answer, a wrong name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from cosim.bench.known_answers import CASES, Figure
from cosim.cli.main import main
from cosim.errors import ConvergenceError
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.gas import SealedGas
from cosim.soft.elements.material import Film


@pytest.mark.parametrize("case", CASES)
def test_a_case_passes(case: str) -> None:
    assert [figure for figure in CASES[case]() if not figure.passed] == []


def stiff_film(patch: pytest.MonkeyPatch) -> None:
    true = Film.membrane_stiffness.fget
    assert true is not None
    patch.setattr(Film, "membrane_stiffness", property(lambda self: 1.05 * true(self)))


def strong_pressure(patch: pytest.MonkeyPatch) -> None:
    true = Loads.pressures
    patch.setattr(Loads, "pressures", lambda self, n: tuple(1.05 * p for p in true(self, n)))


def stiff_gas(patch: pytest.MonkeyPatch) -> None:
    true = SealedGas.absolute_pressure
    stiffer = lambda self, volume: true(replace(self, exponent=1.03 * self.exponent), volume)  # noqa: E731
    patch.setattr(SealedGas, "absolute_pressure", stiffer)


def half_wrap(patch: pytest.MonkeyPatch) -> None:
    true = Cable.tension_ratio
    patch.setattr(Cable, "tension_ratio", lambda self, x: np.sqrt(true(self, x)))


@pytest.mark.parametrize(
    ("fault", "case"),
    [
        (stiff_film, "pressurised_cylinder"), (strong_pressure, "rubber_cylinder"),
        (stiff_gas, "sealed_piston"), (half_wrap, "capstan"),
    ],
)  # fmt: skip
def test_a_fault_of_the_model_is_seen(
    fault: Callable[[pytest.MonkeyPatch], None], case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    fault(monkeypatch)
    assert not all(figure.passed for figure in CASES[case]())


def test_a_figure_is_judged_by_its_error() -> None:
    assert Figure("height [m]", 1.004, 1.0, 5e-3).passed
    for off in (1.006, 0.994, float("nan")):
        assert not Figure("height [m]", off, 1.0, 5e-3).passed


def test_the_command_prints_a_row_for_each_figure(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", "capstan", "euler_buckling"]) == 0
    head, *rows, last = capsys.readouterr().out.splitlines()
    assert head.split() == ["case", "quantity", "found", "expected", "tolerance", "passes"]
    assert [row.split()[0] for row in rows] == ["capstan"] * 3 + ["euler_buckling"]
    assert all(row.endswith("yes") for row in rows)
    assert last.startswith("2 of 2 cases passed in ")


def test_a_case_that_falls_short_or_has_no_answer_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def unsolved() -> list[Figure]:
        raise ConvergenceError("no equilibrium found", 1.0, 60)

    monkeypatch.setitem(CASES, "capstan", lambda: [Figure("height [m]", 1.006, 1.0, 5e-3)])
    assert main(["verify", "capstan"]) == 1
    assert "0 of 1 cases passed" in (shown := capsys.readouterr().out)
    assert "failed: capstan" in shown
    monkeypatch.setitem(CASES, "capstan", unsolved)
    assert main(["verify", "capstan"]) == 1
    assert "capstan: not solved: no equilibrium found" in capsys.readouterr().out


def test_a_wrong_name_runs_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", "capstan", "nonsense"]) == 2
    shown = capsys.readouterr()
    assert "'nonsense'; there are: tip_loaded_cantilever" in shown.err
    assert shown.out == ""
