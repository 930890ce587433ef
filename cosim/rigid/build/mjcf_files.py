"""Reads MJCF files, which may come from anybody. Elements and points are counted before MuJoCo compiles a
file, and all numbers of the compiled model must be finite.
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
from typing import Final, final

import mujoco

from cosim.base.files import note_file
from cosim.base.resources import is_file
from cosim.config.xml_files import check_depth, read_xml
from cosim.errors import InputError
from cosim.rigid.build.engine import check_finite, set_up_engine

MOST_ELEMENTS: Final = 4_000
MOST_POINTS: Final = 1_000_000
"""Of a height field or a texture; a point of a mesh that MuJoCo generates counts `_POINT_OF_MESH` times."""

_COUNTED: Final = ("replicate", "composite", "flexcomp")
_SIZES: Final = (("nrow", "ncol"), ("width", "height"))
_POINT_OF_MESH: Final = 100
_COUNTING: Final = -1
_FOLDERS: Final = ("meshdir", "assetdir", "texturedir")


@final
@dataclass(frozen=True)
class MjcfFile:
    """The content of an MJCF file.

    Args:
        spec: MuJoCo's specification of the file, compiled.
        model: its compiled model; all numbers are finite.
        files: the file and the files that it names: includes, meshes, textures.
    """

    spec: mujoco.MjSpec
    model: mujoco.MjModel
    files: tuple[Path, ...]


def read_mjcf_file(path: Path, kind: str) -> MjcfFile:
    """Return the content of an MJCF file.

    Args:
        path: of the file.
        kind: of file ("arm", "cell"), for messages.

    Raises:
        InputError: it is not an MJCF, describes more than `MOST_ELEMENTS` elements or `MOST_POINTS` points,
            has a number that is not finite, or MuJoCo refuses it.
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
        note_file(file)  # MuJoCo has read it
    return MjcfFile(spec, model, (path, *contents.named))


def compiled(spec: mujoco.MjSpec, where: str, *, lines: bool = True) -> mujoco.MjModel:
    """Return the compiled model of a specification.

    Args:
        spec: read from a file.
        where: see `refusals`.
        lines: see `refusals`.

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
    """Turn MuJoCo's ValueError into an InputError that names the file.

    Args:
        where: kind and path of the file.
        lines: whether line numbers in MuJoCo's message are those of the file.

    Raises:
        InputError: in place of a ValueError.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # deprecations
            yield
    except ValueError as error:
        text = str(error).replace("\n", ", ")
        text = text if lines else re.sub(r", line \d+", "", text)
        raise InputError(f"{where}: MuJoCo refuses it: {text.strip(' ,'):.500}") from None


@final
class _Contents:
    """Counts the elements that an MJCF describes with the files that it names; `named` are these files.

    Args:
        top: the file; others are searched in its folder.
        kind: of file, for messages.
    """

    def __init__(self, top: Path, kind: str) -> None:
        self.named: dict[Path, None] = {}
        self._top, self._kind = top, kind
        self._counts: dict[Path, float] = {}

    def count(self, path: Path) -> float:
        """Check all elements of a file, and return their number.

        Raises:
            InputError: there are too many, or an element has too many points or a number that is not finite.
        """
        where = f"{self._kind} file {path}"
        self._counts[path] = _COUNTING
        root = self._expanded(path)
        compilers = root.iter("compiler")
        folders = list(dict.fromkeys(["", *(one.get(key, "") for one in compilers for key in _FOLDERS)]))
        models = {}
        for element in root.iter():
            files = [self._found(text, path, folders) for key, text in element.items() if key[:4] == "file"]
            for file in filter(None, files):
                _check_points(element, _pixels(file), where)
                if element.tag != "model":
                    continue
                inner = self._counts[file] if file in self._counts else self.count(file)
                if inner == _COUNTING:
                    raise InputError(
                        f"{where}: {_label(element)} is this file, or one that leads back to it; remove it"
                    )
                models[element.get("name", file.stem)] = inner
        total, waiting = 0.0, [(root, 1.0)]
        while waiting:
            element, times = waiting.pop()
            check_numbers(element, where)
            _check_generated(element, where)
            if element.tag in _COUNTED:
                times *= _product(element, "count")
            total += times * (1 + models.get(element.get("model", ""), 0))
            if total > MOST_ELEMENTS:
                raise InputError(
                    f"{where} describes more than {MOST_ELEMENTS} elements, {_label(element)} among them; no "
                    "more are read: leave out shapes that nothing touches, or join shapes to meshes"
                )
            waiting += [(child, times) for child in element]
        self._counts[path] = total
        return total

    def _expanded(self, path: Path) -> ElementTree.Element:
        """Return the top element of a file, with included files inserted in their `<include>` elements."""
        root = read_xml(path, self._kind)
        waiting, included = [(root, path)], {path.resolve()}
        while waiting:
            element, current = waiting.pop()
            file = self._found(element.get("file"), current, [""]) if element.tag == "include" else None
            if file is not None and file not in included:  # MuJoCo refuses a file that is included twice
                included.add(file)
                element.extend(read_xml(file, self._kind))
                current = file
            waiting += [(child, current) for child in element]
        check_depth(root, f"{self._kind} file {path}")
        return root

    def _found(self, file: str | None, path: Path, folders: list[str]) -> Path | None:
        """Return the path of a file that an element names; None if it does not exist."""
        candidates = [
            base / folder / (file or "") for base in (path.parent, self._top.parent) for folder in folders
        ]
        named = next((candidate.resolve() for candidate in candidates if file and is_file(candidate)), None)
        if named is not None and named != self._top.resolve():
            self.named[named] = None
        return named


def check_numbers(element: ElementTree.Element, where: str) -> None:
    """Check that all numbers of an element are finite.

    Raises:
        InputError: one is not.
    """
    for key, text in element.items():
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            continue  # no numbers
        if not all(map(math.isfinite, values)):
            raise InputError(
                f"{where}: {_label(element)}: {key} is {text!r:.80}; every number must be finite"
            )


def _check_generated(element: ElementTree.Element, where: str) -> None:
    """Check the number of points that MuJoCo generates for an element.

    Raises:
        InputError: there are too many.
    """
    if element.tag == "mesh":
        points = _POINT_OF_MESH * _product(element, "params") ** 2
    else:
        points = max(_product(element, *keys) for keys in _SIZES)
    _check_points(element, points, where)


def _pixels(path: Path) -> float:
    """Return the number of pixels of a PNG file; 1 for other files."""
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
    """Return the product of the numbers above 1 in some attributes; other words count as 1."""
    product = 1.0
    for word in " ".join(element.get(key, "") for key in keys).split():
        with suppress(ValueError):
            product *= max(1.0, float(word))
    return product


def _label(element: ElementTree.Element) -> str:
    """Return an element for messages: its tag with the attributes that identify it."""
    shown = ("name", "count", "file", *(key for keys in _SIZES for key in keys))
    known = [f'{key}="{text:.40}"' for key in shown if (text := element.get(key)) is not None]
    return f"<{' '.join((element.tag, *known))}>"
