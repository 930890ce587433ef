"""Attaches a soft robot to a user's MuJoCo model."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.app.attached import Attached
from cosim.app.preparation import named_body
from cosim.config.loading import load_scenario, load_soft_robot
from cosim.config.plugins import note_kinds
from cosim.config.schema.phase import FlangePoseTable, StartTable
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.config.schema.settings import ClockTable
from cosim.errors import InputError

if TYPE_CHECKING:
    from cosim.build.given_body import AnyBody
    from cosim.rigid.scene.host_model import HostModel, HostSource


def attach(
    spec: HostSource,
    at: str | tuple[str, str],
    robot: str | Path | None = None,
    *,
    tick_s: float | None = None,
    overrides: Mapping[str, Any] | None = None,
    body: AnyBody | None = None,
) -> Attached:
    """Mount a soft robot on a site or body of a MuJoCo model, to step it in the user's loop.

    Args:
        spec: `mujoco.MjSpec`, which is compiled afterwards; path of an MJCF, which `Attached.spec` is then
            read from; or a compiled `mujoco.MjModel`.
        at: name of a site, or else of a body: its frame is the flange, the soft robot hangs along its z axis.
            Two names: a soft joint, whose tip ring is glued to the second, as it is at the start.
        robot: name of a soft robot that comes with cosim, or path of its file.
        tick_s: of the soft robot, one or several timesteps; None: MuJoCo's timestep.
        overrides: values by key path of a scenario, such as {"fidelity": "section",
            "start.pressure_Pa": 20e3, "solver.damping_per_s": 2.0}; gravity and clock are the model's.
        body: a soft body in place of `robot`.

    Raises:
        InputError: the model has no such site or body, its integrator is RK4, a key is wrong, or the soft
            joint's model has no deformable film.
    """
    from cosim.rigid.scene.host_model import HostModel  # here: it loads MuJoCo

    if (robot is None) == (body is None):
        raise InputError("robot and body: give one of them, the name or file of a soft robot or a soft body")
    named, changes = named_body(body), dict(overrides or {})
    for key, where in (("clock.tick_s", "tick_s"), ("gravity_m_s2", "model.opt.gravity"), ("robot", "spec")):
        if key in changes:
            raise InputError(f"overrides: {key} cannot be set here; {where} has it")
    host = HostModel.of(spec, at, tick_s)
    scenario = load_scenario(_scenario(host, robot), changes, named and named.table())
    if not scenario.endless or scenario.mode != "dynamic" or scenario.coupling.scheme != "staggered":
        raise InputError(
            "overrides: attached soft robots have no phases, mode 'dynamic', coupling.scheme 'staggered'; "
            "leave these keys out"
        )
    if host.far is not None and scenario.fidelity not in ("lumped", "refined"):
        raise InputError(
            f"overrides: fidelity is {scenario.fidelity!r}; a soft joint needs 'lumped' or 'refined'"
        )
    note_kinds(scenario)
    return Attached(scenario, host, named and named.body)


def _scenario(host: HostModel, robot: str | Path | None) -> Scenario:
    """Return a scenario that holds a soft robot at rest; it starts at the pose of the mount."""
    start = StartTable(FlangePoseTable((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    table = load_soft_robot("hexagon_arm" if robot is None else robot)
    tick_s = host.steps * host.timestep_s
    return Scenario(
        2, "attached", f"a soft robot at {host.at}", NO_ARM, table, start,
        gravity_m_s2=host.gravity, clock=ClockTable(tick_s),
    )  # fmt: skip
