"""Derivatives of an equilibrium by any parameter of its model, by the implicit function theorem.

At equilibrium g(x, p) = 0, so K dx/dp = -dg/dp with one factorisation of K. dg/dp is the difference quotient
of the forces g of two models whose parameter differs by about 1e-5 of itself, at the same shape: two
assemblies, no solution. As the shape is identical to the last bit, stiff film does not amplify the rounding
of positions. Losses along cables that depend on the shape are not in K; the quotient includes them, for the
shape moved along the last dx/dp, which is corrected until it converges. If a parameter changes the drawn
film, the quotient is taken along dx/dp, as a differently drawn film would be strained at the same shape.
Forces that are linear in a parameter need one assembly. The error is that of the quotient: about 1e-8 of
dx/dp, 1e-6 if the drawn film changes. No derivative exists if the forces have a kink: a cable gets taut, a
contact begins, a fold is near. This is detected by second differences and refused, first for all parameters
together, then one by one.
"""

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple, final

import numpy as np

from cosim.base.frames import Array
from cosim.errors import SensitivityError
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import describe_largest
from cosim.soft.film.film import FilmPotential
from cosim.soft.film.inertia import Inertia
from cosim.soft.solve import newton
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.frozen_tangent import FrozenTangent
from cosim.soft.solve.sensitivity import factorise_at
from cosim.soft.solve.state import Equilibrium

_ROUNDS_MAX: Final = 60
_NEAR: Final = 0.1  # relative change of dx/dp below which the second round is the last
_CONVERGED: Final = 1e-10  # relative change of dx/dp at which rounds end
_ROUNDED: Final = 1e-5  # the same, if rounding prevents a further fall
_KINK: Final = 2e-2  # second difference of a shape over the first one, above which there is a kink
_SEEN_m: Final = 1e-8  # smallest motion for the check; far above the rounding of second differences
_ALONG_m: Final = 3e-8  # motion by each parameter in the check of all at once


class PerturbedModel(NamedTuple):
    """The model of an equilibrium with one parameter changed.

    Args:
        offset: of the parameter, in its unit.
        weight: of this model's values in the derivative by the parameter, per unit.
        bend: weight in the second difference, without a unit.
        film: of the changed body.
        clamp: of the changed body.
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


class ParameterChange(NamedTuple):
    """A parameter with the models of its difference quotient.

    Args:
        name: for messages.
        sides: changed models, in order of their offsets.
        straight: whether the forces at a shape are linear in the parameter.
    """

    name: str
    sides: tuple[PerturbedModel, ...]
    straight: bool = False

    @property
    def step(self) -> float:
        """The largest offset, in the parameter's unit."""
        return max(abs(model.offset) for model in self.sides)


class ParameterDerivative(NamedTuple):
    """Derivative of an equilibrium by a parameter, per unit of it.

    Args:
        motion: (n, 3) [m], of the nodes, held ones included.
        quotient: (n, 3) [N], difference quotient of the gradient, at shapes that move by `taken`.
        taken: (n, 3) [m], motion of the shapes in the quotient.
        bent: (n, 3) [N], second difference of the gradient over a step; None for a linear parameter.
        step: of the parameter, in its unit.
    """

    motion: Array
    quotient: Array
    taken: Array
    bent: Array | None
    step: float

    @property
    def size_m(self) -> float:
        """Largest motion of a node by the step."""
        return self.step * float(np.abs(self.motion).max())


@final
class EquilibriumDerivatives:
    """Derivatives of an equilibrium by parameters of its model; keeps the factorised tangent.

    Attributes: `own`, the unchanged model; `gradient`, (n, 3) [N] of it.

    Args:
        solver: Newton's method for the body with the present clamp.
        clamp: of the body.
        equilibrium: of the derivatives.
        kinks: whether kinks of the forces are accepted, as in a search for a minimum.
        inertia: of an implicit step that ends there; None in statics.

    Raises:
        ConvergenceError: the equilibrium is not stable.
    """

    def __init__(
        self, solver: newton.NewtonSolver, clamp: Clamp, equilibrium: Equilibrium, *, kinks: bool = False,
        inertia: Inertia | None = None,
    ) -> None:  # fmt: skip
        factorise_at(solver, equilibrium, inertia)
        self._kinks, self._solver, self._equilibrium, self._clamp = kinks, solver, equilibrium, clamp
        film = solver.film
        self._x = np.array(equilibrium.state.positions, order="C")
        self._memory = film.fresh(equilibrium.state.memory) if inertia is None else equilibrium.state.memory
        # only held nodes need the tangent itself; for the others the factorisation is enough
        self._tangent = FrozenTangent.of(film, self._x, np.asarray((~solver.free).any(axis=1)))
        lengths = equilibrium.loads.cable_length_m or (None,) * len(film.body.cables)
        pairs = zip(film.body.cables, lengths, strict=True)
        self._losses_move = any(
            cable.friction_coefficient or (length is not None and cable.lossy) for cable, length in pairs
        )
        self.own = PerturbedModel(0.0, 0.0, 0.0, film, clamp, equilibrium.loads, True, inertia)
        self._losses = film.losses_at(self._x, equilibrium.loads, self._memory)
        self.gradient = self._gradient_of(self.own, self._x, self._losses)

    def by(self, parameters: Sequence[ParameterChange]) -> list[ParameterDerivative]:
        """Return the derivatives by parameters.

        Raises:
            SensitivityError: no derivative exists: the forces have a kink, or the rounds do not converge.
        """
        are_plain = [
            not self._losses_move and all(model.clamp is self._clamp for model in parameter.sides)
            for parameter in parameters
        ]
        plain_derivatives = self._plain_slopes(
            [parameter for parameter, is_plain in zip(parameters, are_plain, strict=True) if is_plain]
        )
        slopes = [
            next(plain_derivatives) if is_plain else self._slope(parameter)
            for parameter, is_plain in zip(parameters, are_plain, strict=True)
        ]
        if not self._kinks and self._bends(slopes):
            for parameter, slope in zip(parameters, slopes, strict=True):
                self._check_kink(parameter, slope.motion)
        return slopes

    def _plain_slopes(self, parameters: Sequence[ParameterChange]) -> Iterator[ParameterDerivative]:
        """Yield the derivatives by parameters that change neither the drawn film nor the losses."""
        no_motion = np.zeros_like(self._x)
        quotients = [self._quotient(parameter, no_motion, None) for parameter in parameters]
        forces = np.array([quotient for quotient, _, _ in quotients]).reshape(-1, *no_motion.shape)
        motions = -self._solver.linear.solve_all(np.where(self._solver.free, forces, 0.0))
        for parameter, motion, (quotient, shape_motion, bent) in zip(
            parameters, motions, quotients, strict=True
        ):
            yield ParameterDerivative(motion, quotient, shape_motion, bent, parameter.step)

    def _slope(self, parameter: ParameterChange) -> ParameterDerivative:
        """Return the derivative by a parameter, by fixed-point rounds."""
        models, free = parameter.sides, self._solver.free
        redrawn, before = any(model.clamp is not self._clamp for model in models), 0.0
        motion = held_motion = sum(
            model.weight * self._held_motion(model) for model in models
        ) + np.zeros_like(self._x)
        # in the first round of statics one side is accurate enough
        rough, at_once = parameter._replace(straight=True), self.own.inertia is None and not self._losses_move
        for round_ in range(_ROUNDS_MAX):
            along = motion if redrawn and round_ else None
            differenced = rough if redrawn and not round_ else parameter
            quotient, shape_motion, bent = self._quotient(differenced, motion, along)
            pushed = self._tangent.times(held_motion - shape_motion) if redrawn and along is None else 0.0
            last, motion = motion, shape_motion + np.where(free, 0.0, held_motion - shape_motion)
            motion = motion - self._solver.linear.solve(np.where(free, quotient + pushed, 0.0))
            change_m, largest_m = float(np.abs(motion - last).max()), float(np.abs(motion).max())
            fall = min(1.0, change_m / before) if before else 1.0
            if change_m * fall <= _CONVERGED * largest_m or (
                at_once and round_ and change_m < _NEAR * largest_m
            ):
                break
            if before and 0.5 * before < change_m <= (_ROUNDED if redrawn else 0.1 * _ROUNDED) * largest_m:
                break
            before = change_m
        else:
            raise SensitivityError(
                f"no derivative by {parameter.name}: losses along cables, which follow the shape, do not "
                f"settle in {_ROUNDS_MAX} rounds; a fold or a slip is near, move the loads away from there"
            )
        return ParameterDerivative(motion, quotient, shape_motion, bent, parameter.step)

    def moved(self, side: PerturbedModel, slope: ParameterDerivative) -> tuple[Array, Array]:
        """Return positions (n, 3) [m] and the gradient (n, 3) [N] of held nodes for a changed model."""
        pushed = slope.quotient + self._tangent.times(slope.motion - slope.taken)
        pushed[self._solver.free] = 0.0
        return self._x + side.offset * slope.motion, self.gradient + side.offset * pushed

    def _held_motion(self, model: PerturbedModel) -> Array:
        """Return the displacements (n, 3) [m] of held nodes by a changed clamp."""
        if model.clamp is self._clamp:
            return np.zeros_like(self._x)
        return model.clamp.place(self._x, self._equilibrium.world_from_flange) - self._x

    def _quotient(
        self, parameter: ParameterChange, motion: Array, along: Array | None
    ) -> tuple[Array, Array, Array | None]:
        """Return the gradient's quotient (n, 3) [N per unit], motion of its shapes, and second difference.

        The motion is that of the rounded shapes, exact to the last bit, so that stiff film does not amplify
        the rounding.

        Args:
            parameter: changed.
            motion: (n, 3) [m], of the shapes for losses along cables.
            along: (n, 3) [m], of the shapes; None for the fixed shape.
        """
        quotient, shape_motion = np.zeros_like(self._x), np.zeros_like(self._x)
        if parameter.straight and not self._losses_move and self.own.inertia is None:
            model = parameter.sides[-1]
            forces = self._gradient_of(model, self._x, self._cable_losses(model, self._x))
            return (forces - self.gradient) / model.offset, shape_motion, None
        bent = -sum(model.bend for model in parameter.sides) * self.gradient
        for model in parameter.sides:
            x = self._x if along is None else np.ascontiguousarray(self._x + model.offset * along)
            lost_at = self._x + model.offset * motion if self._losses_move else self._x
            is_unchanged = not model.offset and model.inertia is self.own.inertia
            forces = (
                self.gradient
                if is_unchanged
                else self._gradient_of(model, x, self._cable_losses(model, lost_at))
            )
            quotient += model.weight * forces
            bent += model.bend * forces
            if along is not None:
                shape_motion += model.weight * (x - self._x)
        return quotient, shape_motion, bent

    def _cable_losses(self, model: PerturbedModel, x: Array) -> Array:
        """Return the cable losses of a changed model at a shape (n, 3) [m]."""
        if model.alike and model.loads is self.own.loads and not self._losses_move:
            return self._losses
        return model.film.losses_at(x, model.loads, self._memory)

    def _gradient_of(self, model: PerturbedModel, x: Array, weight: Array) -> Array:
        """Return the gradient (n, 3) [N] of a model's potential at a shape (n, 3) [m], with given losses."""
        film = model.film
        film.evaluate(x, model.loads, weight, self._memory, inertia=model.inertia, hessian=False)
        return film.gradient.copy()

    def _bends(self, slopes: Sequence[ParameterDerivative]) -> bool:
        """Return whether the forces may have a kink along the motions of all parameters at once.

        Parameters that redraw the film have moved shapes in their quotient; the others move the shape here.
        """
        motion, bent = np.zeros_like(self._x), -2.0 * self.gradient
        for k, slope in enumerate(slopes):
            weight = (-1.0) ** k * _ALONG_m / max(slope.size_m, _SEEN_m)
            if slope.bent is not None:
                bent += weight * slope.bent
            if not slope.taken.any():
                motion += weight * slope.step * slope.motion
        for x in (self._x + motion, self._x - motion):
            bent += self._gradient_of(self.own, x, self._cable_losses(self.own, x))
        return self._bend_m(bent) > _KINK * _ALONG_m

    def _bend_m(self, bent: Array) -> float:
        """Return the largest motion of a node by a second difference (n, 3) [N] of the forces."""
        return float(np.abs(self._solver.linear.solve(np.where(self._solver.free, bent, 0.0))).max())

    def _check_kink(self, parameter: ParameterChange, motion: Array) -> None:
        """Raise if a second difference of the forces moves the shape much, compared with the step."""
        bent = -sum(model.bend for model in parameter.sides) * self.gradient
        for model in parameter.sides:
            x = np.ascontiguousarray(self._x + model.offset * motion)
            bent = bent + model.bend * self._gradient_of(model, x, self._cable_losses(model, x))
        size_m = parameter.step * float(np.abs(motion).max())
        if self._bend_m(bent) > _KINK * max(size_m, _SEEN_m):
            bent = np.where(self._solver.free, bent, 0.0)
            place = describe_largest(self._solver.film.body, self._x, bent, self._solver.free)
            raise SensitivityError(
                f"no derivative by {parameter.name}: the forces at {place} change otherwise above than "
                "below the present state, as where a cable gets taut, a contact begins, or a fold is near; "
                "move the loads away from there"
            )
