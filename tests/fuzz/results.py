"""Damaged result folders: of a run, of one that was interrupted, and of a sweep, each with a file damaged.

A file is torn, emptied, overwritten with noise, taken away, replaced by a folder, a link or another file.
JSON gets deep, loses keys, has other kinds. Tables lose, repeat or exchange rows, columns, digits.
Whatever reads the folder then has the same values as before, or refuses it in an error of cosim. Another
traceback, a wait above 10 s, and other values are findings.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import signal
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, final

import numpy as np
import pyarrow as pa
from pyarrow import parquet

import cosim
from cosim.cli.main import main as command_line
from cosim.results.run_columns import COLUMNS, FRAME_COLUMNS
from tests.fuzz.checkpoints import interrupted_statics
from tests.fuzz.forgeries import places_of
from tests.fuzz.verdict import FINDING, Trial, Verdict, traceback_verdict

Random = np.random.Generator
LONGEST_S: Final = 10.0
SCENARIO: Final = "three_unit_inflation"
STUDY: Final[dict[str, Any]] = {
    "scenario": SCENARIO,
    "set": {"phase.start.increments": 1, "phase.inflate.increments": 1},
    "grid": {"phase.inflate.pressure_Pa": [8e3, 9e3]},
}
DEEP: Final = b"[" * 10**5 + b"]" * 10**5


class Hang(BaseException):
    """Something took longer than `LONGEST_S`; no `except Exception` takes it."""


def damage(folder: Path, random: Random) -> str:
    """Damage a file of a folder; return which, and how."""
    files = sorted(path for path in folder.iterdir() if path.is_file())
    path = files[int(random.integers(len(files)))]
    ways = [*_ANY]
    if path.suffix in (".json", ".jsonl"):
        ways += 2 * [*_JSON]
    if path.suffix == ".parquet":
        ways += 2 * [*_TABLE]
    name = ways[int(random.integers(len(ways)))]
    if name in _TABLE:
        table = parquet.read_table(path)
        parquet.write_table(_TABLE[name](table, random), path)
    elif name in _JSON:
        lines = path.read_text(encoding="utf-8").splitlines()
        texts = lines if path.suffix == ".jsonl" else ["\n".join(lines)]
        place = int(random.integers(len(texts)))
        if texts[place].strip():
            texts[place] = _JSON[name](json.loads(texts[place]), random)
        path.write_text("\n".join(texts) + "\n", encoding="utf-8")
    else:
        _ANY[name](path, random)
    return f"{path.name}: {name}"


def _noise(path: Path, random: Random) -> None:
    data = bytearray(path.read_bytes())
    start, count = int(random.integers(len(data))), int(random.integers(16, 200))
    data[start : start + count] = random.bytes(count)
    path.write_bytes(bytes(data))


def _folder(path: Path, _random: Random) -> None:
    path.unlink()
    path.mkdir()


def _linked(target: Callable[[Path, Random], str]) -> Callable[[Path, Random], None]:
    def change(path: Path, random: Random) -> None:
        to = target(path, random)
        path.unlink(missing_ok=True)
        path.symlink_to(to)

    return change


def _moved(path: Path, _random: Random) -> str:
    elsewhere = path.parent.parent / f"{path.parent.name}-{path.name}"
    shutil.move(path, elsewhere)
    return str(elsewhere)


def _beside(path: Path, random: Random) -> str:
    names = sorted(entry.name for entry in path.parent.iterdir() if entry != path)
    return str(names[int(random.integers(len(names)))])


def _other(path: Path, random: Random) -> None:
    path.write_bytes((path.parent / _beside(path, random)).read_bytes())


_ANY: Final[dict[str, Callable[[Path, Random], Any]]] = {
    "torn": lambda path, random: os.truncate(path, int(random.integers(path.stat().st_size))),
    "empty": lambda path, _random: path.write_bytes(b""),
    "noise": _noise,
    "nothing but noise": lambda path, random: path.write_bytes(random.bytes(5000)),
    "more at its end": lambda path, random: path.write_bytes(path.read_bytes() + random.bytes(50)),
    "gone": lambda path, _random: path.unlink(),
    "a folder": _folder,
    "a link to nowhere": _linked(lambda _path, _random: "nowhere"),
    "a link to itself": _linked(lambda path, _random: path.name),
    "a link to itself elsewhere": _linked(_moved),
    "a link to another": _linked(_beside),
    "another's contents": _other,
    "deep": lambda path, _random: path.write_bytes(DEEP),
}


def _without_a_key(value: Any, random: Random) -> str:
    places = places_of(value)
    container, key = places[int(random.integers(len(places)))]
    del container[key]
    return json.dumps(value)


def _of_another_kind(value: Any, random: Random) -> str:
    kinds: list[Any] = [None, True, -1, 10**400, [], {}, "text", [[]], {"a": 1}, 1e308]
    places = places_of(value)
    container, key = places[int(random.integers(len(places)))]
    others = [kind for kind in kinds if type(kind) is not type(container[key])]
    container[key] = others[int(random.integers(len(others)))]
    return json.dumps(value)


_JSON: Final[dict[str, Callable[[Any, Random], str]]] = {
    "without a key": _without_a_key,
    "without a key of its own": lambda value, random: json.dumps(
        {key: item for key, item in value.items() if key != str(random.choice(sorted(value)))}
    ),
    "of another kind": _of_another_kind,
    "deep within": lambda value, random: json.dumps(value)[:-1] + ', "x": ' + DEEP.decode() + "}",
    "not a table": lambda value, _random: json.dumps([value]),
}


def _dropped(table: pa.Table, random: Random) -> pa.Table:
    return table.remove_column(int(random.integers(table.num_columns)))


def _rounded(table: pa.Table, random: Random) -> pa.Table:
    places = [k for k in range(table.num_columns) if pa.types.is_float64(table.schema.field(k).type)]
    if not places:
        return table.slice(1)
    place = places[int(random.integers(len(places)))]
    field = table.schema.field(place).with_type(pa.float32())
    return table.set_column(place, field, table[place].cast(pa.float32()))


_TABLE: Final[dict[str, Callable[[pa.Table, Random], pa.Table]]] = {
    "fewer rows": lambda table, random: table.slice(0, int(random.integers(table.num_rows))),
    "without the first row": lambda table, _random: table.slice(1),
    "a row twice": lambda table, _random: pa.concat_tables([table, table.slice(table.num_rows - 1)]),
    "rows in another order": lambda table, _random: table.take([*range(1, table.num_rows), 0]),
    "a column less": _dropped,
    "rounded": _rounded,
    "says nothing of itself": lambda table, _random: table.replace_schema_metadata(None),
}


@contextlib.contextmanager
def _bounded() -> Iterator[None]:
    """Raise `Hang` in the middle of what takes too long."""

    def late(_number: int, _frame: Any) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, LONGEST_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def outcome_of(act: Callable[[], bool]) -> Verdict:
    """Return what became of something that reads a folder."""
    try:
        with _bounded(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return Verdict("the same", "") if act() else Verdict(FINDING, "other values")
    except cosim.CosimError as error:
        return Verdict("refused", str(error))
    except Hang:
        return Verdict(FINDING, f"takes more than {LONGEST_S:g} s")
    except Exception as error:  # that is what is looked for
        return traceback_verdict(error)


def _said(*words: str) -> int:
    """Return the exit code of a command."""
    with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
        code = command_line(words)
    if code in (1, 2, 3):
        raise cosim.InputError(f"exit code {code}")
    return code


def _arrays(result: cosim.RunResult, *, but: tuple[str, ...] = ()) -> dict[str, bytes]:
    names = [name for name in (*COLUMNS, *FRAME_COLUMNS) if name not in but]
    return {name: getattr(result, name).tobytes() for name in names}


class Folders:
    """Whole folders of each kind, and what reads them.

    Args:
        place: where they are made.
    """

    def __init__(self, place: Path) -> None:
        self.place = place
        changes = {"phase.start.increments": 2, "phase.inflate.increments": 4}
        self._result = cosim.run(SCENARIO, overrides=changes, out=place / "run")
        self._csv = self._exported(place / "run")
        interrupted = interrupted_statics(place)
        resumed = shutil.copytree(interrupted, place / "resumed")
        _said("run", "--resume", str(resumed), "--quiet", "--no-recording")
        self._resumed = _arrays(cosim.load_run(resumed), but=("tick_wall_s",))
        self._swept(place / "sweep")
        self._table = cosim.open_sweep(place / "sweep")
        self.acts: dict[str, dict[str, Callable[[Path], bool]]] = {
            "run": {"load": self._loads, "export": lambda folder: self._exported(folder) == self._csv},
            "statics": {"load": self._is_interrupted, "resume": self._resumes},
            "sweep": {"open": self._opens, "sweep": self._sweeps, "open again": self._opens},
        }

    def _loads(self, folder: Path) -> bool:
        found = cosim.load_run(folder)
        found._repr_html_()
        repr(found)
        written = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        return _arrays(found) == _arrays(self._result) and found.summary == written

    def _exported(self, folder: Path) -> bytes:
        out = folder.with_name(f"{folder.name}-csv")
        _said("export", str(folder), "--csv", "--vtk", "--out", str(out))
        return b"".join(
            path.read_bytes() for path in sorted(out.iterdir()) if path.suffix in (".csv", ".vtp")
        )

    def _is_interrupted(self, folder: Path) -> bool:
        return cosim.load_run(folder).status == "interrupted"

    def _resumes(self, folder: Path) -> bool:
        _said("run", "--resume", str(folder), "--quiet", "--no-recording")
        return _arrays(cosim.load_run(folder), but=("tick_wall_s",)) == self._resumed

    def _swept(self, folder: Path) -> None:
        with ThreadPoolExecutor(1) as engine:
            cosim.sweep(STUDY, out=folder, engine=engine)

    def _sweeps(self, folder: Path) -> bool:
        self._swept(folder)
        return bool(cosim.open_sweep(folder).equals(self._table))

    def _opens(self, folder: Path) -> bool:
        return bool(cosim.open_sweep(folder).equals(self._table))


@final
class Results(Trial):
    """Folders of a run, of one that was interrupted, and of a sweep, in turn."""

    def begin(self, folder: Path) -> None:
        self._place, self._folders = folder, Folders(folder)

    def tried(self, seed: int, folder: Path) -> Verdict:
        kinds = list(self._folders.acts)
        kind, random = kinds[seed % len(kinds)], np.random.default_rng(seed)
        damaged = Path(shutil.copytree(self._place / kind, folder / kind))
        how = f"{kind}/{damage(damaged, random)}"
        last = Verdict("the same", "")
        for name, act in self._folders.acts[kind].items():
            last = outcome_of(partial(act, damaged))
            if last.kind == FINDING:
                return replace(last, case=f"{how}: {name}")
        return replace(last, case=how)
