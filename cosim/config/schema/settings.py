"""Tables that say how a scenario is computed and recorded: clock, solver, plan, contact, gas, coupling,
model, recording.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal, final

from annotated_types import Interval

from cosim.config.toml.quantities import (
    Count,
    NonNegative,
    NonNegativeLength,
    NonNegativePressure,
    NonNegativeRate,
    PositiveConductance,
    PositiveContactStiffness,
    PositiveForce,
    PositiveLength,
    PositiveRate,
    PositiveTemperature,
)
from cosim.config.toml.tables import Table


@final
@dataclass(frozen=True)
class CouplingTable(Table):
    """How arm, objects and soft robot exchange their loads in the dynamic mode.

    Args:
        scheme: "staggered": each side takes one step per tick, and loads act one tick later; bodies carry
            added inertia if the soft robot is heavy compared with them. "iterated": a tick is repeated until
            the loads of both sides agree.
        tolerance: of that agreement: difference of the loads over their size.
        iterations_max: trials of a tick before the run fails.
    """

    scheme: Literal["staggered", "iterated"] = "staggered"
    tolerance: Annotated[float, Interval(ge=1e-12, le=1e-3)] = 1e-9
    iterations_max: Count = 30


@final
@dataclass(frozen=True)
class ClockTable(Table):
    """The lockstep clock: rigid and soft side advance by one tick at a time.

    Args:
        tick_s: time step of both sides. Phases last whole ticks; a run warns if it rounds one.
    """

    tick_s: Annotated[float, Interval(gt=0.0, ge=1e-6, le=0.1)] = 0.002


@final
@dataclass(frozen=True)
class SolverTable(Table):
    """How the soft side is solved.

    Args:
        residual_tolerance_N: largest component of the residual force at an equilibrium. The sum of the
            residual forces, and their moment over the body's size, are at most 100 times that.
        search_iterations_max: bound for the Newton iterations of one search on the film: for the start, an
            increment, a step of a planned motion, the tensions or the flange pose of a tip target.
        dynamic_tolerance_N: the same as residual_tolerance_N, for a tick of the dynamic mode.
        dynamic_newton_iterations: tangents that are factorised per tick in the dynamic mode, in addition to
            iterations with a reused factorisation; a tick with a large residual factorises more.
        integrator: of the dynamic mode: "bdf2", of second order, or "implicit_euler", of first order, whose
            numerical damping suppresses all but slow oscillations and most of a bounce.
        damping_per_s: damping of the soft robot, force = -damping_per_s * m * (v - u), where u is the
            velocity of a node that moves rigidly with the flange. The flange bears the opposite force.
            Oscillations decay at half this rate; rigid motion is not damped. Losses of the film's material:
            film.loss_factor of the soft robot's file.
        air_drag_per_s: drag of air at rest, force = -air_drag_per_s * m * v, also if the soft robot moves
            rigidly with the arm: 0.5 N per kilogram at 0.25 m/s and 2 per s.
        follow_unstable: whether static solutions stay on equilibria that have become unstable; if not, they
            move to stable ones.
    """

    residual_tolerance_N: PositiveForce = 1e-6
    search_iterations_max: Count = 3000
    dynamic_tolerance_N: PositiveForce = 1e-4
    dynamic_newton_iterations: Count = 1
    integrator: Literal["implicit_euler", "bdf2"] = "bdf2"
    damping_per_s: NonNegativeRate = 0.0
    air_drag_per_s: NonNegativeRate = 0.0
    follow_unstable: bool = False


@final
@dataclass(frozen=True)
class PlanTable(Table):
    """Checks of the arm's planned motion, before the run.

    All links are checked; the soft robot, in its drawn shape, only if the run does not model its contact.

    Args:
        collision: of a link with another link, or with a body that no load can move. "refuse": the scenario
            does not run; "warn": the run warns; "off": no check.
        clearance_m: smallest allowed distance of links.
    """

    collision: Literal["refuse", "warn", "off"] = "warn"
    clearance_m: NonNegativeLength = 0.0


@final
@dataclass(frozen=True)
class FrictionPairTable(Table):
    """Friction between two things, measured for this pair.

    Args:
        between: two of: an object, a wire, "floor", "palm", "film" (the soft robot).
        friction: coefficient of sliding, in place of the combined one.
    """

    between: tuple[str, str]
    friction: NonNegative


@final
@dataclass(frozen=True)
class ContactTable(Table):
    """Contact of the soft robot with the scene and with itself; in the quasistatic mode without friction.

    Args:
        enabled: whether contact with floor and objects is modelled.
        only_in_reach: whether contact is left out if no body is within the film's reach of the flange's path.
        stiffness_N_m3: pressure per depth.
        smoothing_m: width of the transition; contact begins half of it before touching.
        stick_m: tangential displacement at which the full friction acts.
        self_contact: whether units and fingers touch one another, by the same law. "auto": from the step on
            in which they press on one another; true: in every step; false: they pass through one another.
            With `model.published` "auto" is false. A section model has contact between neighbouring units
            in the energy of its sections, without friction.
        self_friction: coefficient of sliding between films; without effect in the quasistatic mode.
        film_friction: coefficient of sliding of the film on bodies; omitted: that of the touched body.
        pair_friction: how the coefficients of two touching bodies, or of film and body, combine: the
            "largest", the "smallest", their "mean", or the "root" of their product.
        pairs: `[[contact.pair]]` in the file.
    """

    enabled: bool = True
    only_in_reach: bool = True
    stiffness_N_m3: PositiveContactStiffness = 3e8
    smoothing_m: PositiveLength = 1e-4
    stick_m: PositiveLength = 1e-4
    self_contact: Literal["auto", True, False] = "auto"
    self_friction: NonNegative = 0.5
    film_friction: NonNegative | None = None
    pair_friction: Literal["largest", "smallest", "mean", "root"] = "largest"
    pairs: tuple[FrictionPairTable, ...] = field(default=(), metadata={"alias": "pair"})


@final
@dataclass(frozen=True)
class ModelTable(Table):
    """Switches of the model, for comparison with the paper.

    Args:
        published: the paper's lumped model in place of that of the robot's file: film law "plain"
            ("edge_strain" if the file has it), uniform hinges, no stiffeners, no finer mesh at the holes, no
            fused necks.
        closed: whether caps close the end holes and carry pressure; if not, only the films carry it.
        all_hinges: whether every interior edge has a hinge; if not, the published subset has.
    """

    published: bool = False
    closed: bool = True
    all_hinges: bool = True


@final
@dataclass(frozen=True)
class OrificeTable(Table):
    """A hole or hose between two chambers; gas flows while both are sealed, dm/dt = conductance (p_1 - p_2).

    Args:
        chambers: names of the two.
        conductance_kg_s_Pa: mass per second and pascal.
    """

    chambers: tuple[str, str]
    conductance_kg_s_Pa: PositiveConductance


@final
@dataclass(frozen=True)
class GasTable(Table):
    """The gas in the chambers while a phase seals it.

    Args:
        exponent: gamma of p V^gamma, from 1 (slow, isothermal) to 1.4 (fast, adiabatic air).
        ambient_Pa: absolute pressure outside.
        temperature_K: of the gas when it is sealed; only a leak depends on it.
        orifices: `[[gas.orifice]]` in the file.
    """

    exponent: Annotated[float, Interval(ge=1.0, le=2.0)] = 1.4
    ambient_Pa: NonNegativePressure = 101325.0
    temperature_K: PositiveTemperature = 293.15
    orifices: tuple[OrificeTable, ...] = field(default=(), metadata={"alias": "orifice"})


@final
@dataclass(frozen=True)
class RecordingTable(Table):
    """Rate of the recording.

    Args:
        frames_per_s: frames of the scene per simulated second; curves have a point for every tick.
    """

    frames_per_s: PositiveRate = 60.0
