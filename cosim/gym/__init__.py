"""Tasks for learning, as Gymnasium environments, which are registered when this module is imported."""

from typing import Final

from cosim.errors import InputError

try:
    import gymnasium
except ModuleNotFoundError as error:
    raise InputError("cosim.gym needs Gymnasium: pip install 'cosim[gym]'") from error

ENVIRONMENTS: Final = {
    "cosim/TipReach-v0": "cosim.gym.arm_tasks:TipReach",
    "cosim/TipFollow-v0": "cosim.gym.arm_tasks:TipFollow",
    "cosim/GraspLift-v0": "cosim.gym.grasp_task:GraspLift",
}
"""Class of the task, by id."""

for _name, _task in ENVIRONMENTS.items():
    if _name not in gymnasium.registry:
        gymnasium.register(
            _name,
            entry_point="cosim.gym.environment:environment",
            vector_entry_point="cosim.gym.vector_environment:vector_environment",
            kwargs={"task": _task},
        )
