"""The chain of joints from the root of a URDF to its flange."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Final

from cosim.base.arm_file import FIXED, MOVING
from cosim.config.arms.robot_tree import link_of
from cosim.errors import InputError

FLANGE_NAMES: Final = ("attachment_site", "tool0", "flange")
MOST_JOINTS: Final = 8
_MOST_NAMED: Final = 6


def flange_of(robot: ElementTree.Element, given: str | None, path: Path) -> tuple[str, str]:
    """Return the link that is the flange, and how it was found.

    Args:
        robot: one tree.
        given: its name; None: see `FLANGE_NAMES`, also as the end of one name only, such as left_tool0; else
            the last link before the chain branches into several that move, or ends.
        path: of the file.

    Raises:
        InputError: there is no such link.
    """
    names = [link.get("name", "") for link in robot.findall("link")]
    if given is not None:
        if given not in names:
            raise InputError(f"arm file {path} has no link {given!r}; there are {', '.join(names)}")
        return given, "as asked for"
    for wanted in FLANGE_NAMES:
        if wanted in names:
            return wanted, "by its name"
    for wanted in FLANGE_NAMES:
        ending = [name for name in names if name.endswith(f"_{wanted}")]
        if len(ending) == 1:
            return ending[0], "by the end of its name"
    return _last_link(robot), "the last link before the chain branches or ends"


def chain_to(robot: ElementTree.Element, flange: str, path: Path) -> list[ElementTree.Element]:
    """Return the joints from the root to the flange.

    Raises:
        InputError: a joint is of a type that is not handled, none moves, or too many do.
    """
    joint_above = {link_of(joint, "child"): joint for joint in robot.findall("joint")}
    chain: list[ElementTree.Element] = []
    link = flange
    while link in joint_above:
        joint = joint_above[link]
        if joint.get("type") not in (FIXED, *MOVING):
            raise InputError(
                f"arm file {path}: joint {joint.get('name')!r} is {joint.get('type')!r:.80}; "
                f"the chain to the flange may hold {', '.join((FIXED, *MOVING))}"
            )
        chain.insert(0, joint)
        link = link_of(joint, "parent")
    moving = moving_joints(chain)
    if not 1 <= len(moving) <= MOST_JOINTS:
        names = ", ".join(repr(joint.get("name")) for joint in moving[:MOST_JOINTS]) or "none"
        raise InputError(
            f"arm file {path}: {len(moving)} joints move the flange {flange!r}, {names}; "
            f"it must be 1 to {MOST_JOINTS}; {_other_flanges(robot)}"
        )
    return chain


def moving_joints(chain: list[ElementTree.Element]) -> list[ElementTree.Element]:
    """Return the joints of a chain that are not fixed."""
    return [joint for joint in chain if joint.get("type") != FIXED]


def _other_flanges(robot: ElementTree.Element) -> str:
    """Return what to do about a flange that too few or too many joints move: the ends of usable chains."""
    ends = _usable_ends(robot)
    if not ends:
        return f"no other link is moved by 1 to {MOST_JOINTS} joints either"
    named = ", ".join(f"{name!r} ({count})" for name, count in ends[:_MOST_NAMED])
    more = f" and {len(ends) - _MOST_NAMED} others" if len(ends) > _MOST_NAMED else ""
    return f"name another link as flange in an arm.toml, such as (joints that move it): {named}{more}"


def _usable_ends(robot: ElementTree.Element) -> list[tuple[str, int]]:
    """Return the links that 1 to `MOST_JOINTS` joints move, and none beyond them, most joints first."""
    joint_above = {link_of(joint, "child"): joint for joint in robot.findall("joint")}

    def count(link: str) -> int:
        """Return how many joints move a link; -1 where one of a type that is not handled does."""
        kinds = []
        while link in joint_above:
            kinds.append(joint_above[link].get("type"))
            link = link_of(joint_above[link], "parent")
        return -1 if {*kinds} - {FIXED, *MOVING} else sum(kind != FIXED for kind in kinds)

    counts = {link.get("name", ""): count(link.get("name", "")) for link in robot.findall("link")}
    usable = {link: moved for link, moved in counts.items() if 1 <= moved <= MOST_JOINTS}
    inner = {link_of(joint_above[link], "parent") for link in usable}
    return sorted(((link, usable[link]) for link in usable if link not in inner), key=lambda end: -end[1])


def _last_link(robot: ElementTree.Element) -> str:
    """Return the link after which no joint moves, or several branches have joints that move."""
    below: dict[str, list[ElementTree.Element]] = {}
    above: dict[str, ElementTree.Element] = {}
    for joint in robot.findall("joint"):
        below.setdefault(link_of(joint, "parent"), []).append(joint)
        above[link_of(joint, "child")] = joint
    moving = set[ElementTree.Element]()  # joints that move, or lead to one
    for joint in above.values():
        way: ElementTree.Element | None = None if joint.get("type") == FIXED else joint
        while way is not None and way not in moving:
            moving.add(way)
            way = above.get(link_of(way, "parent"))
    children = above.keys()
    link = next(name for each in robot.findall("link") if (name := each.get("name", "")) not in children)
    while True:
        joints = below.get(link, [])
        ahead = [joint for joint in joints if joint in moving]
        if len(ahead) > 1:
            return link
        if not ahead and len(joints) != 1:  # beyond the last joint, a row of frames leads to the flange
            return link
        link = link_of((ahead or joints)[0], "child")
