"""Cosimulation of rigid cobots with soft, cable-driven pneumatic end effectors.

`run(scenario)` runs a scenario and returns its arrays; `Simulation(scenario)` steps one by hand, to be
saved, restored and branched; `list_scenarios()` names those that come with
cosim. Importing cosim is cheap: the simulator is loaded on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from cosim._version import __version__ as __version__

if TYPE_CHECKING:
    from cosim.app.api import run as run
    from cosim.app.api import run_arms as run_arms
    from cosim.app.attach import attach as attach
    from cosim.app.attached import Attached as Attached
    from cosim.app.batch import Batch as Batch
    from cosim.app.ended_run import load_run as load_run
    from cosim.app.error_bars import error_bars as error_bars
    from cosim.app.joint_paths import plan_path as plan_path
    from cosim.app.joint_paths import run_path as run_path
    from cosim.app.payload import payload_torque as payload_torque
    from cosim.app.picture import picture as picture
    from cosim.app.progress import ProgressBar as ProgressBar
    from cosim.app.replay import replay as replay
    from cosim.app.run_follower import Observer as Observer
    from cosim.app.simulation import SavedState as SavedState
    from cosim.app.simulation import Simulation as Simulation
    from cosim.app.twin import Prediction as Prediction
    from cosim.app.twin import Twin as Twin
    from cosim.base.frames import Pose as Pose
    from cosim.base.kept_parts import KeptParts as KeptParts
    from cosim.base.resources import list_scenarios as list_scenarios
    from cosim.bench.linear_model import LinearModel as LinearModel
    from cosim.bench.linear_model import linearise as linearise
    from cosim.bench.sensitivity import Jacobian as Jacobian
    from cosim.bench.sensitivity import sensitivity as sensitivity
    from cosim.config.loading import load_scenario as load_scenario
    from cosim.config.toml.tables import register_kind as register_kind
    from cosim.devices.controller import Command as Command
    from cosim.devices.controller import Controller as Controller
    from cosim.devices.controller import Measurement as Measurement
    from cosim.errors import ConvergenceError as ConvergenceError
    from cosim.errors import CosimError as CosimError
    from cosim.errors import InputError as InputError
    from cosim.errors import InstabilityError as InstabilityError
    from cosim.errors import MeshError as MeshError
    from cosim.errors import OutOfRangeError as OutOfRangeError
    from cosim.errors import OutputError as OutputError
    from cosim.errors import RunInterrupted as RunInterrupted
    from cosim.errors import ScenarioError as ScenarioError
    from cosim.errors import SceneError as SceneError
    from cosim.errors import SensitivityError as SensitivityError
    from cosim.errors import SolverError as SolverError
    from cosim.errors import TickWorkError as TickWorkError
    from cosim.errors import UnreachableError as UnreachableError
    from cosim.errors import WorkerError as WorkerError
    from cosim.results.episodes import LearningEpisode as LearningEpisode
    from cosim.results.episodes import episode_of as episode_of
    from cosim.results.episodes import write_episodes as write_episodes
    from cosim.results.joint_table import JointTable as JointTable
    from cosim.results.result import RunResult as RunResult
    from cosim.sweeps.plot import plot_sweep as plot_sweep
    from cosim.sweeps.study_run import SweepOutcome as SweepOutcome
    from cosim.sweeps.study_run import SweepProgress as SweepProgress
    from cosim.sweeps.sweeping import sweep as sweep
    from cosim.sweeps.table import open_sweep as open_sweep

_NAMES = {
    "cosim.app.api": "run run_arms",
    "cosim.app.attach": "attach",
    "cosim.app.attached": "Attached",
    "cosim.app.batch": "Batch",
    "cosim.app.ended_run": "load_run",
    "cosim.app.error_bars": "error_bars",
    "cosim.app.joint_paths": "plan_path run_path",
    "cosim.app.payload": "payload_torque",
    "cosim.app.picture": "picture",
    "cosim.app.progress": "ProgressBar",
    "cosim.app.replay": "replay",
    "cosim.app.run_follower": "Observer",
    "cosim.app.simulation": "SavedState Simulation",
    "cosim.app.twin": "Prediction Twin",
    "cosim.base.frames": "Pose",
    "cosim.base.kept_parts": "KeptParts",
    "cosim.base.resources": "list_scenarios",
    "cosim.bench.linear_model": "LinearModel linearise",
    "cosim.bench.sensitivity": "Jacobian sensitivity",
    "cosim.config.loading": "load_scenario",
    "cosim.config.toml.tables": "register_kind",
    "cosim.devices.controller": "Command Controller Measurement",
    "cosim.errors": (
        "ConvergenceError CosimError InputError InstabilityError MeshError OutOfRangeError "
        "OutputError RunInterrupted ScenarioError SceneError SensitivityError SolverError "
        "TickWorkError UnreachableError WorkerError"
    ),
    "cosim.results.episodes": "LearningEpisode episode_of write_episodes",
    "cosim.results.joint_table": "JointTable",
    "cosim.results.result": "RunResult",
    "cosim.sweeps.plot": "plot_sweep",
    "cosim.sweeps.study_run": "SweepOutcome SweepProgress",
    "cosim.sweeps.sweeping": "sweep",
    "cosim.sweeps.table": "open_sweep",
}
"""By module, the public names that are loaded from it."""

_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = ["__version__", *sorted(_HOMES)]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'cosim' has no attribute '{name}'; it has {', '.join(__all__)}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
