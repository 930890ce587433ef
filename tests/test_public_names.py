"""What `import cosim` offers, and that it costs nothing."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

import cosim
from cosim import errors

EXPECTED = {
    "Attached",
    "attach",
    "Batch",
    "Command",
    "Controller",
    "ConvergenceError",
    "CosimError",
    "InputError",
    "InstabilityError",
    "Jacobian",
    "LinearModel",
    "Measurement",
    "JointTable",
    "KeptParts",
    "LearningEpisode",
    "episode_of",
    "error_bars",
    "write_episodes",
    "MeshError",
    "Observer",
    "OutOfRangeError",
    "OutputError",
    "Pose",
    "Prediction",
    "ProgressBar",
    "RunInterrupted",
    "RunResult",
    "SavedState",
    "ScenarioError",
    "SceneError",
    "SensitivityError",
    "Simulation",
    "SolverError",
    "SweepOutcome",
    "SweepProgress",
    "TickWorkError",
    "Twin",
    "UnreachableError",
    "WorkerError",
    "__version__",
    "linearise",
    "list_scenarios",
    "load_run",
    "load_scenario",
    "picture",
    "open_sweep",
    "plot_sweep",
    "payload_torque",
    "plan_path",
    "register_kind",
    "replay",
    "run",
    "run_arms",
    "run_path",
    "sensitivity",
    "sweep",
}
HEAVY = ("numpy", "scipy", "numba", "mujoco", "pinocchio", "rerun")
NEVER = ("rerun", "matplotlib", "scipy.optimize", "scipy.interpolate", "scipy.spatial", "scipy.stats")
"""What takes long to load, and neither a check, nor a plan, nor a run without a recording needs."""


def test_exactly_these_names_are_public() -> None:
    assert set(cosim.__all__) == EXPECTED
    assert set(dir(cosim)) >= EXPECTED


@pytest.mark.parametrize("name", sorted(EXPECTED))
def test_every_public_name_resolves(name: str) -> None:
    assert getattr(cosim, name) is not None


def test_type_checkers_see_the_same_names() -> None:
    tree = ast.parse(Path(inspect.getfile(cosim)).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    imported = {
        alias.asname for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert imported | {"__version__"} == EXPECTED


def test_unknown_names_are_refused() -> None:
    with pytest.raises(AttributeError, match="list_scenarios"):
        _ = cosim.nothing


def test_every_error_is_in_the_tree_that_the_module_draws() -> None:
    classes = [
        kind for kind in vars(errors).values() if inspect.isclass(kind) and kind.__module__ == errors.__name__
    ]
    assert errors.__doc__ is not None
    for kind in classes:
        # who goes on after a CosimError still stops at Ctrl-C
        assert issubclass(kind, errors.CosimError | KeyboardInterrupt)
        assert kind.__name__ in errors.__doc__
        assert kind.__name__ in EXPECTED


def test_importing_cosim_loads_no_engine() -> None:
    code = f"import sys, cosim; print([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_wrong_input_is_refused_without_loading_an_engine() -> None:
    code = (
        "import sys; from cosim.cli.main import main;"
        "main(['run', 'ur5e_hexagon_arm', '--set', 'clock.tick_s=0']);"
        "print([name for name in ('mujoco', 'pinocchio', 'rerun', 'numba') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("arguments", "unneeded"),
    [
        (["check", "ur5e_hexagon_arm"], (*NEVER, "scipy.linalg", "pandas", "cosim.soft.solve.newton")),
        (["export-path", "ur5e_hexagon_arm", "path.csv", "--whole"], NEVER),  # plans tip targets
        (["run", "three_unit_inflation", "--quiet", "--no-error", "--no-recording"], NEVER),
    ],
)
def test_commands_load_only_what_they_need(
    arguments: list[str], unneeded: Sequence[str], tmp_path: Path
) -> None:
    code = (
        f"import sys; from cosim.cli.main import main; assert main({arguments!r}) == 0;"
        f"print([name for name in {unneeded!r} if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert done.stdout.splitlines()[-1] == "[]"
