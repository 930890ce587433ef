"""Reads XML files, which may be anybody's, within bounds, and finds the files that a robot's file names.

Finds arms of MuJoCo Menagerie on this machine; nothing is downloaded.

Looked for in a checkout (`MENAGERIE_ROOT`), in what the package mujoco-menagerie has fetched
(`MENAGERIE_CACHE_DIR`), and in what robot_descriptions has cloned (`ROBOT_DESCRIPTIONS_CACHE`), by the
variables and default places of these packages.
"""

import os
import re
import sys
import xml.etree.ElementTree as ElementTree
from importlib import metadata
from pathlib import Path
from typing import Final

from cosim.base.files import read_text
from cosim.base.resources import is_file
from cosim.config.toml.keys import listing, unknown_name_message
from cosim.errors import InputError

DEEPEST: Final = 300


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


PREFIX: Final = "menagerie:"

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
    files = sorted(folders[model].glob("*.xml"))
    scene = folders[model] / "scene.xml"
    include = read_xml(scene).find("include") if scene in files and not file else None
    if include is not None:  # the robot comes first
        found = [scene.parent / include.get("file", "")]
    else:
        found = [path for path in files if (path.stem == file if file else path != scene)]
    if len(found) != 1:
        names = listing([path.stem for path in files])
        raise InputError(f"{robot}: which of its files? {PREFIX}{model}/FILE is one of {names}")
    return found[0].resolve()


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


_DATA_PACKAGE: Final = "example-robot-data"
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


def _packaged_share() -> Path | None:
    """Return the folder that holds the folder example-robot-data; None where it is not installed."""
    candidates = [Path(sys.prefix) / "share"]
    try:
        files = metadata.distribution(_DATA_PACKAGE)
        candidates.insert(0, Path(str(files.locate_file("cmeel.prefix/share"))))
    except metadata.PackageNotFoundError:
        pass
    return next((path for path in candidates if (path / _DATA_PACKAGE / "robots").is_dir()), None)


def _candidates(name: str, beside: Path, package_folders: tuple[Path, ...]) -> list[Path]:
    scheme = next((scheme for scheme in _SCHEMES if name.startswith(scheme)), None)
    if scheme is None:
        return [beside.parent / name.removeprefix("file://")]
    inside = name.removeprefix(scheme)
    package, _, rest = inside.partition("/")
    share = _packaged_share()
    above = beside.resolve().parents
    folders = [*package_folders, *above, *([] if share is None else [share])]
    own = [folder / rest for folder in above if folder.name == package]
    return [*own, *(folder / inside for folder in folders)]
