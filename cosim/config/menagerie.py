"""Finds arms of MuJoCo Menagerie on this machine; nothing is downloaded. It searches a checkout
(`MENAGERIE_ROOT`), the folder into which the package mujoco-menagerie fetches (`MENAGERIE_CACHE_DIR`), and
the folder into which robot_descriptions clones (`ROBOT_DESCRIPTIONS_CACHE`), with the variables and defaults
of these packages.
"""

import os
import re
from pathlib import Path
from typing import Final

from cosim.config.toml.keys import listing, unknown_name_message
from cosim.config.xml_files import read_xml
from cosim.errors import InputError

PREFIX: Final = "menagerie:"

_COMPLETE: Final = ".complete"
_FETCHED: Final = re.compile(r"(.+)-[0-9a-f]{16}")


def is_of_menagerie(robot: str) -> bool:
    """Return whether the name of an arm is a model of the Menagerie."""
    return robot.startswith(PREFIX)


def menagerie_file(robot: str) -> Path:
    """Return the MJCF of an arm.

    Args:
        robot: "menagerie:MODEL", or "menagerie:MODEL/FILE" where a model has several; FILE without ending.

    Raises:
        InputError: the model is not on this machine, or has several files and none is named.
    """
    model, _, file = robot.removeprefix(PREFIX).partition("/")
    folders = _models()
    if model not in folders:
        known = unknown_name_message("model", model, tuple(sorted(folders))) if folders else "no model found"
        raise InputError(
            f"{robot} is not on this machine ({known}); fetch it once with pip install 'cosim[robots]' and "
            f"mujoco-menagerie prefetch {model}, or let MENAGERIE_ROOT name a checkout of mujoco_menagerie"
        )
    files = sorted(folders[model].glob("*.xml"))
    scene = folders[model] / "scene.xml"
    include = read_xml(scene).find("include") if scene in files and not file else None
    if include is not None:  # a scene includes the robot first
        candidates = [scene.parent / include.get("file", "")]
    else:
        candidates = [path for path in files if (path.stem == file if file else path != scene)]
    if len(candidates) != 1:
        names = listing([path.stem for path in files])
        raise InputError(f"{robot}: which of its files? {PREFIX}{model}/FILE is one of {names}")
    return candidates[0].resolve()


def _models() -> dict[str, Path]:
    """Return the folders of models by name; a checkout takes precedence over fetched models and clones."""
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
    """Return the matching files of a folder, oldest first; none if it does not exist."""
    return sorted(folder.glob(pattern), key=lambda path: path.stat().st_mtime) if folder.is_dir() else []
