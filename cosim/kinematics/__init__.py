"""The arm's kinematics and dynamics in closed form, by Pinocchio."""

from cosim.kinematics.arm import Arm, Payload
from cosim.kinematics.inverse_kinematics import InverseKinematicsOptions, Solution, follow, solve

__all__ = ["Arm", "InverseKinematicsOptions", "Payload", "Solution", "follow", "solve"]
