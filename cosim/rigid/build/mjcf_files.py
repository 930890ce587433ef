"""Reads MJCF files, which may be anybody's: bounded before MuJoCo sees them, and finite once it has.

Turns MuJoCo's warnings into errors, and keeps it from what would outlast a scene.

Whether all numbers of a compiled model are finite, and whose those are that are not.
"""

import math
import re
import struct
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Never, final

import mujoco
import numpy as np

from cosim.base.files import note_file
from cosim.base.frames import Array
from cosim.base.resources import is_file
from cosim.config.xml_files import check_depth, read_xml
from cosim.errors import InputError, InstabilityError


def set_up_engine() -> None:
    """Keep MuJoCo from writing warnings to a file in the working directory, and from keeping meshes.

    It would take a mesh that it has read before for the one of a file that was rewritten within a second.
    """
    mujoco.set_mju_user_warning(_ignore)
    mujoco.mj_setCacheCapacity(mujoco.mj_getCache(), 0)


def raise_instability(data: mujoco.MjData) -> Never:
    """Raise what MuJoCo has warned of since the data was made.

    Raises:
        InstabilityError: the state is no longer finite, or a mass matrix is singular.
    """
    kind = int(np.flatnonzero(data.warning.number)[0])
    moving = data.time > 0.0  # statics take no steps
    advice = "Use a shorter tick_s, or check" if moving else "Check"
    raise InstabilityError(
        f"the rigid scene became unstable{f' at {data.time:.4f} s' if moving else ''}: "
        f"{mujoco.mju_warningText(kind, data.warning.lastinfo[kind])} {advice} masses and loads."
    )


def _ignore(_message: str) -> None:
    """Take a warning; `raise_instability` reports it from the counts."""


def check_finite(model: mujoco.MjModel) -> None:
    """Check every number of a model, whatever arrays this version of MuJoCo has.

    Raises:
        ValueError: one is not finite; the message names what it belongs to and its attribute.
    """
    wrong = {name: values for name, values in _arrays(model) if not np.isfinite(values).all()}
    if not wrong:
        return
    # names of what MuJoCo works out from the others end in 0
    name = min(wrong, key=lambda name: (name.endswith("0"), name))
    values = wrong[name]
    row = int(np.argwhere(~np.isfinite(values))[0][0]) if values.ndim else 0
    shown = " ".join(f"{value:g}" for value in np.atleast_1d(values[row] if values.ndim else values).ravel())
    owner, attribute = _owner(model, name, row, len(np.atleast_1d(values)))
    raise ValueError(f"{owner}{attribute} is {shown[:80]}; every number must be finite")


def _arrays(part: Any, prefix: str = "") -> Iterator[tuple[str, Array]]:
    """Yield names and values of all numbers of a model, or of one of its parts such as the options."""
    for name in dir(part):
        value = None if name.startswith("_") else getattr(part, name)
        if isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype.kind == "f"):
            yield f"{prefix}{name}", np.asarray(value)
        elif type(value).__module__.startswith("mujoco") and not callable(value):
            yield from _arrays(value, f"{prefix}{name}.")


def _owner(model: mujoco.MjModel, name: str, row: int, rows: int) -> tuple[str, str]:
    """Return whose number it is, as the beginning of a sentence, and the attribute that holds it."""
    kind, _, attribute = name.partition("_")
    if kind in ("dof", "qpos0", "qpos"):
        joints = model.jnt_dofadr if kind == "dof" else model.jnt_qposadr
        kind, row, rows = "jnt", int(np.searchsorted(joints, row, side="right")) - 1, model.njnt
    find = getattr(model, kind, None)
    if find is None:
        return "", name
    if rows != getattr(model, f"n{kind}", rows):  # such as the points of all meshes, one after the other
        first = getattr(model, f"{name}adr", getattr(model, f"{kind}_adr", None))
        if first is None:
            return "", name
        row = int(np.searchsorted(first, row, side="right")) - 1
    return f"{kind.replace('jnt', 'joint')} {find(row).name or row!r}: ", attribute or name


MOST_ELEMENTS: Final = 4_000
MOST_POINTS: Final = 1_000_000
"""Of a height field or a texture; the points of a mesh that MuJoCo makes up count `_POINT_OF_MESH` times."""

_COUNTED: Final = ("replicate", "composite", "flexcomp")
_SIZES: Final = (("nrow", "ncol"), ("width", "height"))
_POINT_OF_MESH: Final = 100
_COUNTING: Final = -1
_FOLDERS: Final = ("meshdir", "assetdir", "texturedir")


@final
@dataclass(frozen=True)
class MjcfFile:
    """What MuJoCo has read.

    Args:
        spec: as the file says, compiled.
        model: of it; all its numbers are finite.
        files: all that it was read from, as far as they are found: includes, meshes, textures.
    """

    spec: mujoco.MjSpec
    model: mujoco.MjModel
    files: tuple[Path, ...]


def read_mjcf_file(path: Path, kind: str) -> MjcfFile:
    """Return what an MJCF file describes.

    Args:
        path: of the file.
        kind: what it is of, for messages.

    Raises:
        InputError: it is no MJCF, describes more than `MOST_ELEMENTS` elements or `MOST_POINTS` points, holds
            a number that is not finite, or MuJoCo refuses it.
    """
    tag = read_xml(path, kind).tag
    if tag != "mujoco":
        hint = "; a URDF ends in .urdf" if tag == "robot" else ""
        raise InputError(f"{kind} file {path} is no MJCF: its first element is <{tag}>, not <mujoco>{hint}")
    contents = _Contents(path, kind)
    contents.count(path.resolve())
    set_up_engine()
    with refusals(f"{kind} file {path}"):
        spec = mujoco.MjSpec.from_file(str(path))
    model = compiled(spec, f"{kind} file {path}")
    for file in contents.named:
        note_file(file)  # MuJoCo has read it by itself
    return MjcfFile(spec, model, (path, *contents.named))


def compiled(spec: mujoco.MjSpec, where: str, *, lines: bool = True) -> mujoco.MjModel:
    """Return the model of a specification.

    Args:
        spec: read from a file.
        where: see `refusals`, as `lines`.

    Raises:
        InputError: MuJoCo refuses it, or a number of it is not finite.
    """
    with refusals(where, lines=lines):
        model = spec.compile()
    try:
        check_finite(model)
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None
    return model


@contextmanager
def refusals(where: str, *, lines: bool = True) -> Iterator[None]:
    """Tell of which file MuJoCo refuses something.

    Args:
        where: the kind of the file, and its path.
        lines: whether MuJoCo counts the lines of the file itself.

    Raises:
        InputError: in place of a ValueError.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what later versions will not know any more
            yield
    except ValueError as error:
        text = str(error).replace("\n", ", ")
        text = text if lines else re.sub(r", line \d+", "", text)
        raise InputError(f"{where}: MuJoCo refuses it: {text.strip(' ,'):.500}") from None


@final
class _Contents:
    """How much an MJCF describes with the files that it names; `named` are those that are found.

    Args:
        top: the file itself, besides which files are looked for.
        kind: what it is of, for messages.
    """

    def __init__(self, top: Path, kind: str) -> None:
        self.named: dict[Path, None] = {}
        self._top, self._kind = top, kind
        self._counts: dict[Path, float] = {}

    def count(self, path: Path) -> float:
        """Return how many elements a file becomes, once all of them have been checked."""
        where = f"{self._kind} file {path}"
        self._counts[path] = _COUNTING
        root = self._expanded(path)
        compilers = root.iter("compiler")
        folders = list(dict.fromkeys(["", *(one.get(key, "") for one in compilers for key in _FOLDERS)]))
        models = {}
        for element in root.iter():
            places = [self._found(text, path, folders) for key, text in element.items() if key[:4] == "file"]
            for place in filter(None, places):
                _check_points(element, _pixels(place), where)
                if element.tag != "model":
                    continue
                inner = self._counts[place] if place in self._counts else self.count(place)
                if inner == _COUNTING:
                    raise InputError(f"{where}: {_label(element)} is this file, or one that leads back to it")
                models[element.get("name", place.stem)] = inner
        total, waiting = 0.0, [(root, 1.0)]
        while waiting:
            element, times = waiting.pop()
            check_numbers(element, where)
            _check_asked(element, where)
            if element.tag in _COUNTED:
                times *= _product(element, "count")
            total += times * (1 + models.get(element.get("model", ""), 0))
            if total > MOST_ELEMENTS:
                raise InputError(
                    f"{where} describes more than {MOST_ELEMENTS} elements, {_label(element)} among them; no "
                    "more are read: leave out what nothing touches, or join shapes to meshes"
                )
            waiting += [(child, times) for child in element]
        self._counts[path] = total
        return total

    def _expanded(self, path: Path) -> ElementTree.Element:
        """Return the top element of a file, with what it includes within the elements that do."""
        root = read_xml(path, self._kind)
        waiting, included = [(root, path)], {path.resolve()}
        while waiting:
            element, here = waiting.pop()
            place = self._found(element.get("file"), here, [""]) if element.tag == "include" else None
            if place is not None and place not in included:  # MuJoCo refuses what is included twice
                included.add(place)
                element.extend(read_xml(place, self._kind))
                here = place
            waiting += [(child, here) for child in element]
        check_depth(root, f"{self._kind} file {path}")
        return root

    def _found(self, file: str | None, path: Path, folders: list[str]) -> Path | None:
        """Return the path of a file that an element names; None where there is none."""
        near = [
            base / folder / (file or "") for base in (path.parent, self._top.parent) for folder in folders
        ]
        place = next((candidate.resolve() for candidate in near if file and is_file(candidate)), None)
        if place is not None and place != self._top.resolve():
            self.named[place] = None
        return place


def check_numbers(element: ElementTree.Element, where: str) -> None:
    """Raise InputError where a number of an element is not finite."""
    for key, text in element.items():
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            continue  # no numbers
        if not all(map(math.isfinite, values)):
            raise InputError(
                f"{where}: {_label(element)}: {key} is {text!r:.80}; every number must be finite"
            )


def _check_asked(element: ElementTree.Element, where: str) -> None:
    """Check that an element asks for no more points than are read."""
    if element.tag == "mesh":
        points = _POINT_OF_MESH * _product(element, "params") ** 2
    else:
        points = max(_product(element, *keys) for keys in _SIZES)
    _check_points(element, points, where)


def _pixels(path: Path) -> float:
    """Return how many pixels a file has; 1 where it is no PNG."""
    with suppress(OSError), path.open("rb") as stream:
        head = stream.read(24)
        if head[12:16] == b"IHDR" and len(head) == 24:
            return float(math.prod(struct.unpack(">II", head[16:])))
    return 1.0


def _check_points(element: ElementTree.Element, points: float, where: str) -> None:
    if points > MOST_POINTS:
        raise InputError(
            f"{where}: {_label(element)} has more than {MOST_POINTS} points; no more are read: "
            "make it coarser"
        )


def _product(element: ElementTree.Element, *keys: str) -> float:
    """Return the product of the numbers above 1 in some attributes; what is no number counts as 1."""
    product = 1.0
    for word in " ".join(element.get(key, "") for key in keys).split():
        with suppress(ValueError):
            product *= max(1.0, float(word))
    return product


def _label(element: ElementTree.Element) -> str:
    """Return how to call an element in a message."""
    shown = ("name", "count", "file", *(key for keys in _SIZES for key in keys))
    known = [f'{key}="{text:.40}"' for key in shown if (text := element.get(key)) is not None]
    return f"<{' '.join((element.tag, *known))}>"
