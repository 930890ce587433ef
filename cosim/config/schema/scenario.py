"""Schema of a scenario file: frozen, SI units in the names of the keys, world frame, z up."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Final, Literal, final

from cosim.config.schema.coupling import Coupling
from cosim.config.schema.devices import ControllerDevice, PumpDevice, WinchDevice
from cosim.config.schema.fidelity import Auto, Fidelity
from cosim.config.schema.objects import SceneObject
from cosim.config.schema.phase import Phase, Start
from cosim.config.schema.soft_robot import SoftRobot
from cosim.config.schema.solver import ChamberModel, Clock, Contact, Gas, Recording, Solver
from cosim.config.schema.wire import Wire
from cosim.config.toml.constraints import Length, Name, Text, Vector3

NO_ARM: Final = "none"


@final
@dataclass(frozen=True)
class Scenario:
    """Everything a run depends on.

    Args:
        name: of the scenario; the file's name if omitted.
        robot: rigid arm: a directory of robots/, or an arm of example-robot-data; "none": the base is
            held where the flange starts, and nothing of an arm is loaded.
        soft_robot: in the file a name, a path, or a table `{file = NAME, ...}` of changes to that file.
        fidelity: of the soft robot. "rigid": it keeps the shape it starts in, mass only; "section": a chain
            of rigid frames, one per ring, with the condensed energy of the film between them; "lumped": the
            mesh of its file; "refined": every triangle of that divided into four; "auto": chosen by a
            short trade, tick and integrator with it, so that `[auto]` is met.
        payload_compensation: the arm's feedforward knows the soft arm's weight.
        objects: `[[object]]` in the file.
        wires: `[[wire]]` in the file.
        phases: `[[phase]]` in the file.
        pumps, winches, controllers: `[[pump]]`, `[[winch]]`, `[[controller]]` in the file.
    """

    schema: Literal[1]
    name: Name
    title: Text
    robot: str
    soft_robot: SoftRobot
    start: Start
    phases: Annotated[tuple[Phase, ...], Length(at_least=1)] = field(metadata={"key": "phase"})
    mode: Literal["dynamic", "quasistatic"] = "dynamic"
    fidelity: Fidelity = "lumped"
    auto: Auto | None = None
    gravity_m_s2: Vector3 = (0.0, 0.0, -9.81)
    payload_compensation: bool = True
    clock: Clock = Clock()
    solver: Solver = Solver()
    contact: Contact = Contact()
    coupling: Coupling = Coupling()
    chamber: ChamberModel = ChamberModel()
    gas: Gas = Gas()
    recording: Recording = Recording()
    objects: tuple[SceneObject, ...] = field(default=(), metadata={"key": "object"})
    wires: tuple[Wire, ...] = field(default=(), metadata={"key": "wire"})
    pumps: tuple[PumpDevice, ...] = field(default=(), metadata={"key": "pump"})
    winches: tuple[WinchDevice, ...] = field(default=(), metadata={"key": "winch"})
    controllers: tuple[ControllerDevice, ...] = field(default=(), metadata={"key": "controller"})
