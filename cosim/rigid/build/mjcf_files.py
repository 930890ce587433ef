"""Files that an MJCF names."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

from cosim.config.arms.robot_tree import read_text


def named_files(path: Path) -> tuple[Path, ...]:
    """Return the files that an MJCF names, as far as they are found: includes, meshes, textures."""
    found: dict[Path, None] = {}
    root = ElementTree.fromstring(read_text(path))
    compiler = root.find("compiler")
    keys = ("meshdir", "assetdir", "texturedir")
    folders = ["", *([] if compiler is None else [compiler.get(key, "") for key in keys])]
    for element in root.iter():
        file = element.get("file")
        if file is None:
            continue
        near = [path.parent / folder / file for folder in folders]
        place = next((candidate.resolve() for candidate in near if candidate.is_file()), None)
        if place is not None and place != path and place not in found:
            found[place] = None
            if element.tag == "include":
                found |= dict.fromkeys(named_files(place))
    return tuple(found)
