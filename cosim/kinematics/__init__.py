"""The arm's kinematics and dynamics in closed form, by Pinocchio."""

from cosim.kinematics.arm import Arm, Payload

__all__ = ["Arm", "Payload"]
