"""Finds the robots and scenarios that cosim includes, and optional libraries. An installed wheel has the
files inside the package (`cosim/_data`); a clone, or an editable install of one, at the top of the
repository. Both are found from any working directory.
"""

import importlib
from itertools import takewhile
from pathlib import Path
from typing import Any

from cosim.errors import InputError

_PACKAGE = Path(__file__).resolve().parents[1]
_LONGEST_SHOWN = 200  # characters of a name that no file has


def data_directory() -> Path:
    """Return the directory that holds `robots/` and `scenarios/`.

    Raises:
        InputError: neither the installed package nor a clone around it holds them.
    """
    for candidate in (_PACKAGE / "_data", _PACKAGE.parent):
        if (candidate / "robots").is_dir() and (candidate / "scenarios").is_dir():
            return candidate
    raise InputError(f"no robots/ and scenarios/ beside or inside {_PACKAGE}; reinstall cosim")


def robots_directory() -> Path:
    """Return the directory of the robots that come with cosim."""
    return data_directory() / "robots"


def list_soft_robots() -> tuple[str, ...]:
    """Return the names of the soft robots that come with cosim, sorted."""
    return tuple(sorted(path.stem for path in robots_directory().glob("*.toml")))


def list_arms() -> tuple[str, ...]:
    """Return the names of the arms that come with cosim, sorted."""
    return tuple(sorted(path.parent.name for path in robots_directory().glob("*/arm.toml")))


def arm_path(name: str) -> Path:
    """Return where the file of an arm that comes with cosim is, whether or not there is one of that name."""
    return robots_directory() / name / "arm.toml"


def list_scenarios() -> tuple[str, ...]:
    """Return the names of the scenarios that come with cosim, sorted."""
    return tuple(sorted(path.stem for path in (data_directory() / "scenarios").glob("*.toml")))


def soft_robot_path(name_or_path: str | Path) -> Path:
    """Return the file of a soft robot, given by name or as a path that ends in .toml.

    Raises:
        InputError: there is no such file; the message lists the names that exist.
    """
    return _find("soft robot", name_or_path, "robots", list_soft_robots())


def scenario_path(name_or_path: str | Path) -> Path:
    """Return the file of a scenario, given by name or as a path that ends in .toml.

    Raises:
        InputError: there is no such file; the message lists the names that exist.
    """
    return _find("scenario", name_or_path, "scenarios", list_scenarios())


def list_object_meshes() -> tuple[str, ...]:
    """Return the names of the mesh files that come with cosim, sorted."""
    folder = robots_directory() / "objects"
    return tuple(sorted(path.name for path in folder.glob("*") if path.suffix in (".stl", ".obj")))


def object_mesh_path(name: str) -> Path:
    """Return where a mesh file that comes with cosim is, whether or not there is one of that name."""
    return robots_directory() / "objects" / name


def is_file(path: Path) -> bool:
    """Return whether there is such a file, also of a path that no file can have or that may not be seen."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long, not permitted, or a null character
        return False


def quoted_name(name: str) -> str:
    """Return a file's name as messages show it: in quotes, long ones cut."""
    return repr(name if len(name) <= _LONGEST_SHOWN else f"{name[:_LONGEST_SHOWN]}...")


def first_comment(path: Path) -> str:
    """Return the first paragraph of a file's first comment: a scenario's question, what a soft robot is."""
    lines = takewhile(lambda line: line.strip("# "), path.read_text(encoding="utf-8").splitlines())
    comments = takewhile(lambda line: line.startswith("#"), lines)
    return " ".join(line.strip("# ") for line in comments).removeprefix("Question:").strip()


def _find(kind: str, name_or_path: str | Path, folder: str, names: tuple[str, ...]) -> Path:
    if isinstance(name_or_path, str) and name_or_path in names:
        return data_directory() / folder / f"{name_or_path}.toml"
    path = Path(name_or_path)
    if path.suffix == ".toml" and is_file(path):
        return path
    hint = "" if path.suffix == ".toml" else ", or give the path of a .toml file"
    asked = quoted_name(str(name_or_path))
    raise InputError(f"no {kind} {asked}; there are: {', '.join(names) or 'none'}{hint}")


def extra_module(name: str, extra: str) -> Any:
    """Return a module of a library that is part of an extra.

    Args:
        name: of the module.
        extra: that installs it, such as "pattern".

    Raises:
        InputError: it is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        library = name.partition(".")[0]
        raise InputError(f"this needs {library}: pip install 'cosim[{extra}]'") from None
