"""The rigid side: arm, servos, objects and their contacts, hosted by MuJoCo."""

from cosim.rigid.description import SceneDescription, SceneObject, ServoGains
from cosim.rigid.scene import RigidScene
from cosim.rigid.state import RigidState

__all__ = ["RigidScene", "RigidState", "SceneDescription", "SceneObject", "ServoGains"]
