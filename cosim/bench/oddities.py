"""Compares measured curves with the model before a fit, and reports probable mistakes in the data: another
unit, another sign, swapped columns.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from cosim.base.frames import Array
from cosim.config.benches import Series

_LEAST_LIKE, _ALIKE = 0.5, 0.95  # correlation of a curve with the model's
_NEAR_UNIT: Final = 0.4  # by logarithm
_OFF, _NEARER = 0.2, 3.0  # of the model's size, and how much nearer another column is
_FACTORS: Final = (2.5, 0.4)
_KNOWN_FACTORS: Final = (
    (1e3, "kilo"), (1e-3, "milli"), (6894.757, "psi"), (1e5, "bar"), (57.29578, "degrees"), (100.0, "centi"),
    (10.0, "milli for centi"), (1e6, "mega or micro"),
)  # fmt: skip


def oddities(series: Sequence[Series], predicted: Sequence[Array]) -> list[str]:
    """Return messages about probable mistakes in measured curves.

    Args:
        series: measured curves.
        predicted: the model's values of each, at the initial parameters.
    """
    found = []
    for entry, whole in zip(series, predicted, strict=True):
        shift = 1.0 if entry.table.relative else 0.0
        data, model = np.array(entry.values) - shift * entry.values[0], whole - shift * whole[0]
        name, column = entry.table.name, entry.table.measured
        if len(data) < 3 or not np.ptp(data) > 0.0 or not np.ptp(model) > 0.0:
            continue
        like = float(np.corrcoef(data, model)[0, 1])
        factor = float((data @ model) / (model @ model))
        unit = _unit(factor) if like > _ALIKE and not _FACTORS[1] < factor < _FACTORS[0] else ""
        other = _nearer(entry, data, model)
        if unit:
            problem = (
                f"is {factor:.3g} times the model, near {unit}: is it in another unit than its name says?"
            )
        elif other == column:
            problem = "fits much better with the other sign: does its axis point the other way?"
        elif other:
            problem = f"fits less well than the numbers of column {other!r}: are the two swapped?"
        elif like < _LEAST_LIKE:
            problem = (
                f"does not agree with the model (correlation {like:.2f}): is a sign, axis or column wrong?"
            )
        elif not _FACTORS[1] < factor < _FACTORS[0]:
            problem = f"is {factor:.3g} times the model: is it another quantity, or is the start far off?"
        else:
            continue
        found.append(f"series.{name}: column {column!r} {problem}")
    return found


def _unit(factor: float) -> str:
    """Return the known factor between two units that is close to a factor, or an empty text."""
    pairs = [(each, what) for known, what in _KNOWN_FACTORS for each in (known, 1.0 / known)]
    size, what = min(pairs, key=lambda pair: abs(np.log(factor / pair[0])))
    return f"{size:.4g} ({what})" if abs(np.log(factor / size)) < _NEAR_UNIT else ""


def _nearer(entry: Series, data: Array, model: Array) -> str:
    """Return the column that is much closer to the model than the measured one, or an empty text.

    The name of the measured column means that it is closer with the opposite sign.
    """

    def away(values: Array) -> float:
        return float(np.linalg.norm(values - model) / np.linalg.norm(model))

    distance = away(data)
    others = {entry.table.measured: -data}
    for name, values in entry.others.items():
        others[name] = np.array(values) - (values[0] if entry.table.relative else 0.0)
    name = min(others, key=lambda each: away(others[each]))
    return name if distance > _OFF and away(others[name]) < distance / _NEARER else ""
