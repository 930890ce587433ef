"""Files that an MJCF names, which MuJoCo reads by itself."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from cosim.base.kept.files_read import note_file
from cosim.base.resources import is_file
from cosim.config.arms.robot_tree import read_text
from cosim.errors import InputError

_FOLDERS: Final = ("meshdir", "assetdir", "texturedir")
_DOCUMENTS: Final = ("include", "model")


def named_files(path: Path) -> tuple[Path, ...]:
    """Return the files that an MJCF names, as far as they are found, and note that they are read.

    Included files and models may name further ones, and the folders that they are in.

    Args:
        path: of a file that MuJoCo has read.

    Raises:
        InputError: an included file is not XML to every reader.
    """
    documents = {path.resolve(): _root(path)}
    found: dict[Path, None] = {}
    while True:
        named = list(dict.fromkeys(_named(documents)))
        found |= dict.fromkeys(file for _, file in named if file not in documents)
        new = {file for tag, file in named if tag in _DOCUMENTS and file.suffix == ".xml"} - documents.keys()
        if not new:
            break
        documents |= {file: _root(file) for file in new}
    for file in found:
        note_file(file)
    return tuple(found)


def _root(path: Path) -> ElementTree.Element:
    try:
        return ElementTree.fromstring(read_text(path, "MJCF"))
    except ElementTree.ParseError as error:
        raise InputError(f"MJCF file {path} is not XML: {error}") from None


def _named(documents: dict[Path, ElementTree.Element]) -> Iterator[tuple[str, Path]]:
    """Yield the tag and path of every file that documents name, wherever MuJoCo may look for it."""
    compilers = [entry for root in documents.values() for entry in root.iter("compiler")]
    folders = {"": None} | {entry.get(key, ""): None for entry in compilers for key in _FOLDERS}
    places = {document.parent / folder: None for document in documents for folder in folders}
    for root in documents.values():
        for element in root.iter():
            names = [value for key, value in element.attrib.items() if key.startswith("file")]
            for file in (place / name for name in names for place in places):
                if is_file(file):
                    yield element.tag, file.resolve()
