"""Values of a robot from curves that it has made itself; wrong curves; values that no curve tells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.base.frames import Array
from cosim.bench.equilibria import Curves
from cosim.bench.fitting import Fit, Identified, identify, spread_of
from cosim.bench.identifiability import identifiability
from cosim.bench.oddities import oddities
from cosim.bench.page import page_text, series_lines, write_results
from cosim.config.benches import BenchTable, Series, SeriesTable, UnknownTable, load_bench
from cosim.config.loading import load_soft_robot
from tests.derivatives import differences, relative_error

BENCH = """
scenario = "bending_angle"
[set]
model.published = false
contact.self_contact = false
[[parameter]]
key = "soft_robot.film.young_modulus_Pa"
low = 0.5e9
high = 4e9
start = 1.0e9
[[parameter]]
key = "soft_robot.stiffener.young_modulus_Pa"
low = 0.5e9
high = 5e9
start = 2.2e9
[[series]]
name = "extension"
file = "inflated.csv"
quantity = "length_m"
measured = "length_mm"
loads.pressure_Pa = "pressure_kPa"
noise = 0.05
hold_out = 0
[[series]]
name = "deflection"
file = "pushed.csv"
quantity = "tip_position_m.x"
measured = "tip_mm"
loads = { pressure_Pa = 8e3, "force_N.unit_3.outer.x" = "force_N" }
noise = 0.05
relative = true
hold_out = 3
"""
TRUE = np.array([1.3e9, 1.7e9])


def bench_in(folder: Path) -> tuple[BenchTable, tuple[Series, ...]]:
    """Return a bench with the curves of its own model at the true values, without noise."""
    (folder / "inflated.csv").write_text("pressure_kPa,length_mm\n3,1\n6,1\n9,1\n12,1\n")
    (folder / "pushed.csv").write_text("# by hand\nforce_N,tip_mm\n0,0\n0.1,0\n0.25,0\n0.4,0\n")
    (folder / "bench.toml").write_text(BENCH)
    bench, series = load_bench(folder / "bench.toml")
    values = Curves(bench, series).at(TRUE).reshape(2, 4)
    made = [replace(entry, values=tuple(row.tolist())) for entry, row in zip(series, values, strict=True)]
    return bench, tuple(made)


def test_values_are_found_again_and_an_outlier_is_set_aside(tmp_path: Path) -> None:
    bench, series = bench_in(tmp_path)
    assert series[0].loads["pressure_Pa"] == (3e3, 6e3, 9e3, 12e3)
    fit = Fit(bench, series)
    start = fit.aligned(fit.start)
    by_start = differences(fit.residuals, start, 1e-2).T
    assert relative_error(by_start, fit.jacobian(start)) < 1e-5
    wrong = list(series[0].values)
    wrong[2] += 1e-3
    shifted = tuple(2e-3 + value for value in series[1].values)
    found = identify(bench, (replace(series[0], values=tuple(wrong)), replace(series[1], values=shifted)))
    assert np.array_equal(np.flatnonzero(found.outliers), [2])
    assert np.array_equal(np.flatnonzero(found.held_out), [5])
    assert "outliers set aside: row 3" in series_lines(found)[0]
    assert "held out rows by" in series_lines(found)[1]
    assert "offset 0.002 m, found with the values" in series_lines(found)[1]
    off = series_lines(replace(found, predicted=found.predicted - 0.01))
    assert "measured values are all some 0.01 m above the model's: relative = true" in off[0]
    assert np.abs(np.array([each.value for each in found.found]) / TRUE - 1.0).max() < 1e-6
    assert all(each.low < value < each.high for each, value in zip(found.found, TRUE, strict=True))
    check_files(found, tmp_path)


def check_files(found: Identified, folder: Path) -> None:
    page, robot = write_results(found, folder / "out", "bench.toml")
    assert page.read_text() == page_text(found, "bench.toml")
    read = load_soft_robot(robot)
    assert read.film.young_modulus_Pa == pytest.approx(1.3e9, rel=1e-6)
    assert "film.young_modulus_Pa" in read.known.identified
    assert "film" in read.known.published


def test_intervals_widen_where_noise_has_not_made_the_residuals() -> None:
    # the 95 % quantile of chi^2 with 13 degrees of freedom is 22.36
    assert [spread_of(least, 13) for least in (1.0, 22.3, 22.5)] == [1.0, 1.0, 22.5 / 13]


UNKNOWNS = tuple(
    UnknownTable(f"soft_robot.film.{name}", 1.0, 9.0) for name in ("young_modulus_Pa", "thickness_m", "idle")
)


def test_a_product_is_told_apart_from_its_factors() -> None:
    random = np.random.default_rng(1)
    product, bending = random.normal(size=(2, 20))
    rows = np.stack([100.0 * product, 100.0 * product + 0.01 * bending, 1e-3 * bending], axis=1)
    check = identifiability(rows, np.full(3, np.log(9.0)), UNKNOWNS, {"volume_m3": rows[:1]})
    assert check.without_effect == ("soft_robot.film.idle",)
    assert [each.text for each in check.directions] == [
        "film.young_modulus_Pa * film.thickness_m", "film.young_modulus_Pa * film.thickness_m^-1.00",
    ]  # fmt: skip
    assert [each.determined for each in check.directions] == [True, False]
    assert "the data cannot distinguish film.young_modulus_Pa from film.thickness_m" in check.advice[0]
    assert not check.good


TABLE = SeriesTable("extension", "inflated.csv", "length_m", "length_mm", {}, 0.1)


def curve(values: Array, **others: Array) -> Series:
    beside = {name: tuple(column.tolist()) for name, column in others.items()}
    return Series(TABLE, {}, tuple(values.tolist()), 1e-4, "m", beside)


MODEL = 0.01 * np.sqrt(np.arange(1.0, 8.0))


@pytest.mark.parametrize(
    ("values", "others", "said"),
    [
        (1.3 * MODEL, {}, ""),
        (1300.0 * MODEL, {}, "near 1000 (kilo): is it in another unit"),
        (5.0 - MODEL, {"volume_ml": 1.1 * MODEL}, "the numbers of column 'volume_ml': are the two swapped?"),
        (-1.2 * MODEL, {"volume_ml": 2.0 * MODEL}, "with the other sign: does its axis point the other way?"),
        (0.02 - MODEL, {}, "does not agree with the model (correlation -1.00)"),
        (4.0 * MODEL, {}, "is 4 times the model: is it another quantity"),
    ],
)
def test_odd_columns_are_noticed(values: Array, others: dict[str, Array], said: str) -> None:
    found = oddities([curve(values, **others)], [MODEL])
    assert (said in found[0]) if said else not found


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"length_mm"', '"pressure_kPa"', "measured: column 'pressure_kPa' is in Pa, but length_m is in m"),
        ('"length_mm"', '"lenght_mm"', "series.extension.measured: no column 'lenght_mm'"),
        ("high = 4e9", "high = 1e8", "parameter.*high"),
        ("inflated.csv", "gone.csv", "series.extension.file"),
    ],
)
def test_wrong_benches_are_refused_by_their_key(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / "inflated.csv").write_text("pressure_kPa,length_mm\n3,1\n6,2\n")
    (tmp_path / "pushed.csv").write_text("force_N,tip_mm\n0,0\n1,1\n")
    (tmp_path / "bench.toml").write_text(BENCH.replace(old, new))
    with pytest.raises(cosim.ScenarioError, match=message):
        load_bench(tmp_path / "bench.toml")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("pressure_kPa,länge_mm\n3,1\n".encode("latin-1"), "it is not UTF-8 text"),
        (b"pressure_kPa,length_mm,length_mm\n3,1,1\n6,2,2\n", "has the column 'length_mm' twice; rename one"),
        (b"pressure_kPa,length_mm\n3," + 140_000 * b"1", "field larger than"),
        (b"pressure_kPa,length_mm\n3,1\n6,up\n", "could not convert"),
    ],
)
def test_curves_that_cannot_be_read_are_refused_by_their_key(
    tmp_path: Path, data: bytes, message: str
) -> None:
    (tmp_path / "inflated.csv").write_bytes(data)
    (tmp_path / "pushed.csv").write_text("force_N,tip_mm\n0,0\n1,1\n")
    (tmp_path / "bench.toml").write_text(BENCH)
    with pytest.raises(cosim.ScenarioError, match=rf"series\.extension\.file: .*{message}"):
        load_bench(tmp_path / "bench.toml")


def test_curves_of_a_spreadsheet_with_a_byte_order_mark_are_read(tmp_path: Path) -> None:
    (tmp_path / "inflated.csv").write_bytes(b"\xef\xbb\xbfpressure_kPa,length_mm\r\n3,1\r\n6,2\r\n")
    (tmp_path / "pushed.csv").write_text("force_N,tip_mm\n0,0\n1,1\n")
    (tmp_path / "bench.toml").write_text(BENCH)
    assert load_bench(tmp_path / "bench.toml")[1][0].loads["pressure_Pa"] == (3e3, 6e3)


def test_bounds_that_no_robot_can_have_are_named_by_the_values_that_were_tried(tmp_path: Path) -> None:
    key = "soft_robot.stack.corner_radius_m"
    (tmp_path / "pushed.csv").write_text("force_N,tip_mm\n0,0\n0.1,0\n")
    (tmp_path / "inflated.csv").write_text("pressure_kPa,length_mm\n3,1\n6,1\n")
    text = BENCH.replace("soft_robot.stiffener.young_modulus_Pa", key)
    text = text.replace("low = 0.5e9\nhigh = 5e9\nstart = 2.2e9", "low = 1e-3\nhigh = 0.1")
    (tmp_path / "bench.toml").write_text(text)
    curves = Curves(*load_bench(tmp_path / "bench.toml"))
    with pytest.raises(cosim.ScenarioError, match=rf"{key} = 0\.001; narrow low and high"):
        curves.at(np.array([1e9, 1e-3]))
