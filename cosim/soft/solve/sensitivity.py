"""How an equilibrium moves with its loads, and with all that its model is made of: implicit function theorem.

At equilibrium g(x, p) = 0, so
K dx/dp = -dg/dp. One factorisation of the tangent K is enough for all parameters.

`Sensitivity`: how the tip moves with cable tensions, gravity and the flange, in closed form.

`EquilibriumSlope`: any parameter. dg/dp is the difference quotient of the forces g that two models, whose
parameter differs by some 1e-5 of itself, have at the same shape: two assemblies, no solution. As the shape is
the same to the last bit, stiff film does not turn the rounding of positions into forces. What K leaves out,
losses along cables that follow the shape, is in the quotient too: they are those of the shape moved along the
dx/dp that was found, which is corrected until nothing is left. Where a parameter changes the drawn film, the
quotient is taken along dx/dp, as film that was drawn otherwise would be strained at the same shape. Forces
that are linear in a parameter need one assembly.

The error is that of the quotient: some 1e-8 of dx/dp, 1e-6 where the drawn film changes. An equilibrium has
no derivative where the two sides of the quotient, or the forces on both sides of it along dx/dp, disagree: a
cable that gets taut, a contact that begins, a fold nearby. That is refused. All parameters are looked at
together first, and one by one only where that finds something.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.errors import ConvergenceError, InputError, SensitivityError
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import TipFrame, place_of_largest
from cosim.soft.elements import eyelets
from cosim.soft.elements.cable import add_segments
from cosim.soft.film.film import FilmPotential
from cosim.soft.film.inertia import Inertia
from cosim.soft.linear.linear_solver import LowRank
from cosim.soft.solve import newton
from cosim.soft.solve.state import Clamp, Equilibrium

_ROUNDS_MAX: Final = 60
_NEAR: Final = 0.1  # of dx/dp, within which the second round is as good as any further one
_LEFT: Final = 1e-10  # of dx/dp, when the rounds end
_ROUNDED: Final = 1e-5  # the same, where rounding keeps them from falling
_KINK: Final = 2e-2  # of the first difference of a shape, the second one
_SEEN_m: Final = 1e-8  # what rounding leaves of a second difference is far below it

_ALONG_m: Final = 3e-8  # of each motion, where a kink is looked for along all at once


class Side(NamedTuple):
    """The model of an equilibrium with one parameter moved.

    Args:
        offset: of the parameter, in its unit.
        weight: of a function's value here in its derivative by the parameter, per unit.
        bend: the same in the second difference, without a unit.
        film: assembles the changed body.
        clamp: that holds it.
        loads: on it.
        alike: whether its cables are those of the equilibrium.
        inertia: of an implicit step that ends there; None in statics.
    """

    offset: float
    weight: float
    bend: float
    film: FilmPotential
    clamp: Clamp
    loads: Loads
    alike: bool = False
    inertia: Inertia | None = None


class Moved(NamedTuple):
    """A parameter that is moved.

    Args:
        name: for messages.
        sides: of its difference quotient, in rising order.
        straight: whether the forces at a shape are linear in it.
    """

    name: str
    sides: tuple[Side, ...]
    straight: bool = False

    @property
    def step(self) -> float:
        """The longest of its offsets, in its unit."""
        return max(abs(side.offset) for side in self.sides)


def factorise_at(solver: newton.NewtonSolver, here: Equilibrium, inertia: Inertia | None = None) -> None:
    """Factorise the tangent at an equilibrium, or with inertia where an implicit step ends.

    Raises:
        ConvergenceError: it is not positive definite: the equilibrium is not stable.
    """
    # through the solver, which has to know that its factorisation is another one now
    state, frame = here.state, here.world_from_flange.rotation
    if not solver.factorise(state.positions, state.memory, here.loads, inertia, frame):
        raise ConvergenceError(
            "the equilibrium is not stable (its tangent stiffness has a negative eigenvalue), so it has "
            "no useful sensitivity; change the pressure or the flange pose",
            here.residual_N,
            0,
        )


class FrozenTangent(NamedTuple):
    """The tangent of all nodes at a shape, losses along cables frozen.

    Args:
        row: (blocks,) of its lower half.
        column: (blocks,).
        blocks: (blocks, 3, 3) [N/m].
        low_rank: dense parts; None for none.
        caps: what missing caps add, by ring.
    """

    row: IntArray
    column: IntArray
    blocks: Array
    low_rank: LowRank | None
    caps: list[tuple[IntArray, Array]]

    @classmethod
    def of(cls, film: FilmPotential, positions: Array, near: Mask | None = None) -> "FrozenTangent":
        """Return that which a film has assembled last.

        Args:
            film: that has assembled it.
            positions: (n, 3) [m], where.
            near: (n,) nodes whose blocks are kept, with those of their neighbours; None: all are.
        """
        tangent, caps = film.tangent, film.open_cap_stiffness(positions)
        pattern = tangent.pattern
        own = slice(None) if near is None else np.flatnonzero(near[pattern.row] | near[pattern.column])
        blocks = tangent.blocks[own].copy()
        return cls(pattern.row[own], pattern.column[own], blocks, tangent.low_rank, caps)

    def times(self, motion: Array) -> Array:
        """Return K v of motions v (n, 3, ...)."""
        row, column = self.row, self.column
        force, below = np.zeros_like(motion), row > column
        np.add.at(force, row, np.einsum("brc,bc...->br...", self.blocks, motion[column]))
        turned = np.einsum("bcr,bc...->br...", self.blocks[below], motion[row[below]])
        np.add.at(force, column[below], turned)
        if self.low_rank is not None:
            along = np.einsum("knr,nr...->k...", self.low_rank.vectors, motion)
            force += np.einsum("k,k...,knr->nr...", self.low_rank.coefficients, along, self.low_rank.vectors)
        for ring, part in self.caps:
            own = motion[ring]
            force[ring] += (part @ own.reshape(len(part), -1)).reshape(own.shape)
        return force


class Slope(NamedTuple):
    """How an equilibrium moves with a parameter, per unit of it.

    Args:
        motion: (n, 3) [m], of the nodes, held ones included.
        quotient: (n, 3) [N], of the gradient at shapes that move by `taken`.
        taken: (n, 3) [m].
        bent: (n, 3) [N], its second difference over a step; None: it has none.
        step: of the parameter, in its unit.
    """

    motion: Array
    quotient: Array
    taken: Array
    bent: Array | None
    step: float

    @property
    def size_m(self) -> float:
        """How far the step moves a node."""
        return self.step * float(np.abs(self.motion).max())


@final
class EquilibriumSlope:
    """Derivatives of an equilibrium by parameters of its model; keeps the factorised tangent.

    Attributes: `own`, the equilibrium as a side; `gradient`, (n, 3) [N] there.

    Args:
        solver: Newton's method for the body with the clamp in force.
        clamp: in force.
        here: where the derivatives are taken.
        kinks: whether the quotient is taken where the forces have a kink, as a search for a minimum may.
        inertia: of an implicit step that ends there; None in statics.

    Raises:
        ConvergenceError: the equilibrium is not stable.
    """

    def __init__(
        self, solver: newton.NewtonSolver, clamp: Clamp, here: Equilibrium, *, kinks: bool = False,
        inertia: Inertia | None = None,
    ) -> None:  # fmt: skip
        factorise_at(solver, here, inertia)
        self._kinks, self._solver, self._here, self._clamp = kinks, solver, here, clamp
        film = solver.film
        self._x = np.array(here.state.positions, order="C")
        self._memory = film.fresh(here.state.memory) if inertia is None else here.state.memory
        # held nodes move and are pushed on; of the others the factorisation knows all
        self._tangent = FrozenTangent.of(film, self._x, np.asarray((~solver.free).any(axis=1)))
        lengths = here.loads.cable_length_m or (None,) * len(film.body.cables)
        pairs = zip(film.body.cables, lengths, strict=True)
        self._losses_move = any(
            cable.friction_coefficient or (length is not None and cable.lossy) for cable, length in pairs
        )
        self.own = Side(0.0, 0.0, 0.0, film, clamp, here.loads, True, inertia)
        self._share = film.losses_at(self._x, here.loads, self._memory)
        self.gradient = self._assembled(self.own, self._x, self._share)

    def by(self, parameters: Sequence[Moved]) -> list[Slope]:
        """Return the derivatives by parameters.

        Raises:
            SensitivityError: no derivative exists: the sides disagree, or the rounds do not converge.
        """
        plain = [
            not self._losses_move and all(side.clamp is self._clamp for side in each.sides)
            for each in parameters
        ]
        found = self._plain_slopes([each for each, one in zip(parameters, plain, strict=True) if one])
        slopes = [
            next(found) if one else self._slope(each) for each, one in zip(parameters, plain, strict=True)
        ]
        if not self._kinks and self._bends(slopes):
            for each, slope in zip(parameters, slopes, strict=True):
                self._check_kink(each, slope.motion)
        return slopes

    def _plain_slopes(self, parameters: Sequence[Moved]) -> Iterator[Slope]:
        """Yield the derivatives by parameters that leave the drawn film, and losses that leave the shape."""
        still = np.zeros_like(self._x)
        quotients = [self._quotient(each, still, None) for each in parameters]
        forces = np.array([quotient for quotient, _, _ in quotients]).reshape(-1, *still.shape)
        motions = -self._solver.linear.solve_all(np.where(self._solver.free, forces, 0.0))
        for each, motion, (quotient, taken, bent) in zip(parameters, motions, quotients, strict=True):
            yield Slope(motion, quotient, taken, bent, each.step)

    def _slope(self, parameter: Moved) -> Slope:
        """Return the derivative by a parameter, in rounds."""
        sides, free = parameter.sides, self._solver.free
        redrawn, before = any(side.clamp is not self._clamp for side in sides), 0.0
        motion = held = sum(side.weight * self._placed(side) for side in sides) + np.zeros_like(self._x)
        # at rest one side shows well enough along what the quotient is to be taken
        rough, at_once = parameter._replace(straight=True), self.own.inertia is None and not self._losses_move
        for round_ in range(_ROUNDS_MAX):
            along = motion if redrawn and round_ else None
            moved = rough if redrawn and not round_ else parameter
            quotient, taken, bent = self._quotient(moved, motion, along)
            pushed = self._tangent.times(held - taken) if redrawn and along is None else 0.0
            last, motion = motion, taken + np.where(free, 0.0, held - taken)
            motion = motion - self._solver.linear.solve(np.where(free, quotient + pushed, 0.0))
            size, most = float(np.abs(motion - last).max()), float(np.abs(motion).max())
            fall = min(1.0, size / before) if before else 1.0
            if size * fall <= _LEFT * most or (at_once and round_ and size < _NEAR * most):
                break
            if before and 0.5 * before < size <= (_ROUNDED if redrawn else 0.1 * _ROUNDED) * most:
                break
            before = size
        else:
            raise SensitivityError(
                f"no derivative by {parameter.name}: losses along cables, which follow the shape, do not "
                f"settle in {_ROUNDS_MAX} rounds; a fold or a slip is near, move the loads away from there"
            )
        return Slope(motion, quotient, taken, bent, parameter.step)

    def moved(self, side: Side, slope: Slope) -> tuple[Array, Array]:
        """Return positions (n, 3) [m] and gradient (n, 3) [N], which is that of the held nodes, on a side."""
        pushed = slope.quotient + self._tangent.times(slope.motion - slope.taken)
        pushed[self._solver.free] = 0.0
        return self._x + side.offset * slope.motion, self.gradient + side.offset * pushed

    def _placed(self, side: Side) -> Array:
        """Return how far a side's clamp holds nodes (n, 3) [m] from where they are."""
        if side.clamp is self._clamp:
            return np.zeros_like(self._x)
        return side.clamp.place(self._x, self._here.world_from_flange) - self._x

    def _quotient(
        self, parameter: Moved, motion: Array, along: Array | None
    ) -> tuple[Array, Array, Array | None]:
        """Return the quotient (n, 3) [N per unit] of the gradient, how its shapes move (n, 3) [m], its bend.

        The shape rests, or is moved: by what is left of a motion once it is rounded, which is known to the
        last bit, so that stiff film does not turn the rounding into forces.

        Args:
            parameter: that is moved.
            motion: (n, 3) [m], of the shape that losses along cables are those of.
            along: (n, 3) [m], of the shape; None: it rests.
        """
        found, taken = np.zeros_like(self._x), np.zeros_like(self._x)
        if parameter.straight and not self._losses_move and self.own.inertia is None:
            side = parameter.sides[-1]
            forces = self._assembled(side, self._x, self._lost(side, self._x))
            return (forces - self.gradient) / side.offset, taken, None
        bent = -sum(side.bend for side in parameter.sides) * self.gradient
        for side in parameter.sides:
            x = self._x if along is None else np.ascontiguousarray(self._x + side.offset * along)
            lost_at = self._x + side.offset * motion if self._losses_move else self._x
            still = not side.offset and side.inertia is self.own.inertia
            forces = self.gradient if still else self._assembled(side, x, self._lost(side, lost_at))
            found += side.weight * forces
            bent += side.bend * forces
            if along is not None:
                taken += side.weight * (x - self._x)
        return found, taken, bent

    def _lost(self, side: Side, x: Array) -> Array:
        """Return the losses of a side's cables at a shape (n, 3) [m]."""
        if side.alike and side.loads is self.own.loads and not self._losses_move:
            return self._share
        return side.film.losses_at(x, side.loads, self._memory)

    def _assembled(self, side: Side, x: Array, share: Array) -> Array:
        """Return the gradient (n, 3) [N] of a side's potential at a shape (n, 3) [m], with some losses."""
        film = side.film
        film.evaluate(x, side.loads, share, self._memory, inertia=side.inertia, hessian=False)
        return film.gradient.copy()

    def _bends(self, slopes: Sequence[Slope]) -> bool:
        """Return whether the forces may have a kink along the motions of some parameters, all at once.

        Those that redraw the film have moved in their quotient; the shape is moved by the others.
        """
        motion, bent = np.zeros_like(self._x), -2.0 * self.gradient
        for k, slope in enumerate(slopes):
            share = (-1.0) ** k * _ALONG_m / max(slope.size_m, _SEEN_m)
            if slope.bent is not None:
                bent += share * slope.bent
            if not slope.taken.any():
                motion += share * slope.step * slope.motion
        for x in (self._x + motion, self._x - motion):
            bent += self._assembled(self.own, x, self._lost(self.own, x))
        return self._bend_m(bent) > _KINK * _ALONG_m

    def _bend_m(self, bent: Array) -> float:
        """Return how far a second difference (n, 3) [N] of the forces moves a node."""
        return float(np.abs(self._solver.linear.solve(np.where(self._solver.free, bent, 0.0))).max())

    def _check_kink(self, parameter: Moved, motion: Array) -> None:
        """Compare what a second difference of the forces does to the shape with the step itself."""
        bent = -sum(side.bend for side in parameter.sides) * self.gradient
        for side in parameter.sides:
            x = np.ascontiguousarray(self._x + side.offset * motion)
            bent = bent + side.bend * self._assembled(side, x, self._lost(side, x))
        size_m = parameter.step * float(np.abs(motion).max())
        if self._bend_m(bent) > _KINK * max(size_m, _SEEN_m):
            bent = np.where(self._solver.free, bent, 0.0)
            place = place_of_largest(self._solver.film.body, self._x, bent, self._solver.free)
            raise SensitivityError(
                f"no derivative by {parameter.name}: the forces at {place} change otherwise above than "
                "below the present state, as where a cable gets taut, a contact begins, or a fold is near; "
                "move the loads away from there"
            )


_NO_SLOTS = np.zeros((0, 0), np.int64)
_NO_BLOCKS = np.zeros((0, 3, 3))


@final
class Sensitivity:
    """Derivatives of an equilibrium's tip; keeps the factorised tangent.

    Args:
        solver: Newton's method for the body with the clamp in force.
        equilibrium: where the derivatives are taken.

    Raises:
        ConvergenceError: the tangent is not positive definite there: the equilibrium is not stable.
    """

    def __init__(self, solver: newton.NewtonSolver, equilibrium: Equilibrium) -> None:
        self._solver = solver
        self._equilibrium = equilibrium
        self._positions = equilibrium.state.positions
        factorise_at(solver, equilibrium)
        self.tip = TipFrame.of(solver.film.body, self._positions)

    def to_gravity(self) -> Array:
        """Return d(tip motion)/d(gravity) (6, 3) [m s^2/m, rad s^2/m]; the flange stays."""
        mass = self._solver.film.body.node_mass
        columns = []
        for axis in range(3):
            load = np.zeros_like(self._positions)
            load[:, axis] = mass
            columns.append(self._tip_motion(load))
        return np.stack(columns, axis=1)

    def to_tension(self) -> Array:
        """Return d(tip motion)/d(cable tension) (6, cables) [m/N, rad/N]; the flange stays.

        Where a cable has slid through an eyelet, it is taken to slide on; back, it would stick at first.

        Raises:
            InputError: a cable's length is commanded, so that its tension is not free.
        """
        columns = []
        if any(length is not None for length in self._equilibrium.loads.cable_length_m):
            raise InputError(
                "cable tensions are looked for while a cable's length is commanded "
                f"({self._equilibrium.loads.cable_length_m} m); command its tension first"
            )
        film, here = self._solver.film, self._equilibrium
        rows = film.losses_at(self._positions, here.loads, here.state.memory)
        routes = film.eyelets.routes.tolist()
        for cable, (first, last) in zip(film.body.cables, pairwise(routes), strict=True):
            gradient, ratio = np.zeros_like(self._positions), rows[first:last, eyelets.RATIO].copy()
            add_segments(self._positions, cable.segments, ratio, _NO_SLOTS, gradient, _NO_BLOCKS)
            columns.append(self._tip_motion(-gradient))
        return np.stack(columns, axis=1) if columns else np.zeros((6, 0))

    def _tip_motion(self, load: Array) -> Array:
        displacement = self._solver.linear.solve(load)
        return self.tip.motion(self._solver.film.body, self._positions, displacement)
