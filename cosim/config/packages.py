"""Finds the files that a robot's file names: relative paths, `package://NAME/...`, and models of MuJoCo
Menagerie.
"""

import sys
from importlib import metadata
from pathlib import Path
from typing import Final

from cosim.base.resources import is_file
from cosim.config.menagerie import is_of_menagerie, menagerie_file
from cosim.errors import InputError

_DATA_PACKAGE: Final = "example-robot-data"
_SCHEMES: Final = ("package://", "model://")


def resolve_file(name: str, beside: Path, package_folders: tuple[Path, ...] = ()) -> Path:
    """Return the absolute path of a file that another file names.

    A package is searched in the given folders, in those above the file that names it, and among the robots
    of the package example-robot-data.

    Args:
        name: relative to the other file, absolute, package://NAME/..., or menagerie:MODEL.
        beside: the file that names it.
        package_folders: folders that hold packages.

    Raises:
        InputError: it is not found; the message lists the searched paths.
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
    """Return the folder that holds the folder example-robot-data; None if that package is not installed."""
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
