"""A scenario as a co-simulation FMU (FMI 2): commands in, tip, flange wrench and joints out. The FMU runs in
the Python process that loads it, which needs cosim with the extra `fmi`.
"""

import re
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from pythonfmu import DefaultExperiment, Fmi2Causality, Fmi2Slave, Real
from pythonfmu.builder import FmuBuilder

from cosim.base.writing import writing
from cosim.config.loading import load_scenario, scenario_text
from cosim.devices.controller import Command
from cosim.errors import InputError

_SCENARIO: Final = "scenario.toml"
_SCRIPT: Final = '''"""Made by `cosim export-fmu`."""

from pathlib import Path

from cosim import Simulation
from cosim.app.fmu import ScenarioInTime
from pythonfmu import Fmi2Slave


class {name}(Fmi2Slave):
    """The scenario beside this file."""

    def __init__(self, **given):
        super().__init__(**given)
        self._scenario = ScenarioInTime(self, Simulation(Path(self.resources) / "scenario.toml"))

    def do_step(self, current_time, step_size):
        return self._scenario.step(step_size)
'''
"""The class inherits from `Fmi2Slave` itself, as pythonfmu 0.7.0 corrupts memory with a class in between."""
_WHOLE: Final = 1e-6
"""Tolerance of a communication step, in ticks."""


class ScenarioInTime:
    """The scenario of an FMU, stepped by whole ticks.

    An input acts as soon as it differs from its start value, which is that of the plan at rest. Its value is
    reached evenly within a communication step and then held; everything else follows the plan.

    Args:
        slave: to which the variables are added.
        simulation: of the scenario, a `cosim.Simulation` at its start.
    """

    def __init__(self, slave: Fmi2Slave, simulation: Any) -> None:
        self._slave, self._simulation = slave, simulation
        stage, start = simulation.stage, simulation.snapshot
        slave.description = stage.title
        slave.default_experiment = DefaultExperiment(0.0, stage.duration_s, stage.tick_s)
        groups = {
            "pressure_Pa": (stage.chamber_names, start.chamber_pressure_Pa),
            "cable_tension_N": (stage.cable_names, start.cable_tension_N),
            "joint_target": (stage.joint_names, start.joint_position),
        }
        self._inputs = {
            group: dict(zip(names, values.tolist(), strict=True)) for group, (names, values) in groups.items()
        }
        self._commanded: dict[str, dict[str, float]] = {group: {} for group in groups}
        self._has_new = False
        for group, values in self._inputs.items():
            for name in values:
                self._input(group, name)
        for vector in ("tip_position", "tip_direction", "flange_force", "flange_torque"):
            self._outputs(vector, "xyz")
        self._outputs("joint_position", stage.joint_names)
        self._outputs("chamber_pressure_Pa", stage.chamber_names)

    def _input(self, group: str, name: str) -> None:
        start, commanded = self._inputs[group], self._commanded[group]

        def set_value(value: float) -> None:
            if value != commanded.get(name, start[name]):
                commanded[name], self._has_new = value, True

        variable = Real(
            f"{group}.{name}", causality=Fmi2Causality.input, setter=set_value,
            getter=lambda: commanded.get(name, start[name]),
        )  # fmt: skip
        self._slave.register_variable(variable)

    def _outputs(self, figure: str, names: Sequence[str]) -> None:
        for k, name in enumerate(names):
            read = partial(self._read, figure, k)
            self._slave.register_variable(
                Real(f"{figure}.{name}", causality=Fmi2Causality.output, getter=read)
            )

    def _read(self, figure: str, k: int) -> float:
        return float(getattr(self._simulation.snapshot, figure)[k])

    def step(self, step_s: float) -> bool:
        """Take the ticks of a communication step [s].

        Raises:
            InputError: the step is not one of whole ticks, the scenario ends within it, or a command is
                refused.
            SolverError: the physics could not be solved.
        """
        tick_s = self._simulation.stage.tick_s
        ticks = round(step_s / tick_s)
        if ticks < 1 or abs(step_s / tick_s - ticks) > _WHOLE:
            raise InputError(
                f"the communication step is {step_s:g} s; must be one or several ticks of {tick_s:g} s"
            )
        command, self._has_new = (self._command() if self._has_new else None), False
        self._simulation.step(command, ticks=ticks)
        return True

    def _command(self) -> Command:
        joints, commanded = self._inputs["joint_target"], self._commanded
        target = {**joints, **commanded["joint_target"]}
        return Command(
            pressure_Pa=commanded["pressure_Pa"],
            cable_tension_N=commanded["cable_tension_N"],
            joint_position=list(target.values()) if commanded["joint_target"] else None,
        )


def write_fmu(scenario: str, path: Path, overrides: Mapping[str, Any] | None = None) -> None:
    """Write a scenario as an FMU; its model's name is that of the file.

    Args:
        scenario: name of a scenario that comes with cosim, or path of a .toml file.
        path: of the file, which ends in .fmu.
        overrides: values by key path.

    Raises:
        InputError: the scenario is wrong or quasi-static, or the file's name is no valid name of a model.
        OutputError: the file cannot be written.
        SolverError: there is no state at rest to start from.
    """
    name = path.stem
    if path.suffix != ".fmu" or not re.fullmatch("[A-Za-z_][A-Za-z0-9_]*", name):
        raise InputError(f"{path}: must be a name of letters, digits and underscores that ends in .fmu")
    checked = load_scenario(scenario, overrides)
    if checked.mode != "dynamic":
        raise InputError(f"mode is {checked.mode!r}; an FMU needs time: set mode to 'dynamic'")
    with TemporaryDirectory() as folder, writing(path):
        script = Path(folder) / f"{name}.py"
        script.write_text(_SCRIPT.format(name=name), encoding="utf-8")
        (Path(folder) / _SCENARIO).write_text(scenario_text(checked), encoding="utf-8")
        sys.path.insert(0, folder)  # the builder imports the script by its name
        try:
            FmuBuilder.build_FMU(script, path, project_files=[Path(folder) / _SCENARIO])
        finally:
            sys.path.remove(folder)
            sys.modules.pop(name, None)
