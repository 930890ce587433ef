"""Schema of a scenario file: frozen, SI units in the names of the keys, world frame, z up."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Final, Literal, final

from cosim.config.arms.arm_table import BaseTable
from cosim.config.schema.commands import CommandTable
from cosim.config.schema.coupling import CouplingTable
from cosim.config.schema.devices import ControllerTable, PumpTable, WinchTable
from cosim.config.schema.fidelity import AutoTable, Fidelity
from cosim.config.schema.given_body import AnySoftRobot, InFiles
from cosim.config.schema.objects import ObjectTable, SceneTable
from cosim.config.schema.phase import HOLD, PhaseTable, StartTable
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.config.schema.solver import (
    ClockTable,
    ContactTable,
    GasTable,
    ModelTable,
    PlanTable,
    RecordingTable,
    SolverTable,
)
from cosim.config.schema.wire import WireTable
from cosim.config.toml.constraints import Name, Text, Vector3

NO_ARM: Final = "none"


@final
@dataclass(frozen=True)
class Scenario:
    """Everything a run depends on.

    Args:
        schema: number of the names of the keys; an older one is refused, `cosim upgrade` rewrites it.
        title: one line for people: on screen, in the recording, in the summary.
        mode: "dynamic": ticks of time, with inertia; "quasistatic": equilibria, increment by increment.
        gravity_m_s2: world axes.
        name: of the scenario; the file's name if omitted.
        robot: rigid arm: a directory of robots/ that holds an arm.toml, or the path of a URDF (.urdf), an
            MJCF (.xml) or an arm.toml, from the folder of the scenario; or "menagerie:MODEL", of MuJoCo
            Menagerie on this machine ("menagerie:MODEL/FILE" where it has several files); "none": the base
            is held where the flange starts, and nothing of an arm is loaded.
        arm_base: where the arm's root link stands, on a table, a wall or below a ceiling; omitted: as its own
            file says.
        soft_robot: in the file a name, a path, or a table `{file = NAME, ...}` of changes to that file.
        fidelity: of the soft robot. "rigid": it keeps the shape it starts in, mass only; "section": a chain
            of rigid frames, one per ring, with the condensed energy of the film between them; "lumped": the
            mesh of its file; "refined": every triangle of that divided into four; "auto": chosen by a
            short trade, tick and integrator with it, so that `[auto]` is met.
        payload_compensation: the arm's feedforward knows the soft arm's weight.
        objects: `[[object]]` in the file.
        scene: of other things around the arm.
        wires: `[[wire]]` in the file.
        phases: `[[phase]]` in the file; without any, it holds its start for as long as it is stepped, and
            is moved by the commands of `cosim.Simulation.step` alone.
        pumps, winches, controllers: `[[pump]]`, `[[winch]]`, `[[controller]]` in the file.
        commands: `[[command]]` in the file, each of which changes what those before it ask for; kinds are
            registered from Python.
    """

    schema: Literal[2]
    name: Name
    title: Text
    robot: str
    soft_robot: Annotated[AnySoftRobot, InFiles(SoftRobotTable)]
    start: StartTable
    phases: tuple[PhaseTable, ...] = field(default=(), metadata={"alias": "phase"})
    mode: Literal["dynamic", "quasistatic"] = "dynamic"
    fidelity: Fidelity = "lumped"
    auto: AutoTable | None = None
    arm_base: BaseTable | None = None
    gravity_m_s2: Vector3 = (0.0, 0.0, -9.81)
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
    commands: tuple[CommandTable, ...] = field(default=(), metadata={"alias": "command"})

    @property
    def endless(self) -> bool:
        """Whether it has no phases of its own, and lasts as long as it is stepped."""
        return self.phases in ((), (HOLD,))
