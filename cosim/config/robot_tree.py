"""Reads a robot's file, which may be anybody's, checks its tree, and finds the files that it names.

Finds arms of MuJoCo Menagerie on this machine; nothing is downloaded.

Looked for in a checkout (`MENAGERIE_ROOT`), in what the package mujoco-menagerie has fetched
(`MENAGERIE_CACHE_DIR`), and in what robot_descriptions has cloned (`ROBOT_DESCRIPTIONS_CACHE`), by the
variables and default places of these packages.
"""

import os
import re
import sys
import xml.etree.ElementTree as ElementTree
from collections import Counter
from importlib import metadata
from pathlib import Path
from typing import Final

from cosim.base.files import read_text
from cosim.base.resources import is_file
from cosim.config.toml.keys import listing, unknown_name_message
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


PREFIX: Final = "menagerie:"

_SCENE: Final = "scene.xml"
_COMPLETE: Final = ".complete"
_FETCHED: Final = re.compile(r"(.+)-[0-9a-f]{16}")


def is_of_menagerie(robot: str) -> bool:
    """Return whether what names an arm is a model of the Menagerie."""
    return robot.startswith(PREFIX)


def menagerie_file(robot: str) -> Path:
    """Return the MJCF of an arm.

    Args:
        robot: "menagerie:MODEL", or "menagerie:MODEL/FILE" where a model has several; FILE without ending.

    Raises:
        InputError: the model is not on this machine, or it is not clear which of its files is meant.
    """
    model, _, file = robot.removeprefix(PREFIX).partition("/")
    folders = _models()
    if model not in folders:
        here = unknown_name_message("model", model, tuple(sorted(folders))) if folders else "none is there"
        raise InputError(
            f"{robot} is not on this machine ({here}); fetch it once with pip install 'cosim[robots]' and "
            f"mujoco-menagerie prefetch {model}, or let MENAGERIE_ROOT name a checkout of mujoco_menagerie"
        )
    folder = folders[model]
    if file:
        return _named(robot, folder, file)
    included = _included(folder / _SCENE)
    found = [included] if included is not None else sorted(set(folder.glob("*.xml")) - {folder / _SCENE})
    if len(found) != 1:
        raise InputError(f"{robot}: which of its files? {PREFIX}{model}/FILE is one of {_names(folder)}")
    return found[0].resolve()


def _named(robot: str, folder: Path, file: str) -> Path:
    path = folder / f"{file}.xml"
    if not is_file(path):
        raise InputError(f"{robot}: {folder} has no file {path.name}; there are: {_names(folder)}")
    return path.resolve()


def _names(folder: Path) -> str:
    return listing(sorted(path.stem for path in folder.glob("*.xml")))


def _included(scene: Path) -> Path | None:
    """Return the first file that a scene includes: the robot; None without a scene."""
    if not is_file(scene):
        return None
    include = read_xml(scene).find("include")
    return None if include is None else scene.parent / include.get("file", "")


def _models() -> dict[str, Path]:
    """Return the folders of models by name; a checkout counts before what was fetched, that before clones."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    clones = Path(os.environ.get("ROBOT_DESCRIPTIONS_CACHE") or cache / "robot_descriptions").expanduser()
    fetched = Path(os.environ.get("MENAGERIE_CACHE_DIR") or cache / "mujoco_menagerie")
    found = {path.parent.name: path.parent for path in _sorted(clones / "mujoco_menagerie", "*/*.xml")}
    for complete in _sorted(fetched / "models", f"*/{_COMPLETE}"):
        match = _FETCHED.fullmatch(complete.parent.name)
        if match:
            found[match[1]] = complete.parent
    root = os.environ.get("MENAGERIE_ROOT")
    return found | {path.parent.name: path.parent for path in _sorted(Path(root or os.devnull), "*/*.xml")}


def _sorted(folder: Path, pattern: str) -> list[Path]:
    """Return the files in a folder that may not be there, oldest first."""
    return sorted(folder.glob(pattern), key=lambda path: path.stat().st_mtime) if folder.is_dir() else []


DATA_PACKAGE: Final = "example-robot-data"
_SCHEMES: Final = ("package://", "model://")


def found_file(name: str, beside: Path, package_folders: tuple[Path, ...] = ()) -> Path:
    """Return the absolute path of a file that another file names.

    A package is looked for in the given folders, in those above the file that names it, and among the robots
    of example-robot-data.

    Args:
        name: relative to the other file, absolute, package://NAME/..., or menagerie:MODEL.
        beside: the file that names it.
        package_folders: which hold folders of packages.

    Raises:
        InputError: it is nowhere; the message lists where it was looked for.
    """
    if is_of_menagerie(name):
        return menagerie_file(name)
    looked = _candidates(name, beside, package_folders)
    for candidate in looked:
        if is_file(candidate):
            return candidate.resolve()
    places = ", ".join(map(str, looked[:4])) + (", ..." if len(looked) > 4 else "")
    hint = "; name the folder that holds the package in package_paths of an arm.toml"
    raise InputError(f"{name!r} not found (looked for {places}){hint if '://' in name else ''}")


def packaged_share() -> Path | None:
    """Return the folder that holds the folder example-robot-data; None where it is not installed."""
    candidates = [Path(sys.prefix) / "share"]
    try:
        files = metadata.distribution(DATA_PACKAGE)
        candidates.insert(0, Path(str(files.locate_file("cmeel.prefix/share"))))
    except metadata.PackageNotFoundError:
        pass
    return next((path for path in candidates if (path / DATA_PACKAGE / "robots").is_dir()), None)


def _candidates(name: str, beside: Path, package_folders: tuple[Path, ...]) -> list[Path]:
    scheme = next((scheme for scheme in _SCHEMES if name.startswith(scheme)), None)
    if scheme is None:
        return [beside.parent / name.removeprefix("file://")]
    inside = name.removeprefix(scheme)
    package, _, rest = inside.partition("/")
    share = packaged_share()
    above = beside.resolve().parents
    folders = [*package_folders, *above, *([] if share is None else [share])]
    own = [folder / rest for folder in above if folder.name == package]
    return [*own, *(folder / inside for folder in folders)]
