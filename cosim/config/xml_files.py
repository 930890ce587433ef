"""Reads XML files of arms and scenes. The files may come from anybody, so their size and depth are bounded,
and document types and entities are refused.
"""

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Final

from cosim.base.files import read_text
from cosim.base.resources import is_file
from cosim.errors import InputError

DEEPEST: Final = 300


def read_xml(path: Path, kind: str = "arm") -> ElementTree.Element:
    """Return the top element of an XML file.

    Args:
        path: of the file.
        kind: of file ("arm", "scene"), for messages.

    Raises:
        InputError: the file does not exist, cannot be read, is too large, declares entities, is not XML, or
            is nested too deeply.
    """
    try:
        top = ElementTree.fromstring(_text(path, kind))
    except ElementTree.ParseError as error:
        raise InputError(f"{kind} file {path} is not XML: {error}") from None
    check_depth(top, f"{kind} file {path}")
    return top


def check_depth(top: ElementTree.Element, where: str) -> None:
    """Check the depth of nested elements.

    Raises:
        InputError: it is more than `DEEPEST`; the message begins with `where`.
    """
    level, depth = [top], 0
    while level:
        level, depth = [child for element in level for child in element], depth + 1
        if depth > DEEPEST:
            raise InputError(f"{where} is nested too deeply; at most {DEEPEST} levels are read")


def _text(path: Path, kind: str) -> str:
    if not is_file(path):
        raise InputError(f"{kind} file {path} does not exist")
    try:
        text = read_text(path)
    except OSError as error:
        raise InputError(f"{kind} file {path} cannot be read: {error.strerror}") from None
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(f"{kind} file {path} declares a document type or entities; nothing needs them")
    return text
