"""A scenario as a co-simulation FMU (FMI 2): commands in, tip, flange wrench and joints out.

The FMU runs cosim in the Python that it is loaded into, so cosim and its packages are installed there.
Needs the extra `fmi`, as does whoever loads the FMU.
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
"""pythonfmu 0.7.0 corrupts memory where a slave's class inherits from it by way of another class."""
_WHOLE: Final = 1e-6
"""Share of a tick by which a communication step may differ from whole ticks."""


class ScenarioInTime:
    """The scenario of an FMU, stepped by whole ticks.

    An input acts from when it first differs from its start value, which is that of the plan at rest. Its
    value is reached evenly within a communication step and held then; all else goes as planned.

    Args:
        slave: gets the variables.
        simulation: of the scenario, a `cosim.Simulation` at its start.
    """

    def __init__(self, slave: Fmi2Slave, simulation: Any) -> None:
        self._slave, self._simulation = slave, simulation
        stage, seen = simulation.stage, simulation.snapshot
        slave.description = stage.title
        slave.default_experiment = DefaultExperiment(0.0, stage.duration_s, stage.tick_s)
        groups = {
            "pressure_Pa": (stage.chamber_names, seen.chamber_pressure_Pa),
            "cable_tension_N": (stage.cable_names, seen.cable_tension_N),
            "joint_target": (stage.joint_names, seen.joint_position),
        }
        self._inputs = {
            group: dict(zip(names, values.tolist(), strict=True)) for group, (names, values) in groups.items()
        }
        self._asked: dict[str, dict[str, float]] = {group: {} for group in groups}
        self._new = False
        for group, start in self._inputs.items():
            for name in start:
                self._input(group, name)
        for vector in ("tip_position", "tip_direction", "flange_force", "flange_torque"):
            self._outputs(vector, "xyz")
        self._outputs("joint_position", stage.joint_names)
        self._outputs("chamber_pressure_Pa", stage.chamber_names)

    def _input(self, group: str, name: str) -> None:
        start, asked = self._inputs[group], self._asked[group]

        def take(value: float) -> None:
            if value != asked.get(name, start[name]):
                asked[name], self._new = value, True

        variable = Real(
            f"{group}.{name}", causality=Fmi2Causality.input, setter=take,
            getter=lambda: asked.get(name, start[name]),
        )  # fmt: skip
        self._slave.register_variable(variable)

    def _outputs(self, figure: str, names: Sequence[str]) -> None:
        for k, name in enumerate(names):
            read = partial(self._read, figure, k)
            self._slave.register_variable(
                Real(f"{figure}.{name}", causality=Fmi2Causality.output, getter=read)
            )

    def _read(self, figure: str, k: int) -> float:
        seen = self._simulation.snapshot
        if figure.startswith("flange_"):
            return float(getattr(seen.flange_wrench, figure.removeprefix("flange_"))[k])
        return float(getattr(seen, figure)[k])

    def step(self, step_s: float) -> bool:
        """Take the ticks of a communication step [s]; errors reach whoever has loaded the FMU.

        Raises:
            InputError: it is not one of whole ticks, the scenario ends within it, or a command is refused.
            SolverError: the physics could not be solved.
        """
        tick_s = self._simulation.stage.tick_s
        ticks = round(step_s / tick_s)
        if ticks < 1 or abs(step_s / tick_s - ticks) > _WHOLE:
            raise InputError(
                f"the communication step is {step_s:g} s; must be one or several ticks of {tick_s:g} s"
            )
        command, self._new = (self._command() if self._new else None), False
        self._simulation.step(command, ticks=ticks)
        return True

    def _command(self) -> Command:
        joints, asked = self._inputs["joint_target"], self._asked
        target = {**joints, **asked["joint_target"]}
        return Command(
            pressure_Pa=asked["pressure_Pa"],
            cable_tension_N=asked["cable_tension_N"],
            joint_position=list(target.values()) if asked["joint_target"] else None,
        )


def write_fmu(scenario: str, path: Path, overrides: Mapping[str, Any] | None = None) -> None:
    """Write a scenario as an FMU; its model's name is that of the file.

    Args:
        scenario: name of a scenario that comes with cosim, or path of a .toml file.
        path: of the file, which ends in .fmu.
        overrides: values by key path.

    Raises:
        InputError: the scenario is wrong, quasi-static, or the name of the file is none for a model.
        OutputError: it cannot be written.
        SolverError: there is no state at rest to start from.
    """
    name = path.stem
    if path.suffix != ".fmu" or not re.fullmatch("[A-Za-z_][A-Za-z0-9_]*", name):
        raise InputError(f"{path}: must be a name of letters, digits and underscores that ends in .fmu")
    checked = load_scenario(scenario, overrides)
    if checked.mode != "dynamic":
        raise InputError(f"mode is {checked.mode!r}; an FMU has time, set mode to 'dynamic'")
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
