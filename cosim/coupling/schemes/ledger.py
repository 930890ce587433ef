"""The clock of the exchange, what its two sides exchange in a tick, and figures of the film's shape then."""

from dataclasses import dataclass
from typing import Annotated, Literal, TypeAlias, final

import numpy as np

from cosim.base.frames import Array, IntArray, Shown, Wrench
from cosim.errors import InputError


@final
@dataclass(frozen=True)
class Clock:
    """An integer count of equal ticks; time never accumulates rounding.

    Args:
        tick_s: length of a tick [s].
        tick: ticks since the start.
    """

    tick_s: float
    tick: int = 0

    def __post_init__(self) -> None:
        if not self.tick_s > 0.0:
            raise InputError(f"tick_s is {self.tick_s}; it must be above 0")

    @property
    def time_s(self) -> float:
        """Simulated time [s]."""
        return self.tick * self.tick_s

    def advanced(self, ticks: int = 1) -> "Clock":
        """Return the clock some ticks later."""
        return Clock(self.tick_s, self.tick + ticks)


Scheme: TypeAlias = Literal["staggered", "iterated"]


@final
@dataclass(frozen=True)
class LedgerEntry:
    """What the interface exchanged in one tick.

    Args:
        wrench: that the soft robot exerts on the flange, at the flange origin, world axes.
        rigid_power_W: power of the wrench that the rigid side received.
        soft_power_W: power that the soft side took in by its answer of this tick, with the same twist.
        residual_N: largest component of the out-of-balance force of the soft step.
        newton_iterations: of the soft step.
        slides: equilibria that only a damped slide led to, in statics and before the first tick.
        stability_ratio: largest eigenvalue of (flange mobility x algorithmic mass of the soft side).
        algorithmic_mass: whether it was carried as armature in this tick.
        contacts: points of the film that press on something.
        contact_force_N: sum of the normal forces that acted on bodies, mean over the tick; in a staggered
            exchange they were found at the end of the tick before.
        contact_depth_m: how deep the deepest of them is; negative while nothing has sunk in.
        contact_ratio: largest mass by which the film answers touched bodies within a tick, over theirs.
        self_contacts: points of the film that press on another film of the soft robot.
        self_contact_force_N: sum of their normal forces.
        self_contact_depth_m: how deep the deepest of them is behind the other film; negative while none is.
        contact_work_J: of contacts with the scene on the film in this tick.
        self_contact_work_J: of contacts between films on these.
        eyelets_J: lost at eyelets of cables that know in which direction they slide.
        bodies_work_J: of contacts with the film on bodies in this tick.
        hit_m_s: speed at which film and the body of `hit_body` came on to each other before the tick, of the
            contact that the tick resolves least; 0 without one.
        hit_way_m: way of that body in a step that would resolve it.
        hit_body: index of the body; -1 for no hit.
        scheme: of the exchange in this tick.
        trials: how often the tick was taken until the loads agreed; 1 in the staggered exchange.
        interface_residual: what the loads on flange and bodies that acted differ from those the soft side
            answered with in the same tick, over their size; 0 where no iteration was asked for.
        power_size_W: product of the sizes of wrench and flange velocity: a power of this size is large.
        momentum_error: largest relative difference of what the rigid side received in the tick from what was
            handed over to it, in force and torque about the world's origin.
    """

    wrench: Wrench
    rigid_power_W: float
    soft_power_W: float
    residual_N: float
    newton_iterations: int
    stability_ratio: float
    algorithmic_mass: bool
    contacts: int = 0
    contact_force_N: float = 0.0
    contact_depth_m: float = 0.0
    contact_ratio: float = 0.0
    self_contacts: int = 0
    self_contact_force_N: float = 0.0
    self_contact_depth_m: float = 0.0
    contact_work_J: float = 0.0
    self_contact_work_J: float = 0.0
    eyelets_J: float = 0.0
    bodies_work_J: float = 0.0
    hit_m_s: float = 0.0
    hit_way_m: float = 0.0
    hit_body: int = -1
    scheme: Scheme = "staggered"
    trials: int = 1
    interface_residual: float = 0.0
    power_size_W: float = 0.0
    momentum_error: float = 0.0
    slides: int = 0

    @property
    def power_error_W(self) -> float:
        """Power that appears or vanishes at the interface [W]."""
        return self.rigid_power_W + self.soft_power_W

    @property
    def power_error(self) -> float:
        """The same, relative to the product of the sizes of wrench and velocity; 0 at rest."""
        return abs(self.power_error_W) / self.power_size_W if self.power_size_W > 0.0 else 0.0


@final
@dataclass(frozen=True, eq=False)
class TickPieces(Shown):
    """Where the soft robot was at the ends of the pieces of one tick; nobody can write to its arrays.

    Args:
        positions: (k, nodes, 3) [m], world.
        twist: (k, 6), of the flange, linear and angular, world axes.
        origin: (k, 3) [m], of the flange.
    """

    positions: Annotated[Array, ("k", "nodes", 3)]
    twist: Annotated[Array, ("k", 6)]
    origin: Annotated[Array, ("k", 3)]


@final
@dataclass(frozen=True, eq=False)
class ShapeFigures(Shown):
    """Figures of k shapes.

    Args:
        tip_position: (k, 3) [m], mean of the last hole ring.
        tip_direction: (k, 3), unit normal of the last hole ring, away from the base.
        center_line_m: (k,), length of the polyline through the centres of the hole rings.
        volumes_m3: (k, chambers).
    """

    tip_position: Array
    tip_direction: Array
    center_line_m: Array
    volumes_m3: Array

    def some(self, rows: IntArray) -> "ShapeFigures":
        """Return the figures of some of the shapes, by their places."""
        return ShapeFigures(*(column[rows] for column in vars(self).values()))

    def sag_m(self, origin: Array, axis: Array) -> Array:
        """Return how far each tip is from where it would be on a straight line of the same length (k,) [m].

        Args:
            origin: (k, 3) [m], where the lines begin.
            axis: (k, 3), unit vectors along them.
        """
        away = self.tip_position - origin - self.center_line_m[:, None] * axis
        return np.asarray(np.sqrt((away * away).sum(axis=1)))
