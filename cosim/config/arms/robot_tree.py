"""Reads a URDF, which may be anybody's, and checks that its links and joints form one tree."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections import Counter
from pathlib import Path
from typing import Final

from cosim.base.files import read_text
from cosim.base.resources import is_file
from cosim.errors import InputError

MOST_LINKS: Final = 500
DEEPEST: Final = 300
LONGEST_NAME: Final = 200
_XACRO: Final = "ros.org/wiki/xacro"


def read_robot(path: Path) -> ElementTree.Element:
    """Return the robot of a URDF file, its links and joints joined to one tree.

    Raises:
        InputError: the file is not there, too large, no XML, no URDF, not expanded, or no tree.
    """
    robot = read_xml(path)
    if path.suffix == ".xacro" or any(_XACRO in element.tag for element in robot.iter()):
        plain = path.with_suffix("") if path.suffix == ".xacro" else path.with_suffix(".plain.urdf")
        shown = plain if plain.suffix == ".urdf" else plain.with_suffix(".urdf")
        raise InputError(
            f"arm file {path} holds xacro macros, which are not expanded here; expand them first: "
            f"xacro {path.name} > {shown.name}"
        )
    if robot.tag != "robot":
        raise InputError(
            f"arm file {path} is no URDF: its first element is <{robot.tag}>, not <robot>; an MJCF file "
            "ends in .xml"
        )
    check_tree(robot, path)
    if not robot.get("name"):
        robot.set("name", path.stem)  # Pinocchio wants one
    return robot


def read_xml(path: Path, kind: str = "arm") -> ElementTree.Element:
    """Return the top element of an XML file.

    Args:
        path: of the file.
        kind: what it is of, for messages.

    Raises:
        InputError: it is not there, cannot be read, is too large, declares entities, is no XML, or is nested
            too deeply.
    """
    try:
        top = ElementTree.fromstring(_text(path, kind))
    except ElementTree.ParseError as error:
        raise InputError(f"{kind} file {path} is not XML: {error}") from None
    check_depth(top, f"{kind} file {path}")
    return top


def check_depth(top: ElementTree.Element, where: str) -> None:
    """Raise InputError where elements are nested more than `DEEPEST` deep."""
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


def check_tree(robot: ElementTree.Element, path: Path) -> None:
    """Check that links and joints have names and form one tree.

    Raises:
        InputError: a name is missing or used twice, a joint names no link, or there is a circle or two roots.
    """
    links, joints = robot.findall("link"), robot.findall("joint")
    if not links:
        raise InputError(f"arm file {path} has no links")
    if len(links) > MOST_LINKS:
        raise InputError(f"arm file {path} has {len(links)} links; at most {MOST_LINKS} are read")
    for kind, elements in (("link", links), ("joint", joints)):
        _check_names(kind, elements, path)
    names = {link.get("name", "") for link in links}
    above: dict[str, str] = {}
    for joint in joints:
        parent, child = (_named_link(joint, end, names, path) for end in ("parent", "child"))
        if child in above:
            raise InputError(
                f"arm file {path}: joint {joint.get('name')!r}: link {child!r} hangs on another joint already"
            )
        above[child] = parent
    for name in names:
        _check_root(name, above, path)
    roots = sorted(names - above.keys())
    if len(roots) > 1:
        raise InputError(
            f"arm file {path} has {len(roots)} roots, links that no joint carries: "
            f"{', '.join(map(repr, roots[:5]))}; join them by a fixed joint"
        )


def link_of(joint: ElementTree.Element, end: str) -> str:
    """Return the name of a joint's parent or child."""
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _check_names(kind: str, elements: list[ElementTree.Element], path: Path) -> None:
    counts = Counter(element.get("name", "") for element in elements)
    if "" in counts:
        raise InputError(f"arm file {path}: a {kind} has no name")
    longest = max(counts, key=len, default="")
    if len(longest) > LONGEST_NAME:
        raise InputError(
            f"arm file {path}: the name of {kind} '{longest[:20]}...' has {len(longest)} characters; "
            f"at most {LONGEST_NAME} are read"
        )
    twice = [name for name, count in counts.items() if count > 1]
    if twice:
        raise InputError(f"arm file {path}: two {kind}s are called {twice[0]!r}; names must differ")


def _named_link(joint: ElementTree.Element, end: str, names: set[str], path: Path) -> str:
    link = link_of(joint, end)
    if link not in names:
        where = f"arm file {path}: joint {joint.get('name')!r}"
        raise InputError(f"{where}: its {end} is link {link!r:.80}; no such name is there")
    return link


def _check_root(link: str, above: dict[str, str], path: Path) -> None:
    """Raise InputError where the way up from a link comes back to it."""
    name, seen = link, {link}
    while name in above:
        name = above[name]
        if name in seen:
            raise InputError(f"arm file {path}: link {name!r} carries itself: its joints form a circle")
        seen.add(name)
