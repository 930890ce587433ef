"""Checks what joints and links of a chain say, so that a refusal names them before any engine reads it."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from cosim.base.arm_file import FIXED
from cosim.base.frames import Array
from cosim.config.arms.robot_tree import link_of
from cosim.errors import InputError

_LARGEST: Final = {"xyz": 100.0, "rpy": 1e4, "mass": 1e5, "inertia": 1e7, "limit": 1e7}
_AXES: Final = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_SINGLE: Final = (
    "parent", "child", "origin", "axis", "limit", "dynamics", "inertial", "mass", "inertia", "geometry"
)  # fmt: skip
_SIZES: Final[Mapping[str, Mapping[str, int]]] = {
    "box": {"size": 3}, "sphere": {"radius": 1}, "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1}, "mesh": {},
}  # fmt: skip
_ROUNDING: Final = 1e-9
_LIGHTEST_kg: Final = 1e-9
_LEAST_INERTIA_kg_m2: Final = 1e-12


def check_chain(robot: ElementTree.Element, chain: list[ElementTree.Element], path: Path) -> None:
    """Check origins, axes, limits, masses and inertias of a chain.

    Raises:
        InputError: a number is missing, no number, not finite or too large; a joint has no axis or no limits;
            what a joint moves has no mass, or an inertia that no body has.
    """
    links = {link.get("name", ""): link for link in robot.findall("link")}
    carrier, mass_kg = "", math.inf
    root = link_of(chain[0], "parent")
    _checked_mass(links[root], f"arm file {path}: link {root!r}", moves=False, alone=False)
    for name in (root, *(link_of(joint, "child") for joint in chain)):
        _check_once(links[name], f"arm file {path}: link {name!r}")
        _check_shapes(links[name], f"arm file {path}: link {name!r}")
    for joint in chain:
        name = joint.get("name", "")
        _check_once(joint, f"arm file {path}: joint {name!r}")
        _check_joint(joint, f"arm file {path}: joint {name!r}")
        if joint.get("type") != FIXED:
            _check_carried(carrier, mass_kg, path)
            carrier, mass_kg = name, 0.0
        link = link_of(joint, "child")
        where, alone = f"arm file {path}: link {link!r}", joint.get("type") != FIXED
        mass_kg += _checked_mass(links[link], where, moves=bool(carrier), alone=alone)
    _check_carried(carrier, mass_kg, path)


def numbers(
    element: ElementTree.Element | None, key: str, count: int, default: str, where: str, kind: str = "limit"
) -> Array:
    """Return the numbers of an attribute.

    Args:
        element: that may have it.
        key: the attribute.
        count: how many there must be.
        default: text that stands for it where it is missing; empty: it must be there.
        where: for messages.
        kind: of number, which says how large it may be.

    Raises:
        InputError: it is missing, holds no finite numbers, not so many, or too large ones.
    """
    text = default if element is None else element.get(key, default)
    if not text:
        raise InputError(f"{where}: {key} is missing")
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        raise InputError(f"{where}: {key} {text!r:.80} is no number") from None
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(f"{where}: {key} is {text!r:.80}; it must be {count} finite numbers")
    if np.abs(values).max() > _LARGEST[kind]:
        raise InputError(f"{where}: {key} {text!r:.80} is too large; at most {_LARGEST[kind]:g}")
    return values


def _check_once(element: ElementTree.Element, where: str) -> None:
    """Raise InputError where a part of a joint or link, of which there is one, stands twice."""
    for parent in (element, *element):
        tags = Counter(part.tag for part in parent if part.tag in _SINGLE)
        for tag, count in tags.items():
            if count > 1:
                raise InputError(f"{where}: has <{tag}> {count} times")


def _check_joint(joint: ElementTree.Element, where: str) -> None:
    _check_origin(joint, where)
    if joint.get("type") == FIXED:
        return
    if joint.find("mimic") is not None:
        raise InputError(
            f"{where}: it mimics another joint; the joints to the flange must move by themselves"
        )
    axis = joint.find("axis")
    if np.linalg.norm(numbers(axis, "xyz", 3, "1 0 0" if axis is None else "", where, "xyz")) < _ROUNDING:
        raise InputError(f"{where}: its axis is zero")
    limit = joint.find("limit")
    for key in ("effort", "velocity"):
        if numbers(limit, key, 1, "0", where)[0] < 0.0:
            raise InputError(f"{where}: its {key} limit is negative")
    dynamics = joint.find("dynamics")
    for key in ("damping", "friction"):
        if numbers(dynamics, key, 1, "0", where)[0] < 0.0:
            raise InputError(f"{where}: its {key} is negative")
    if joint.get("type") == "continuous":
        return
    if limit is None:
        raise InputError(
            f"{where}: has no <limit>; give lower, upper, effort and velocity, or make it 'continuous'"
        )
    lower, upper = (float(numbers(limit, key, 1, "0", where)[0]) for key in ("lower", "upper"))
    if not lower < upper:
        raise InputError(f"{where}: its limits leave no way: lower {lower:g}, upper {upper:g}")


def _check_origin(element: ElementTree.Element, where: str) -> None:
    origin = element.find("origin")
    numbers(origin, "xyz", 3, "0 0 0", where, "xyz")
    numbers(origin, "rpy", 3, "0 0 0", where, "rpy")


def _checked_mass(link: ElementTree.Element, where: str, *, moves: bool, alone: bool) -> float:
    """Return the mass of a link [kg], once it has been checked with its inertia; 0 where it has none.

    Args:
        link: of the chain.
        where: for messages.
        moves: whether a joint comes before it.
        alone: whether it hangs on a moving joint itself, so that it may not be a point.
    """
    inertial = link.find("inertial")
    if inertial is None:
        return 0.0
    _check_origin(inertial, f"{where}: inertial")
    mass_kg = float(numbers(inertial.find("mass"), "value", 1, "", f"{where}: mass", "mass")[0])
    if mass_kg < 0.0:
        raise InputError(f"{where}: its mass is {mass_kg:g} kg; it must not be negative")
    tensor = inertial.find("inertia")
    defaults = [""] * 3 + ["0"] * 3
    six = [
        float(numbers(tensor, key, 1, default, f"{where}: inertia", "inertia")[0])
        for key, default in zip(_AXES, defaults, strict=True)
    ]
    if not moves:
        return mass_kg
    xx, yy, zz, xy, xz, yz = six
    principal = np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    if mass_kg == 0.0 and not any(six):
        return 0.0
    shown = ", ".join(f"{value:.3g}" for value in principal)
    if not (mass_kg > 0.0 and principal[0] >= -_ROUNDING * principal[2]):
        raise InputError(
            f"{where}: mass {mass_kg:g} kg and principal moments of inertia {shown} kg m^2 must be above 0"
        )
    if alone and not (mass_kg >= _LIGHTEST_kg and principal[0] >= _LEAST_INERTIA_kg_m2):
        raise InputError(
            f"{where}: mass {mass_kg:g} kg and principal moments of inertia {shown} kg m^2 are too small for "
            f"what hangs on a joint: at least {_LIGHTEST_kg:g} kg and {_LEAST_INERTIA_kg_m2:g} kg m^2"
        )
    if principal[0] + principal[1] < principal[2] * (1.0 - _ROUNDING):
        raise InputError(
            f"{where}: no body has the principal moments of inertia {shown} kg m^2: the largest is more than "
            "the sum of the others"
        )
    return mass_kg


def _check_carried(joint: str, mass_kg: float, path: Path) -> None:
    if mass_kg == 0.0:
        raise InputError(
            f"arm file {path}: joint {joint!r} moves nothing that has a mass; give the <inertial> of the "
            "links up to the next joint"
        )


def _check_shapes(link: ElementTree.Element, where: str) -> None:
    """Check that each shape of a link is one of those that a URDF may have, and has a size.

    Raises:
        InputError: it is not, or has none.
    """
    for shape in (*link.findall("visual"), *link.findall("collision")):
        _check_origin(shape, f"{where}: {shape.tag}")
        geometry = shape.find("geometry")
        solids = [] if geometry is None else list(geometry)
        if len(solids) != 1 or solids[0].tag not in _SIZES:
            raise InputError(f"{where}: a <{shape.tag}> needs one of {', '.join(_SIZES)} in its <geometry>")
        for key, count in _SIZES[solids[0].tag].items():
            if not (numbers(solids[0], key, count, "", f"{where}: {solids[0].tag}", "xyz") > 0.0).all():
                raise InputError(f"{where}: {key} of a {solids[0].tag} must be above 0")
