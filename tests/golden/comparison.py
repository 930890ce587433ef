"""How far a golden figure may move: by its unit, or by the spread of runs that start 1 um apart.

Of `spool` and `two_arms` the spread also covers code for AVX2 and for AVX-512, which rounds in another way:
cables of the first slide back at other ticks.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Final

FOLDER: Final = Path(__file__).resolve().parent / "recorded"
SPREADS: Final = 3.0
"""Spreads of runs that start 1 um apart, within which a run may move."""
RULES: Final = {
    "_m": (0.0, 2e-5),
    "_depth_m": (2e-3, 1e-7),
    "_m3": (5e-4, 1e-10),
    "_N": (2e-3, 1e-3),
    "_Nm": (2e-3, 1e-4),
    "_Ns": (2e-3, 1e-4),
    "_J": (2e-3, 1e-5),
    "_Pa": (5e-4, 1.0),
    "_rad": (0.0, 4e-5),  # 0.02 mm at 0.5 m
    "_quaternion": (0.0, 2e-5),  # half of that
    "quaternion": (0.0, 2e-5),
    "_rad_s": (2e-3, 1e-4),
    "_direction": (0.0, 2e-4),  # 0.02 mm at 0.1 m
    "": (2e-3, 1e-9),
}
"""By the longest ending of a name that fits: a share of the figure's vector, and the least tolerance."""
_INDEX: Final = re.compile(r"(\.\d+)+$")


@dataclass(frozen=True)
class Golden:
    """Recorded figures of a run.

    Args:
        values: by name.
        spreads: of runs that start 1 um apart, where they are what decides.
    """

    values: dict[str, float]
    spreads: dict[str, float] = field(default_factory=dict)

    def tolerance(self, name: str) -> float:
        """Return how far a figure may be off."""
        stem = _INDEX.sub("", name)
        if name.startswith("frames of") or stem.endswith("ticks"):
            return 0.0
        if stem.endswith("_s") and not stem.endswith(("m_s", "rad_s")):
            least, share = (
                1.01 * next((v for n, v in self.values.items() if n.endswith("run.tick_s")), 0.0),
                0.0,
            )
        else:
            share, least = RULES[max(filter(stem.endswith, RULES), key=len)]
        norm = math.hypot(*(v for n, v in self.values.items() if _INDEX.sub("", n) == stem))
        return max(least, share * norm, SPREADS * self.spreads.get(name, 0.0))

    def differences(self, found: dict[str, float]) -> Iterator[tuple[float, str]]:
        """Yield for each figure that is missing, new, or too far off: by how many tolerances, and a line."""
        for name in sorted(self.values.keys() | found.keys()):
            if name not in found or name not in self.values:
                yield math.inf, f"{name}: {'gone' if name not in found else 'new'}"
                continue
            off, most = found[name] - self.values[name], self.tolerance(name)
            if not abs(off) <= most:
                times = abs(off) / most if most else math.inf
                yield times, f"{name}: {self.values[name]:.9g}, off by {off:.3g}, may be {most:.2g}"


def read(name: str) -> Golden:
    """Return the figures that are stored for a run."""
    return Golden(**json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8")))


def write(name: str, runs: list[dict[str, float]]) -> None:
    """Store the figures of the first run and, where they count, the spreads of all: they start 1 um apart."""
    golden = Golden({key: float(f"{value:.12g}") for key, value in runs[0].items()})
    for key in golden.values:
        values = [run.get(key, math.inf) for run in runs]
        spread = max(values) - min(values)
        if SPREADS * spread > golden.tolerance(key):
            golden.spreads[key] = float(f"{spread:.3g}")
    FOLDER.mkdir(exist_ok=True)
    text = json.dumps(asdict(golden), indent=0) + "\n"
    (FOLDER / f"{name}.json").write_text(text, encoding="utf-8")
