"""Schema of how a scenario is computed and recorded: clock, solver, plan, contact, gas, recording."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal, final

from annotated_types import Interval

from cosim.config.toml.constraints import Count, NonNegative, Positive


@final
@dataclass(frozen=True)
class ClockTable:
    """The lockstep clock: rigid and soft side advance by one tick at a time.

    Args:
        tick_s: of the lockstep clock: both sides advance by as much.
    """

    tick_s: Annotated[float, Interval(gt=0.0, le=0.1)] = 0.002


@final
@dataclass(frozen=True)
class SolverTable:
    """How the soft side is solved.

    Args:
        residual_tolerance_N: largest force component left at an equilibrium or a converged step; all that is
            left adds up to no more than 100 times that, nor does its moment, over the body's size.
        newton_iterations_max: bound for an equilibrium (quasistatic mode and the start).
        search_iterations_max: bound for all iterations of one search on the film: for the start, for an
            increment or a piece of a planned motion, for the tensions or flange pose of a tip target.
        dynamic_tolerance_N: the same in a tick of the dynamic mode.
        dynamic_newton_iterations: new tangents per tick in the dynamic mode, besides iterations with a
            kept one; a tick that is left far from balance takes more.
        integrator: of the dynamic mode.
        damping_per_s: mass-proportional damping, force = -damping_per_s * m * v.
        substep_error_m: the soft side's step is cut into up to 16 pieces where its error in a tick is larger;
            omitted: never.
    """

    residual_tolerance_N: Positive = 1e-6
    newton_iterations_max: Count = 100
    search_iterations_max: Count = 3000
    dynamic_tolerance_N: Positive = 1e-4
    dynamic_newton_iterations: Count = 1
    integrator: Literal["implicit_euler", "bdf2"] = "implicit_euler"
    damping_per_s: NonNegative = 0.0
    substep_error_m: Positive | None = None


@final
@dataclass(frozen=True)
class PlanTable:
    """What the planned way of the arm is checked for, before anything runs.

    Links count always; the soft robot, in its drawn shape, where the run does not model what it touches.

    Args:
        collision: of a link with another one, or with what no load can move. "refuse": it does not run;
            "warn": it is reported; "off": nobody looks.
        clearance_m: what stands nearer to links than this counts as well.
    """

    collision: Literal["refuse", "warn", "off"] = "warn"
    clearance_m: NonNegative = 0.0


@final
@dataclass(frozen=True)
class ContactTable:
    """Contact of the soft robot with the scene and with itself; in the quasistatic mode without friction.

    Args:
        enabled: whether contact with floor and objects is modelled.
        only_in_reach: not where nothing is within the film's reach of the flange's way.
        stiffness_N_m3: pressure per depth.
        smoothing_m: width of the transition; contact begins at half of it before touching.
        stick_m: tangential distance at which the full friction acts.
        self_contact: whether units and fingers touch one another, by the same law.
        self_friction: coefficient of sliding between films; without meaning in the quasistatic mode.
    """

    enabled: bool = True
    only_in_reach: bool = True
    stiffness_N_m3: Positive = 3e8
    smoothing_m: Positive = 1e-4
    stick_m: Positive = 1e-4
    self_contact: bool = False
    self_friction: NonNegative = 0.5


@final
@dataclass(frozen=True)
class ModelTable:
    """Switches for comparison with the paper and its published data.

    Args:
        published: the paper's lumped model, whatever the robot's file says: film law "plain"
            ("edge_strain" if the file says so), uniform hinges, no stiffeners, no finer
            mesh at the holes, no fused necks.
        closed: the end holes carry pressure (caps); otherwise the films only.
        all_hinges: every interior edge carries a hinge; otherwise the published subset.
    """

    published: bool = False
    closed: bool = True
    all_hinges: bool = True


@final
@dataclass(frozen=True)
class OrificeTable:
    """A hole or hose between two chambers; gas flows while both are sealed, dm/dt = conductance (p_1 - p_2).

    Args:
        chambers: names of the two.
        conductance_kg_s_Pa: mass per second and pascal.
    """

    chambers: tuple[str, str]
    conductance_kg_s_Pa: Positive


@final
@dataclass(frozen=True)
class GasTable:
    """The gas in the chambers, wherever a phase seals it.

    Args:
        exponent: gamma of p V^gamma, from 1 (slow, isothermal) to 1.4 (fast, adiabatic air).
        ambient_Pa: absolute pressure outside.
        temperature_K: of the gas when it is sealed; only a leak depends on it.
        orifices: `[[gas.orifice]]` in the file.
    """

    exponent: Annotated[float, Interval(ge=1.0, le=2.0)] = 1.4
    ambient_Pa: NonNegative = 101325.0
    temperature_K: Positive = 293.15
    orifices: tuple[OrificeTable, ...] = field(default=(), metadata={"alias": "orifice"})


@final
@dataclass(frozen=True)
class RecordingTable:
    """How often the recording holds the scene, in simulated time; curves have a point per tick.

    Args:
        frames_per_s: frames of the film per simulated second; curves have a point for every tick.
    """

    frames_per_s: Positive = 60.0
