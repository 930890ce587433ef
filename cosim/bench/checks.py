"""What is looked at before a fit: whether the data can be right, and which values they can tell.

The rows' derivatives, divided by their noise, are decomposed by singular values (SVD): along a direction of
parameters with singular value s, the data know a position with the standard deviation 1 / s. A direction that
is known no better than the bounds already say, or than to a quarter, is one that the data cannot tell.
Parameters with positive bounds are taken by their logarithms, so that a direction is a product of powers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.config.benches import Series, UnknownTable

_TOLD: Final = 0.25  # half of the 95 % interval of a product, relative: one known less well is not told
_WITHOUT: Final = 0.1  # standard deviations, by which a value without effect moves the data at most
_SAME: Final = 0.1  # exponents below are left out of products
_LEAST_LIKE, _ALIKE = 0.5, 0.95  # correlation of a curve with the model's
_NEAR_UNIT: Final = 0.4  # by logarithm
_OFF, _NEARER = 0.2, 3.0  # of the model's size, and how much nearer another column is
_FACTORS: Final = (2.5, 0.4)
_KNOWN_FACTORS: Final = (
    (1e3, "kilo"), (1e-3, "milli"), (6894.757, "psi"), (1e5, "bar"), (57.29578, "degrees"), (100.0, "centi"),
    (10.0, "milli for centi"), (1e6, "mega or micro"),
)  # fmt: skip


@final
@dataclass(frozen=True)
class Direction:
    """A combination of parameters, and how well the data know it.

    Args:
        text: product of powers, or sum.
        sd: standard deviation; of a product relative.
        told: whether the data tell it.
    """

    text: str
    sd: float
    told: bool


@final
@dataclass(frozen=True)
class Identifiability:
    """What the data can tell.

    Args:
        without_effect: keys that move no row by more than its noise.
        directions: all combinations, best known first.
        advice: what to do about those that are not told; empty if all are.
    """

    without_effect: tuple[str, ...]
    directions: tuple[Direction, ...]
    advice: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Whether the data tell every value."""
        return not self.without_effect and all(each.told for each in self.directions)

    def lines(self) -> list[str]:
        """Return what a person reads."""
        found = [
            f"{key}: has no effect on these data beyond their noise; leave it out"
            for key in self.without_effect
        ]
        for each in self.directions:
            known = f"known to {100.0 * 1.96 * each.sd:.3g} %" if each.told else "NOT known from these data"
            found.append(f"{each.text}: {known}")
        return [*found, *self.advice]


def identifiability(
    scaled: Array, widths: Array, unknowns: Sequence[UnknownTable], further: dict[str, Array]
) -> Identifiability:
    """Return what data can tell.

    Args:
        scaled: (rows, parameters), derivatives over noise, by the parameters as they are fitted.
        widths: (parameters,), from low to high, the same.
        unknowns: the parameters.
        further: by name of a quantity that could be measured too, (rows, parameters), derivatives over noise.
    """
    moved = np.abs(scaled).max(axis=0) * widths if len(scaled) else np.zeros(len(unknowns))
    idle = moved < _WITHOUT
    some = [entry for entry, without in zip(unknowns, idle, strict=True) if not without]
    found = _directions(scaled[:, ~idle], widths[~idle], some)
    advice = [_untold(along, some) for along, direction in found if not direction.told]
    if advice:
        more = {
            name: _directions(np.concatenate([scaled, rows])[:, ~idle], widths[~idle], some)
            for name, rows in further.items()
        }
        enough = [name for name, those in more.items() if all(direction.told for _, direction in those)]
        best = min(
            enough, key=lambda name: max(direction.sd for _, direction in more[name]), default="no other"
        )
        advice.append(
            f"{best} measured in the same rows, to 0.1 mm or 0.1 ml, would tell it"
            if enough
            else "no other length, position of the tip or volume, measured in the same rows, would tell it"
        )
    return Identifiability(
        tuple(entry.key for entry, without in zip(unknowns, idle, strict=True) if without),
        tuple(direction for _, direction in found), tuple(advice),
    )  # fmt: skip


def _directions(
    scaled: Array, widths: Array, unknowns: Sequence[UnknownTable]
) -> list[tuple[Array, Direction]]:
    """Return the combinations that data know, best known first, each with its unit vector (parameters,)."""
    names = [entry.key.removeprefix("soft_robot.") for entry in unknowns]
    products = [entry.low > 0.0 for entry in unknowns]
    _, sizes, turned = np.linalg.svd(scaled, full_matrices=True)
    sizes, found = np.concatenate([sizes, np.zeros(len(names) - len(sizes))]), []
    for size, along in zip(sizes, turned, strict=True):
        room = float((widths / np.maximum(np.abs(along), 1e-12)).min())
        sd = 1.0 / max(float(size), 1e-300)
        told = 1.96 * sd < min(0.5 * room, _TOLD if all(products) else np.inf)
        found.append((along, Direction(_text(along, names, products), sd, told)))
    return found


def _text(along: Array, names: Sequence[str], products: Sequence[bool]) -> str:
    along = along / along[np.argmax(np.round(np.abs(along), 3))]
    parts = [
        f"{name}^{power:.2f}" if product else f"{power:+.2f} {name}"
        for name, power, product in zip(names, along, products, strict=True)
        if abs(power) > _SAME
    ]
    parts = [part.removesuffix("^1.00") for part in parts]
    return " * ".join(parts)


def _untold(along: Array, unknowns: Sequence[UnknownTable]) -> str:
    """Return which parameters cannot be told apart, and what to do."""
    parts = [
        entry.key.removeprefix("soft_robot.")
        for entry, power in zip(unknowns, along, strict=True)
        if abs(power) > _SAME * np.abs(along).max()
    ]
    if len(parts) == 1:
        return f"the data cannot tell {parts[0]} within its bounds; give it a prior_sd, or measure more"
    return (
        f"the data cannot tell {' from '.join(parts)}: only what is listed as known; give one of them a "
        "fixed value (leave it out), a prior_sd, or measure more"
    )


def oddities(series: Sequence[Series], predicted: Sequence[Array]) -> list[str]:
    """Return what looks wrong in curves beside those of the model at the start: units, columns.

    Args:
        series: measured.
        predicted: the model's values of each.
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
                f"does not go with the model (correlation {like:.2f}): is a sign, axis or column another?"
            )
        elif not _FACTORS[1] < factor < _FACTORS[0]:
            problem = f"is {factor:.3g} times the model: is it another quantity, or is the start far off?"
        else:
            continue
        found.append(f"series.{name}: column {column!r} {problem}")
    return found


def _unit(factor: float) -> str:
    """Return the factor between two units that is near to one; empty for none."""
    pairs = [(each, what) for known, what in _KNOWN_FACTORS for each in (known, 1.0 / known)]
    size, what = min(pairs, key=lambda pair: abs(np.log(factor / pair[0])))
    return f"{size:.4g} ({what})" if abs(np.log(factor / size)) < _NEAR_UNIT else ""


def _nearer(entry: Series, data: Array, model: Array) -> str:
    """Return the column whose numbers are much nearer to the model's than the measured ones.

    Its own name says that the measured ones are, with the other sign.
    """

    def away(values: Array) -> float:
        return float(np.linalg.norm(values - model) / np.linalg.norm(model))

    own = away(data)
    others = {entry.table.measured: -data}
    for name, values in entry.others.items():
        others[name] = np.array(values) - (values[0] if entry.table.relative else 0.0)
    name = min(others, key=lambda each: away(others[each]))
    return name if own > _OFF and away(others[name]) < own / _NEARER else ""
