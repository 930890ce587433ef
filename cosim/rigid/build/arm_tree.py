"""Finds the flange of an arm among the bodies of a compiled MuJoCo model, and the chain of bodies that leads
to it.
"""

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import mujoco

from cosim.base.arm_file import LinkShape
from cosim.base.frames import Array
from cosim.errors import InputError

FLANGE_NAMES: Final = ("attachment_site", "tool0", "flange")
MOST_JOINTS: Final = 10
ROOT: Final = "world"  # a link of this name is MuJoCo's world body, which no joint may carry
_MOST_NAMED: Final = 6
_HANDLED: Final = {mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE}


@final
@dataclass(frozen=True)
class Way:
    """The way from the world to the flange.

    Args:
        flange: name of the site or body whose frame is the flange.
        on_site: whether the flange is a site of the last body.
        bodies: names, from the base on.
        how: how the flange was found.
    """

    flange: str
    on_site: bool
    bodies: tuple[str, ...]
    how: str


@final
@dataclass(frozen=True)
class Chain:
    """Links and joints from the root to the flange, as URDF.

    Args:
        robot: top element, with these links and joints only.
        joints: of it, base to flange.
        flange: link whose frame is the flange.
        home: (joints,) of the arm's file; None: it has none.
        armature: (joints,) [kg m^2] of the arm's file; None: it has none.
        shapes: see `ArmFile`.
        files: that were read.
        left_out: names of links off the chain that have a mass.
    """

    robot: ElementTree.Element
    joints: tuple[ElementTree.Element, ...]
    flange: str
    home: Array | None = None
    armature: Array | None = None
    shapes: tuple[LinkShape, ...] = ()
    files: tuple[Path, ...] = ()
    left_out: tuple[str, ...] = ()


def way_to_flange(spec: mujoco.MjSpec, given: str | None, path: Path) -> Way:
    """Return the way to the flange.

    Args:
        spec: in which all bodies have names.
        given: name of the flange, a site or body; None: one of `FLANGE_NAMES`, or the only name that ends in
            one, such as left_tool0; else the last body before the chain ends, or branches into moving bodies.
        path: of the file.

    Raises:
        InputError: there is no such site or body, or too few or too many joints move it.
    """
    sites = {site.name: site.parent for site in spec.sites if site.name}
    bodies = {body.name: body for body in spec.bodies[1:]}
    both = {**bodies, **sites}
    if given is not None and given not in both:
        raise InputError(f"arm file {path} has no link, body or site {given!r}; there are {', '.join(both)}")
    name, how = (given, "as asked for") if given is not None else _by_name(list(both))
    if name is None:
        last = _last_body(spec)
        name, how = last.name, "the last link before the chain branches or ends"
    body, way, count = both.get(name, spec.worldbody), list[str](), 0
    while body.name != ROOT:
        way.insert(0, body.name)
        count += len(body.joints)
        body = body.parent
    if not 1 <= count <= MOST_JOINTS:
        raise InputError(
            f"arm file {path}: {count} joints move the flange {name!r}; it must be 1 to {MOST_JOINTS}; "
            f"{_other_flanges(spec)}"
        )
    return Way(name, name in sites, tuple(way), how)


def _by_name(names: list[str]) -> tuple[str | None, str]:
    """Return which name is that of a flange, and how it was found."""
    for wanted in FLANGE_NAMES:
        if wanted in names:
            return wanted, "by its name"
    for wanted in FLANGE_NAMES:
        ending = [name for name in names if name.endswith(f"_{wanted}")]
        if len(ending) == 1:
            return ending[0], "by the end of its name"
    return None, ""


def _last_body(spec: mujoco.MjSpec) -> mujoco.MjsBody:
    """Return the body after which no joint moves, or several branches have joints that move."""
    moving = set[str]()  # bodies that move, or lead to one
    for body in spec.bodies[1:]:
        above = body if body.joints else spec.worldbody
        while above.name not in (ROOT, *moving):
            moving.add(above.name)
            above = above.parent
    body = spec.worldbody
    while True:
        below = body.bodies
        ahead = [child for child in below if child.name in moving]
        if len(ahead) > 1 or (not ahead and len(below) != 1):
            return body
        body = (ahead or below)[0]  # beyond the last joint, a row of frames leads to the flange


def _other_flanges(spec: mujoco.MjSpec) -> str:
    """Return a text with other flanges, which 1 to `MOST_JOINTS` joints move: the ends of usable chains."""
    counts = {ROOT: 0}  # joints that move a body; -1 if one of them is not supported
    for body in spec.bodies[1:]:
        above, kinds = counts[body.parent.name], [joint.type for joint in body.joints]
        usable = above >= 0 and len(kinds) <= 1 and _HANDLED.issuperset(kinds)
        counts[body.name] = above + len(kinds) if usable else -1
    found = {name: count for name, count in counts.items() if 1 <= count <= MOST_JOINTS}
    inner = {body.parent.name for body in spec.bodies[1:] if body.name in found}
    ends = sorted(((name, found[name]) for name in found if name not in inner), key=lambda end: -end[1])
    if not ends:
        return f"no other link is moved by 1 to {MOST_JOINTS} joints either"
    named = ", ".join(f"{name!r} ({count})" for name, count in ends[:_MOST_NAMED])
    more = f" and {len(ends) - _MOST_NAMED} others" if len(ends) > _MOST_NAMED else ""
    return f"name another link as flange in an arm.toml, such as (joints that move it): {named}{more}"
