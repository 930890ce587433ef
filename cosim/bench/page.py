"""Writes the results of an identification or a design: an HTML page, and the robot's file with the values
that were found.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from html import escape
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import tomli_w

from cosim.base import whole_files, writing
from cosim.base.frames import Array
from cosim.bench import design, equilibria, fitting, parameters
from cosim.config.loading import to_table
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import KnownTable, SoftRobotTable
from cosim.config.toml.keys import unit_of, unit_text
from cosim.errors import InputError

_WIDE, _HIGH, _EDGE = 520.0, 260.0, 46.0
_COLOURS: Final = {"fitted": "#1f77b4", "held out": "#ff7f0e", "outlier": "#d62728"}
_STYLE: Final = (
    "body{font-family:sans-serif;max-width:72em;margin:2em auto;padding:0 1em}table{border-collapse:collapse}"
    "td,th{padding:.2em .8em;border-bottom:1px solid #ccc;text-align:right}td:first-child,th:first-child"
    "{text-align:left}svg{margin:.5em}"
)


_ALIKE = 3.0  # ratio of mean and standard deviation of residuals from which they are an offset
_INSIDE = 0.75  # fraction of held-out rows in their intervals, below which intervals are too narrow


def value_lines(result: fitting.Identified) -> list[str]:
    """Return a line for each value that was found."""
    lines = []
    for entry, found in zip(result.bench.parameter, result.found, strict=True):
        unit = unit_text(unit_of(entry.key))
        bound = "; the interval ends at a bound of the bench file" if found.at_bound else ""
        lines.append(
            f"{', '.join((entry.key, *entry.also))} = {found.value:.6g} {unit} "
            f"(95 %: {found.low:.6g} to {found.high:.6g}){bound}"
        )
    return lines


def series_lines(result: fitting.Identified) -> list[str]:
    """Return a line for each series: its errors in fitted rows and in held-out rows."""
    lines = []
    for number, entry in enumerate(result.series):
        rows = result.rows_of(number)
        left, scaled = (result.predicted - result.measured)[rows], result.scaled[rows]
        fitted, held = result.fitted[rows], result.held_out[rows]
        span = float(np.ptp(result.measured[rows])) or 1.0
        parts = [f"fitted rows off by {_percent(left[fitted], span)} of the range"] if fitted.any() else []
        if held.any():
            parts.append(f"held out rows by {_percent(left[held], span)}")
            inside = int((np.abs(left[held]) <= result.band[rows][held]).sum())
            if result.found:
                parts.append(f"{inside} of {int(held.sum())} of them in their 95 % interval")
            if result.found and inside < _INSIDE * held.sum():
                parts.append("the model is off by more than its interval says")
        if result.outliers[rows].any():
            numbers = ", ".join(str(row + 1) for row in np.flatnonzero(result.outliers[rows]))
            parts.append(f"outliers set aside: row {numbers}")
        if not fitted.any() and not held.all():
            parts.append("the model cannot follow it: no row is met")
        if entry.table.relative:
            parts.append(f"offset {result.zeros[number]:.4g} {entry.unit}, found with the values")
        elif abs(left.mean()) > _ALIKE * max(float(left.std()), entry.noise):
            parts.append(
                f"measured values are all some {-left.mean():.2g} {entry.unit} above the model's: "
                "relative = true fits this offset, such as a volume of tubing"
            )
        if _systematic(scaled[fitted]):
            parts.append("the model cannot follow it: residuals are no noise, as neighbours are alike")
        lines.append(f"{entry.table.name}: {'; '.join(parts)}")
    return lines


def _percent(left: Array, span: float) -> str:
    return f"{100.0 * float(np.sqrt((left**2).mean())) / span:.3g} %" if left.size else "nothing"


def _systematic(scaled: Array) -> bool:
    """Return whether residuals are larger than noise, and neighbours alike."""
    if len(scaled) < 5 or (scaled**2).mean() < 2.0:
        return False
    return float((scaled[1:] * scaled[:-1]).mean() / (scaled**2).mean()) > 0.3


def write_results(result: fitting.Identified, directory: Path, source: str) -> list[Path]:
    """Write `identified.html` and the robot's file with its values; return their paths.

    Args:
        result: of a fit.
        directory: for the files.
        source: name of the bench file.

    Raises:
        OutputError: a file cannot be written.
    """
    pairs = zip(result.bench.parameter, result.found, strict=True)
    keys = {
        key: value
        for entry, found in pairs
        for key, value in parameters.shared((entry.key, *entry.also), found.value).items()
    }
    head = [
        f"values that `cosim identify` has found from {source}:",
        *value_lines(result),
        *series_lines(result),
    ]
    scenario = equilibria.bench_scenario(result.bench.scenario, result.bench.set)
    robot = robot_text(scenario, keys, "identified", head)
    return _written(directory, robot, ("identified.html", page_text(result, source)))


def write_designs(results: Sequence[design.Designed], directory: Path, source: str) -> list[Path]:
    """Write `designed.html` and the file of the best choice's robot; return their paths.

    Args:
        results: of `design`, the best choice first.
        directory: for the files.
        source: name of the study's file.

    Raises:
        OutputError: a file cannot be written.
    """
    best = results[0]
    keys = {
        key: each
        for entry, value in zip(best.study.parameter, best.found.values.tolist(), strict=True)
        for key, each in parameters.shared((entry.key, *entry.also), value).items()
        if key.startswith("soft_robot.")
    }
    head = [f"values that `cosim design` has found for {source}:", *design.design_lines(best)]
    robot = robot_text(equilibria.bench_scenario(best.study.scenario, best.study.set), keys, "assumed", head)
    parts = [f"<h1>Designed for {escape(source)}</h1>"]
    for found in results:
        met = "" if found.feasible else ": limits are NOT met"
        parts.append(f"<h2>{escape(found.choice or 'Before and after')}{met}</h2>")
        parts += [_list(design.design_lines(found)), f"<p>{found.evaluations} designs solved.</p>"]
    return _written(directory, robot, ("designed.html", _page(source, parts)))


def _written(directory: Path, robot: str, page: tuple[str, str]) -> list[Path]:
    paths = [directory / page[0], directory / "robot.toml"]
    with writing.writing(directory):
        directory.mkdir(parents=True, exist_ok=True)
    for path, text in zip(paths, (page[1], robot), strict=True):
        with writing.writing(path):
            whole_files.write_whole(path, text)
    return paths


def robot_text(
    scenario: Scenario,
    keys: Mapping[str, float],
    known: Literal["identified", "assumed"],
    head: Sequence[str],
) -> str:
    """Return a scenario's soft robot as a file, with values by key, and how these are known.

    Args:
        scenario: with the robot.
        keys: values by key path.
        known: list of `[known]` that gets the keys.
        head: first lines of the file, a comment.
    """
    robot = parameters.with_values(scenario, dict(keys)).soft_robot
    if not isinstance(robot, SoftRobotTable):
        raise InputError("the soft body is given as arrays, which are in no file")
    changed = tuple(dict.fromkeys(_plain(key, to_table(scenario)) for key in keys))
    lists = {
        entry.name: tuple(key for key in getattr(robot.known, entry.name) if key not in changed)
        for entry in fields(KnownTable)
    }
    lists[known] = (*lists[known], *changed)
    robot = replace(robot, known=KnownTable(**lists))
    lines = [f"# {robot.name}, with {head[0]}", *(f"# {line}" for line in head[1:])]
    lines.append("# Every other value is spelled out as it was.")
    return "\n".join(lines) + "\n" + tomli_w.dumps(to_table(robot))


def _page(source: str, parts: Sequence[str]) -> str:
    begin = f"<!doctype html><meta charset='utf-8'><title>{escape(source)}</title><style>{_STYLE}</style>"
    return "\n".join((begin, *parts)) + "\n"


def _plain(key: str, table: Any) -> str:
    """Return a key of the soft robot as in `[known]`: without names or numbers of list entries."""
    found, here = [], table
    for part in key.split("."):
        if isinstance(here, list) or part.isdecimal():
            here = here if isinstance(here, list) else []
            entry = [each for each in here if isinstance(each, dict) and each.get("name") == part]
            here = entry[0] if entry else None
            continue
        found.append(part)
        here = here.get(part) if isinstance(here, dict) else None
    return ".".join(found[1:])


def page_text(result: fitting.Identified, source: str) -> str:
    """Return the page."""
    values = "".join(
        f"<tr><td>{escape(entry.key)}</td><td>{found.value:.6g}</td><td>{found.low:.6g}</td>"
        f"<td>{found.high:.6g}</td><td>{escape(unit_text(unit_of(entry.key)) or '1')}</td></tr>"
        for entry, found in zip(result.bench.parameter, result.found, strict=True)
    )
    parts = [
        f"<h1>Values identified from {escape(source)}</h1>",
        "<table><tr><th>value</th><th>found</th><th>95 % from</th><th>to</th><th>unit</th></tr>",
        values, "</table>", "<h2>Curves</h2>", _list(series_lines(result)),
        *(_plot(result, number) for number in range(len(result.series))),
        "<h2>What the data can tell</h2>", _list([*result.oddities, *result.check.lines()]),
        f"<p>{int(result.fitted.sum())} rows fitted, {int(result.held_out.sum())} held out, "
        f"{int(result.outliers.sum())} set aside; {result.equilibria} equilibria.</p>",
    ]  # fmt: skip
    return _page(source, parts)


def _list(lines: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def _plot(result: fitting.Identified, number: int) -> str:
    """Return measured points and the model's line of a series over its first load that varies, as SVG."""
    entry, rows = result.series[number], result.rows_of(number)
    name, values = next(
        ((name, values) for name, values in entry.loads.items() if np.ptp(values) > 0.0),
        ("row", tuple(map(float, range(1, len(entry.values) + 1)))),
    )
    x, measured, predicted = np.array(values), result.measured[rows], result.predicted[rows]
    both = np.concatenate([measured, predicted])
    across, up = _scale(x, _EDGE, _WIDE - 10.0), _scale(both, _HIGH - _EDGE, 10.0)
    order = np.argsort(x)
    line = " ".join(f"{across(a):.1f},{up(b):.1f}" for a, b in zip(x[order], predicted[order], strict=True))
    marks = []
    for k, (a, b) in enumerate(zip(x, measured, strict=True)):
        held, removed = result.held_out[rows][k], result.outliers[rows][k]
        kind = "outlier" if removed else "held out" if held else "fitted"
        marks.append(f"<circle cx='{across(a):.1f}' cy='{up(b):.1f}' r='4' fill='{_COLOURS[kind]}'/>")
    texts = [
        _text(_EDGE, _HIGH - 22.0, f"{x.min():.4g}"), _text(_WIDE - 60.0, _HIGH - 22.0, f"{x.max():.4g}"),
        _text(2.0, _HIGH - _EDGE, f"{both.min():.4g}"), _text(2.0, 16.0, f"{both.max():.4g}"),
        _text(_WIDE / 2.0 - 60.0, _HIGH - 6.0, name),
        _text(_EDGE + 8.0, 16.0, f"{entry.table.name}: {entry.table.quantity}"),
        *(_text(_EDGE + 8.0, 32.0 + 14.0 * k, *pair) for k, pair in enumerate(_COLOURS.items())),
    ]  # fmt: skip
    return (
        f"<svg width='{_WIDE:.0f}' height='{_HIGH:.0f}' font-size='11'><polyline points='{line}' fill='none' "
        f"stroke='#555'/>{''.join(marks)}{''.join(texts)}</svg>"
    )


def _scale(values: Array, begin: float, end: float) -> Any:
    low, span = float(values.min()), float(np.ptp(values)) or 1.0
    return lambda value: begin + (end - begin) * (value - low) / span


def _text(x: float, y: float, text: str, colour: str = "#333") -> str:
    return f"<text x='{x:.0f}' y='{y:.0f}' fill='{colour}'>{escape(text)}</text>"
