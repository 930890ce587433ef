"""The Pinocchio model of an arm."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import pinocchio as pin

from cosim.base.arm_file import ArmFile
from cosim.errors import InputError


def model_of(arm: ArmFile) -> pin.Model:
    """Return the model of an arm's chain; joints are those of the arm, with an angle each.

    Raises:
        InputError: Pinocchio cannot read it, or finds other joints.
    """
    try:
        model = pin.buildModelFromXML(_bare_chain(arm))
    except (RuntimeError, ValueError) as error:
        text = str(error).replace("\n", ", ")
        raise InputError(f"arm {arm.name!r}: Pinocchio cannot read {arm.path}: {text}") from None
    if model.nq != model.nv or tuple(model.names[1:]) != arm.joint_names:
        raise InputError(f"arm {arm.name!r}: joints {tuple(model.names[1:])}, expected {arm.joint_names}")
    return model


def _bare_chain(arm: ArmFile) -> str:
    """Return the chain without shapes, and with continuous joints as revolute ones.

    Of a continuous joint Pinocchio would have cosine and sine in place of the angle; shapes it does not need,
    but complains about.
    """
    robot = ElementTree.fromstring(arm.urdf)
    for link in robot.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    for joint in robot.findall("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            for limit in joint.findall("limit"):
                limit.set("lower", "-1e6")
                limit.set("upper", "1e6")
    return ElementTree.tostring(robot, encoding="unicode")
