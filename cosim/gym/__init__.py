"""Tasks for learning, as Gymnasium environments: importing this registers them, as Gymnasium has it."""

from typing import Final

from cosim.errors import InputError

try:
    import gymnasium
except ModuleNotFoundError as error:
    raise InputError("cosim.gym needs Gymnasium: pip install 'cosim[gym]'") from error

ENVIRONMENTS: Final = {
    "cosim/TipReach-v0": "cosim.gym.tasks:TipReach",
    "cosim/TipFollow-v0": "cosim.gym.tasks:TipFollow",
    "cosim/GraspLift-v0": "cosim.gym.tasks:GraspLift",
}
"""Ids, and the class of the task of each."""

for _name, _task in ENVIRONMENTS.items():
    if _name not in gymnasium.registry:
        gymnasium.register(
            _name,
            entry_point="cosim.gym.environment:environment",
            vector_entry_point="cosim.gym.environment:vector_environment",
            kwargs={"task": _task},
        )
