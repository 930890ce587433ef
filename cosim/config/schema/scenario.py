"""Table of a scenario's file. The tables are frozen, units are SI and part of the keys' names, and poses are
in the world frame, z up.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Literal, TypeAlias, final

from cosim.config.arm_table import BaseTable
from cosim.config.schema import pattern as _pattern  # noqa: F401  # makes its kind of body known
from cosim.config.schema.devices import ControllerTable, PumpTable, WinchTable
from cosim.config.schema.given_body import AnySoftRobot
from cosim.config.schema.objects import ObjectTable, SceneTable, WireTable
from cosim.config.schema.phase import HOLD, CommandTable, PhaseTable, StartTable
from cosim.config.schema.sensors import CameraTable, SensorTable
from cosim.config.schema.settings import (
    ClockTable,
    ContactTable,
    CouplingTable,
    GasTable,
    ModelTable,
    PlanTable,
    RecordingTable,
    SolverTable,
)
from cosim.config.toml.quantities import Acceleration, Name, SchemaNumber, Text
from cosim.config.toml.tables import Table

Fidelity: TypeAlias = Literal["rigid", "section", "lumped", "refined"]
"""Models of the soft robot, from the fastest to the most accurate."""


NO_ARM: Final = "none"


@final
@dataclass(frozen=True)
class Scenario(Table):
    """Everything a run depends on.

    Args:
        schema: number of the file format; `cosim upgrade` rewrites files with an older one.
        title: one line for people: on screen, in the recording, in the summary.
        mode: "dynamic": ticks of time, with inertia; "quasistatic": equilibria, increment by increment.
        gravity_m_s2: world axes.
        name: of the scenario; the file's name if omitted.
        robot: rigid arm: a directory of robots/ that holds an arm.toml, or the path of a URDF (.urdf), an
            MJCF (.xml) or an arm.toml, from the folder of the scenario; or "menagerie:MODEL", of MuJoCo
            Menagerie on this machine ("menagerie:MODEL/FILE" if it has several files); "none": no arm, the
            base is held at the flange's pose of the start.
        arm_base: pose of the arm's root link, on a table, a wall or below a ceiling; omitted: that of the
            arm's file.
        soft_robot: in the file a name, a path, or a table `{file = NAME, ...}` of changes to that file.
        fidelity: of the soft robot. "rigid": it keeps its shape of the start, mass only; "section": a chain
            of rigid frames, one per ring, with the condensed energy of the film between them; "lumped": the
            mesh of its file; "refined": that mesh with every triangle divided into four.
        payload_compensation: whether the arm's feedforward includes the soft robot's weight.
        objects: `[[object]]` in the file.
        scene: cell around the arm.
        wires: `[[wire]]` in the file.
        phases: `[[phase]]` in the file; without any, the scenario holds its start, and only the commands of
            `cosim.Simulation.step` move it.
        pumps, winches, controllers: `[[pump]]`, `[[winch]]`, `[[controller]]` in the file.
        sensors, cameras: `[[sensor]]`, `[[camera]]` in the file.
        commands: `[[command]]` in the file; each changes the commands of those before it. Kinds are
            registered from Python.
    """

    schema: SchemaNumber
    name: Name
    title: Text
    robot: str
    soft_robot: AnySoftRobot
    start: StartTable
    phases: tuple[PhaseTable, ...] = field(default=(), metadata={"alias": "phase"})
    mode: Literal["dynamic", "quasistatic"] = "dynamic"
    fidelity: Fidelity = "lumped"
    arm_base: BaseTable | None = None
    gravity_m_s2: tuple[Acceleration, Acceleration, Acceleration] = (0.0, 0.0, -9.81)
    payload_compensation: bool = True
    clock: ClockTable = ClockTable()
    solver: SolverTable = SolverTable()
    plan: PlanTable = PlanTable()
    contact: ContactTable = ContactTable()
    coupling: CouplingTable = CouplingTable()
    model: ModelTable = ModelTable()
    gas: GasTable = GasTable()
    recording: RecordingTable = RecordingTable()
    objects: tuple[ObjectTable, ...] = field(default=(), metadata={"alias": "object"})
    scene: SceneTable | None = None
    wires: tuple[WireTable, ...] = field(default=(), metadata={"alias": "wire"})
    pumps: tuple[PumpTable, ...] = field(default=(), metadata={"alias": "pump"})
    winches: tuple[WinchTable, ...] = field(default=(), metadata={"alias": "winch"})
    controllers: tuple[ControllerTable, ...] = field(default=(), metadata={"alias": "controller"})
    sensors: tuple[SensorTable, ...] = field(default=(), metadata={"alias": "sensor"})
    cameras: tuple[CameraTable, ...] = field(default=(), metadata={"alias": "camera"})
    commands: tuple[CommandTable, ...] = field(default=(), metadata={"alias": "command"})

    @property
    def touches_itself(self) -> bool:
        """Whether contact of the soft robot with itself is modelled."""
        asked = self.contact.self_contact
        return self.fidelity != "rigid" and (asked is True or (asked == "auto" and not self.model.published))

    def ticks(self, phase: PhaseTable) -> int:
        """Return how many ticks of the clock a phase lasts, at least one."""
        return max(1, round((phase.duration_s + phase.settle_s) / self.clock.tick_s))

    @property
    def endless(self) -> bool:
        """Whether it has no phases, so that its duration is unbounded."""
        return self.phases in ((), (HOLD,))
