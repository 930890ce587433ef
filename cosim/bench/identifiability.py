"""Determines before a fit which parameters the data can identify. The derivatives of all rows, divided by
their noise, are decomposed by singular values: along a direction of parameters with singular value s, the
data determine the value with the standard deviation 1 / s. A direction is not identifiable if its 95 %
interval is no smaller than the bounds, or larger than 25 %. Parameters with positive bounds are represented
by their logarithms, so a direction is a product of powers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.config.benches import UnknownTable

_LARGEST_HALF: Final = 0.25  # half of the relative 95 % interval of a determined product, at most
_WITHOUT: Final = 0.1  # standard deviations, by which a value without effect moves the data at most
_SAME: Final = 0.1  # exponents below are left out of products


@final
@dataclass(frozen=True)
class Direction:
    """A combination of parameters, with its uncertainty.

    Args:
        text: product of powers, or sum.
        sd: standard deviation; of a product the relative one.
        determined: whether the data determine it.
    """

    text: str
    sd: float
    determined: bool


@final
@dataclass(frozen=True)
class Identifiability:
    """Result of the check whether the data determine the parameters.

    Args:
        without_effect: keys that change no row by more than its noise.
        directions: all combinations, with the best determined first.
        advice: remedies for undetermined combinations; empty if there are none.
    """

    without_effect: tuple[str, ...]
    directions: tuple[Direction, ...]
    advice: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Whether the data determine every parameter."""
        return not self.without_effect and all(each.determined for each in self.directions)

    def lines(self) -> list[str]:
        """Return the result as lines for people."""
        lines = [
            f"{key}: has no effect on these data beyond their noise; leave it out"
            for key in self.without_effect
        ]
        for each in self.directions:
            known = (
                f"known to {100.0 * 1.96 * each.sd:.3g} %" if each.determined else "NOT known from these data"
            )
            lines.append(f"{each.text}: {known}")
        return [*lines, *self.advice]


def identifiability(
    scaled: Array, widths: Array, unknowns: Sequence[UnknownTable], further: dict[str, Array]
) -> Identifiability:
    """Check which parameters the data determine.

    Args:
        scaled: (rows, parameters), derivatives over noise, by the fitted variables (logarithms or values).
        widths: (parameters,), from low to high, of the fitted variables.
        unknowns: parameters.
        further: derivatives over noise (rows, parameters) of quantities that could be measured as well, by
            name.
    """
    moved = np.abs(scaled).max(axis=0) * widths if len(scaled) else np.zeros(len(unknowns))
    idle = moved < _WITHOUT
    some = [entry for entry, without in zip(unknowns, idle, strict=True) if not without]
    found = _directions(scaled[:, ~idle], widths[~idle], some)
    advice = [_remedy(along, some) for along, direction in found if not direction.determined]
    if advice:
        more = {
            name: _directions(np.concatenate([scaled, rows])[:, ~idle], widths[~idle], some)
            for name, rows in further.items()
        }
        enough = [name for name, those in more.items() if all(each.determined for _, each in those)]
        best = min(
            enough, key=lambda name: max(direction.sd for _, direction in more[name]), default="no other"
        )
        advice.append(
            f"{best} measured in the same rows, to 0.1 mm or 0.1 ml, would determine it"
            if enough
            else "no other length, tip position or volume, measured in the same rows, would determine it"
        )
    return Identifiability(
        tuple(entry.key for entry, without in zip(unknowns, idle, strict=True) if without),
        tuple(direction for _, direction in found), tuple(advice),
    )  # fmt: skip


def _directions(
    scaled: Array, widths: Array, unknowns: Sequence[UnknownTable]
) -> list[tuple[Array, Direction]]:
    """Return all combinations with their unit vectors (parameters,), the best determined first."""
    names = [entry.key.removeprefix("soft_robot.") for entry in unknowns]
    products = [entry.low > 0.0 for entry in unknowns]
    _, sizes, turned = np.linalg.svd(scaled, full_matrices=True)
    sizes, found = np.concatenate([sizes, np.zeros(len(names) - len(sizes))]), []
    for size, along in zip(sizes, turned, strict=True):
        room = float((widths / np.maximum(np.abs(along), 1e-12)).min())
        sd = 1.0 / max(float(size), 1e-300)
        determined = 1.96 * sd < min(0.5 * room, _LARGEST_HALF if all(products) else np.inf)
        found.append((along, Direction(_text(along, names, products), sd, determined)))
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


def _remedy(along: Array, unknowns: Sequence[UnknownTable]) -> str:
    """Return a message that names the undetermined parameters and a remedy."""
    parts = [
        entry.key.removeprefix("soft_robot.")
        for entry, power in zip(unknowns, along, strict=True)
        if abs(power) > _SAME * np.abs(along).max()
    ]
    if len(parts) == 1:
        return f"the data do not determine {parts[0]} within its bounds; set a prior_sd, or measure more"
    return (
        f"the data cannot distinguish {' from '.join(parts)}, only the combinations listed as known; give "
        "one of them a fixed value (leave it out), a prior_sd, or measure more"
    )
