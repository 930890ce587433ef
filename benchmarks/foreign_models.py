"""MJCF files of others: each carries a soft robot for a few ticks, or is refused by name.

    python benchmarks/foreign_models.py FOLDER ...

Looked at are all MJCF files of the folders, such as an unpacked wheel of another project, that MuJoCo itself
compiles. The soft robot hangs on the last body with a name. A refusal with a remedy is followed: another
integrator, contact switched off.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import mujoco
import numpy as np

import cosim
from cosim.errors import CosimError, InputError

TICKS = 10


def outcome(path: Path) -> str:
    """Return how it goes with a file: attached, refused, crashed."""
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compile()
    except ValueError:
        return "not a model: MuJoCo refuses it"
    named = [body.name for body in reversed(spec.bodies) if body.name and body.name != "world"]
    if not named:
        return "not a model: no body has a name"
    followed: list[str] = []
    overrides: dict[str, object] = {"fidelity": "rigid"}
    while True:
        try:
            _take(spec, named[0], overrides)
        except InputError as error:
            words = str(error)
            if "RK4" in words and "RK4" not in followed:
                spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
                followed.append("RK4")
            elif "contact.enabled" in words and "contact" not in followed:
                overrides["contact.enabled"] = False
                followed.append("contact")
            else:
                return f"refused: {words:.100}"
        except CosimError as error:
            return f"fails by name: {error!s:.100}"
        except Exception as error:
            return f"crashed: {type(error).__name__}: {error!s:.100}"
        else:
            return "attached" + (f", {' and '.join(followed)} refused first" if followed else "")


def _take(spec: mujoco.MjSpec, at: str, overrides: dict[str, object]) -> None:
    here = spec.copy()
    soft = cosim.attach(here, at, "square_core", overrides=overrides)
    model = here.compile()
    data = mujoco.MjData(model)
    soft.step(model, data, TICKS)
    assert np.isfinite(soft.film).all(), "the film is not finite"
    assert np.isfinite(data.qpos).all(), "the scene is not finite"
    assert soft.ledger.momentum_error < 1e-10, f"momentum is off by {soft.ledger.momentum_error:.2g}"


if __name__ == "__main__":
    counts: Counter[str] = Counter()
    for folder in map(Path, sys.argv[1:]):
        for path in sorted(folder.rglob("*.xml")):
            found = outcome(path)
            counts[found.split(":")[0]] += 1
            print(f"{path.relative_to(folder)}: {found}", flush=True)
    print(", ".join(f"{count} {what}" for what, count in counts.most_common()))
