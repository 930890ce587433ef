"""The rigid side: arm, servos, objects and their contacts, hosted by MuJoCo."""

from cosim.rigid.build.description import SceneDescription, SceneObject, ServoGains
from cosim.rigid.scene.scene import RigidScene, RigidState

__all__ = ["RigidScene", "RigidState", "SceneDescription", "SceneObject", "ServoGains"]
