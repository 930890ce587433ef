"""Damaged caches: a kept section model, damaged in 205 ways.

    python benchmarks/faults/damaged_caches.py [SEED]

What is kept is damaged in its bits, torn, emptied, made longer, replaced by other files, made unreadable, or
made up anew with other contents. Each has to end in a warning and the same result as if nothing was kept.
"""

from __future__ import annotations

import io
import os
import pickle
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from cosim.base.files import keep
from cosim.build import soft_model
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.reduced.section_model import SectionModel
from cosim.reduced.sections.section_energy import PressureSpline

WAYS = 205
Random = np.random.Generator


def damage(path: Path, random: Random) -> str:
    """Damage a file; return how."""
    data = path.read_bytes()
    body = data.partition(b"\n")[2]
    stream = io.BytesIO()
    np.savez(stream, energy=np.zeros(3))
    ways: dict[str, Callable[[], Any]] = {
        "bits": lambda: path.write_bytes(_flipped(data, random)),
        "torn": lambda: path.write_bytes(data[: int(random.integers(len(data)))]),
        "empty": lambda: path.write_bytes(b""),
        "longer": lambda: path.write_bytes(data + bytes(int(random.integers(1, 99)))),
        "without its mark": lambda: path.write_bytes(body),
        "pickle": lambda: path.write_bytes(pickle.dumps({"a": 1})),
        "text": lambda: path.write_bytes(b"[1, 2, {}]"),
        "brackets": lambda: path.write_bytes(b"[" * 10**5),
        "zeros": lambda: path.write_bytes(bytes(len(data))),
        "another archive": lambda: keep(path, stream.getvalue()),
        "other bits, marked": lambda: keep(path, body[: int(random.integers(1, len(body)))]),
        "other figures, marked": lambda: keep(path, b"[{}]"),
        "objects, marked": lambda: keep(path, pickle.dumps([object()])),
        "a directory": lambda: _replaced_by_a_directory(path),
    }
    name = str(random.choice(list(ways)))
    ways[name]()
    return name


def _replaced_by_a_directory(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _flipped(data: bytes, random: Random) -> bytes:
    changed = bytearray(data)
    for _ in range(int(random.integers(1, 9))):
        changed[int(random.integers(len(data)))] ^= 1 << int(random.integers(8))
    return bytes(changed)


def made_up_model(random: Random) -> SectionModel:
    """Return a section model of numbers without meaning, but near its film."""
    sizes = {"energy": (9, 4, 30), "length": (9, 4), "gas": (9,), "nodes": (9, 20, 2, 4)}
    sizes |= {"held_out": (5, 9), "tips": (3, 3)}
    arrays = {name: random.random(size) for name, size in sizes.items()}
    arrays["tips"][:, 1] *= 0.01 * arrays["tips"][:, 2]
    return SectionModel(PressureSpline(4e4, 6), **arrays, samples=7, failures=1)


def section_result(scenario: Scenario) -> bytes:
    """Return the bits of the section model that a scenario gets."""
    model = soft_model.section_model(scenario)
    return b"".join(getattr(model, name).tobytes() for name in ("energy", "length", "gas", "nodes"))


def faults_of(path: Path, result: Callable[[], bytes], random: Random, ways: int) -> list[str]:
    """Return what went wrong with a kept file damaged in so many ways."""
    expected, found = result(), []
    for _ in range(ways):
        if path.is_dir():
            path.rmdir()
        result()
        how = damage(path, random)
        try:
            with warnings.catch_warnings(record=True) as warned:
                warnings.simplefilter("always")
                same = result() == expected
        except Exception as error:  # that is what is looked for
            found.append(f"{path.name}, {how}: {type(error).__name__}: {error}")
            continue
        if not same:
            found.append(f"{path.name}, {how}: another result")
        elif len(warned) != 1:
            found.append(f"{path.name}, {how}: {len(warned)} warnings")
    return found


def try_all(seed: int, folder: Path, ways: int = WAYS) -> list[str]:
    """Return what went wrong with kept section models; `folder` becomes the user's cache."""
    random = np.random.default_rng(seed)
    os.environ["XDG_CACHE_HOME"] = str(folder)
    scenario = load_scenario("ur5e_hexagon_arm")
    model = made_up_model(random)
    replaced: Any = soft_model
    replaced.build_model = lambda *_: model
    section_result(scenario)
    (section,) = (folder / "cosim").glob("section_*")
    return faults_of(section, lambda: section_result(scenario), random, ways)


def main(seed: int = 1) -> int:
    """Damage the cache in all ways; return 1 if there was a fault."""
    with tempfile.TemporaryDirectory() as folder:
        faults = try_all(seed, Path(folder))
    print("\n".join([*faults, f"{WAYS} damaged caches: {len(faults)} faults"]))
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
