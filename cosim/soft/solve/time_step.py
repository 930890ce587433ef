"""Implicit time steps of a soft body: each is the minimum of an incremental potential.

The formulas are those of `state`. Most steps are one call of the kernel, from where free flight leads.
"""

import math
from dataclasses import replace
from functools import cached_property
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, Pose, Wrench
from cosim.errors import ConvergenceError, InputError
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import place_of_largest
from cosim.soft.contact.self_contact_pairs import FilmPairs
from cosim.soft.elements.cable import losses_follow
from cosim.soft.elements.mass_terms import Inertia
from cosim.soft.film import step_arrays, strain_rates
from cosim.soft.solve import film_step, newton_options
from cosim.soft.solve.newton import NewtonProgress, NewtonSolver, NewtonTask
from cosim.soft.solve.self_contact import SelfContact
from cosim.soft.solve.state import (
    BegunStep,
    Clamp,
    Damped,
    SoftState,
    StepAim,
    StepOptions,
    StepScheme,
    flange_axes,
    follow_flange,
    place_flight,
)
from cosim.soft.solve.step_begin import BedNumbers, fill_bed, fill_flight

_LOSS_ROUNDS_MAX = 8


LARGE_TURN_RAD: Final = 0.01  # above it, another start of Newton's method pays for looking for it


def _turn(before: Pose, after: Pose) -> float:
    """Return the angle [rad] between two poses."""
    cosine = 0.5 * (float(before.rotation.ravel().dot(after.rotation.ravel())) - 1.0)
    return math.acos(min(1.0, max(-1.0, cosine)))


@final
class FilmSides:
    """Makes what the kernel takes for steps of one body, and takes in how it has left the factorisation.

    Args:
        solver: Newton's method for the body.
        clamp: nodes held by the flange.
        options: how steps are solved.
        apart: whether parts of the body that nothing couples are solved one by one unless they press.
    """

    def __init__(self, solver: NewtonSolver, clamp: Clamp, options: StepOptions, *, apart: bool) -> None:
        self._solver, self._clamp, self._options, self._apart = solver, clamp, options, apart
        self.target = np.empty_like(solver.system.gradient)
        self._rates = strain_rates.StrainRates.of(solver.system.body, solver.system.film)
        self.rates = 0 if self._rates is None else self._rates.address  # of what a step resists rates with
        self._plain = Loads((), (0.0,) * len(solver.system.body.cables))
        self._last: tuple[StepScheme, float, bool, NewtonTask] | None = None

    @cached_property
    def _share(self) -> Array:
        body = self._solver.system.body
        return self._solver.system.segment_share(body.positions, self._plain)

    @property
    def knows_body(self) -> bool:
        """Whether kernels know all that the body is made of, and cables lose the same in all its shapes."""
        system = self._solver.system
        frictionless = all(cable.friction_coefficient == 0.0 for cable in system.body.cables)
        return system.complete and system.conservative and frictionless

    @property
    def has_parts(self) -> bool:
        """Whether the body has parts that are solved one by one unless films press."""
        return self._apart and len(self._solver.system.film.parts) > 2

    @property
    def knows_factor(self) -> bool:
        """Whether kernels know the kind of the factorisation in store."""
        return self._solver.envelope is not None

    def task(
        self, loads: Loads, share: Array, scheme: StepScheme, step_s: float, *, pressed: bool
    ) -> NewtonTask:
        """Return what is solved in a step.

        Args:
            loads: that act.
            share: (segments, COLUMNS), see `SoftSystem.segment_share`.
            scheme: of the step.
            step_s: h [s].
            pressed: whether films press on one another before it.
        """
        options = self._options
        bed = scheme.bed
        step = bed.two_steps, step_s, bed.span, bed.factor, bed.share, options.gain
        numbers = self._solver.numbers(options.whole, loads, step)
        inertia = Inertia(scheme.inertia, self.target, step_s, options.closely, self.rates)
        films = pressed or loads.self_contact is not None
        coupled = films or any(loads.gas) or any(loads.cable_length_m)
        apart = self._apart and numbers.complete and numbers.potential and not coupled
        return NewtonTask(loads, share, inertia, scheme.kind, numbers, self._clamp.held, apart)

    def of(self, scheme: StepScheme, step_s: float, *, pressed: bool) -> film_step.FilmSide:
        """Return what the kernel takes for steps of a scheme under plain loads.

        Args:
            scheme: of the step.
            step_s: h [s].
            pressed: whether films press on one another before it.
        """
        last = self._last
        if last is None or last[0] is not scheme or last[1:3] != (step_s, pressed):
            task = self.task(self._plain, self._share, scheme, step_s, pressed=pressed)
            last = self._last = scheme, step_s, pressed, task
        return self._solver.side(last[3])

    def address(self, side: film_step.FilmSide) -> int:
        """Return where the kernels read it, until the next one."""
        return self._solver.store.address(side)

    def fill_bed(self, state: SoftState, flange: Pose, bed: BedNumbers, base: Array, target: Array) -> None:
        """Fill base and target (n, 3) [m] of a step from a state.

        Args:
            state: at the beginning.
            flange: its pose at the end.
            bed: numbers of the step.
            base: filled.
            target: filled.
        """
        x, v, along = state.positions, state.velocities, self._solver.along
        earlier_x, earlier_v = state.earlier or (x, v)
        if bed.share > 0.0:
            follow_flange(self._clamp.held, flange_axes(flange), x, earlier_x, bed, along)
        fill_bed(x, v, earlier_x, earlier_v, along, bed, base, target)
        self.fill_rates(state, bed)

    def fill_rates(self, state: SoftState, bed: BedNumbers) -> None:
        """Fill what a step from a state resists rates of strain with; see `StrainRates.fill`."""
        if self._rates is not None:
            earlier = None if state.earlier is None or not bed.two_steps else state.earlier[0]
            self._rates.fill(state.positions, earlier, state.memory, bed.span)

    def take_over(self, side: film_step.FilmSide, scheme: StepScheme) -> None:
        """Take in how the kernel has left the factorisation after steps of a scheme."""
        self._solver.take_over(side.kept, scheme.kind)


@final
class QuickStepper:
    """Takes steps from where free flight leads.

    Args:
        solver: Newton's method for the body.
        clamp: nodes held by the flange.
        options: how steps are solved.
        apart: see `FilmSides`.
    """

    def __init__(self, solver: NewtonSolver, clamp: Clamp, options: StepOptions, *, apart: bool) -> None:
        self._solver, self._clamp, self._options = solver, clamp, options
        self._bound_N = options.bound_N(solver.system.body.node_mass)
        self.sides = FilmSides(solver, clamp, options, apart=apart)
        self.begun: BegunStep | None = None
        """A step that was begun elsewhere: the next one, if it is from the same state, continues with it."""

    def begins(self, *, lenient: bool) -> step_arrays.StepPlace:
        """Return what the kernel takes for the beginning of a step.

        Args:
            lenient: whether it may end above its tolerance, which is for those that touch nothing.
        """
        newton = self._options.newton
        first = min(self._options.iterations, newton.iterations_max) if lenient else newton.iterations_max
        return step_arrays.StepPlace(step_arrays.BEGINS_STEP, newton.reuse_max, first)

    def knows(self, loads: Loads) -> bool:
        """Whether losses of cables do not depend on where the step leads."""
        cables = self._solver.system.body.cables
        frictionless = all(cable.friction_coefficient == 0.0 for cable in cables)
        return frictionless and not losses_follow(cables, loads.cable_length_m)

    def has_begun(self, state: SoftState) -> bool:
        """Return whether a step from a state continues with one that was begun elsewhere."""
        return self.begun is not None and self.begun.state is state

    def forget(self) -> None:
        """Do not continue with a step that was begun elsewhere, nor with the factorisation that it has left.

        How far it came depends on whether a saved state held the factorisation.
        """
        self.begun = None
        self._solver.keep(None)

    def take(
        self,
        state: SoftState,
        drive: tuple[Pose, Loads],
        scheme: StepScheme,
        step_s: float,
        start: Array | None = None,
    ) -> tuple[SoftState, newton_options.NewtonResult] | None:
        """Return where a step ends, or None where its start or a tangent is not usable.

        Args:
            state: at the beginning; it stays as it is.
            drive: pose of the flange and loads at the end; it `knows` these.
            scheme: of the step.
            step_s: h [s].
            start: (n, 3) [m], where an earlier try has ended; free flight unless given.
        """
        flange, loads = drive
        here, options, system = (state.positions, state.velocities), self._options, self._solver.system
        begun, self.begun = self.begun if self.has_begun(state) else None, None
        x, velocities, memory = _new_end(state) if begun is None else (begun.x, begun.base, begun.memory)
        motion = step_arrays.StepMotion(
            *here, *(state.earlier or here), state.memory, flange_axes(flange), x, velocities, memory
        )
        share = system.segment_share(state.positions, loads, state.memory)
        task = self.sides.task(loads, share, scheme, step_s, pressed=state.touching is not None)
        solution = NewtonProgress(task, motion, options.newton)
        films = loads.self_contact
        if begun is not None and begun.solved:
            solution.reused, solution.residual = begun.iterations, begun.residual
            return self._end(motion, films), solution.result(newton_options.Outcome.CONVERGED)
        # a contact that is half solved would push with a force of its own making
        lenient = loads.contact is None and films is None
        place = self.begins(lenient=lenient)
        if start is not None:
            self.sides.fill_bed(state, flange, scheme.bed, velocities, self.sides.target)
            x[:], memory[:] = self._clamp.place(start, flange), state.memory
            place = place._replace(begins=step_arrays.BEGINS)
        if begun is not None:
            solution.reused, place = begun.iterations, place._replace(begins=step_arrays.GOES_ON)
        outcome = self._solver.go_on(solution, place)
        if outcome is newton_options.Outcome.ITERATION_LIMIT and lenient:
            if solution.residual <= self._bound_N and not self._jumps(motion, step_s):
                velocities[:] = (x - velocities) / scheme.bed.span
            else:
                more = place.tangents_max + options.newton.iterations_max
                outcome = self._go_on(solution, place._replace(begins=step_arrays.GOES_ON, tangents_max=more))
        elif outcome is not newton_options.Outcome.CONVERGED:
            return None
        if outcome not in (newton_options.Outcome.CONVERGED, newton_options.Outcome.ITERATION_LIMIT):
            return None
        return self._end(motion, films), solution.result(outcome)

    def _end(self, motion: step_arrays.StepMotion, films: FilmPairs | None) -> SoftState:
        """Return where a step with pairs of films has ended."""
        x, touching = motion.new_x, None if films is None else films.memory(motion.new_x)
        memory = self._solver.system.advanced(x, motion.new_memory)
        return SoftState(x, motion.new_velocity, memory, (motion.x, motion.velocity), touching)

    def _go_on(self, solution: NewtonProgress, place: step_arrays.StepPlace) -> newton_options.Outcome:
        """Go on beyond what a step was given at first."""
        parts = self._solver.parts
        parts[parts[:, step_arrays.TO_DO] != 0.0, step_arrays.ASKS] = step_arrays.TANGENT
        parts[:, step_arrays.LEFT] = self._options.newton.reuse_max
        outcome = self._solver.go_on(solution, place)
        return outcome if outcome is newton_options.Outcome.CONVERGED else newton_options.Outcome.NO_DESCENT

    def _jumps(self, motion: step_arrays.StepMotion, step_s: float) -> bool:
        """Return whether the flange jumps in a step, off free flight."""
        flight, gain = np.empty_like(motion.x), self._options.gain
        fill_flight(motion.x, motion.velocity, motion.earlier_velocity, step_s, gain, flight)
        return place_flight(self._clamp.held, motion.flange, flight)


def _new_end(state: SoftState) -> tuple[Array, Array, Array]:
    """Return room for positions, velocities and memory at the end of a step from a state."""
    return np.empty_like(state.positions), np.empty_like(state.velocities), np.empty_like(state.memory)


@final
class ImplicitStepper:
    """Steps one body with a given clamp.

    Args:
        solver: Newton's method for the body with that clamp.
        clamp: nodes held by the flange.
        options: how steps are solved.
        self_contact: of the body's films with one another; None where it is not modelled.
    """

    def __init__(
        self,
        solver: NewtonSolver,
        clamp: Clamp,
        options: StepOptions,
        self_contact: SelfContact | None = None,
    ) -> None:
        self.solver = solver
        self.clamp = clamp
        self.options = options
        self.self_contact = self_contact
        # of an ordinary step: until it is solved, and in a first go
        self._whole = options.whole
        self._first = replace(self._whole, iterations_max=options.iterations)
        apart = self_contact is None or self_contact.contacts.waits or not self_contact.can_touch
        self.quick = QuickStepper(solver, clamp, options, apart=apart)
        self._scheme: StepScheme | None = None

    def step(
        self,
        state: SoftState,
        world_from_flange: Pose,
        loads: Loads,
        step_s: float,
        before: Pose | None = None,
        aim: StepAim | None = None,
    ) -> tuple[SoftState, newton_options.NewtonResult]:
        """Advance by one step, with the flange at its new pose.

        Args:
            state: at the beginning.
            world_from_flange: pose of the flange at the end.
            loads: at the end.
            step_s: h [s].
            before: pose of the flange at the beginning; with it, a large turn finds a better start.
            aim: how closely; as an ordinary step unless given.

        Raises:
            InputError: the step is not positive, or not finite.
            ConvergenceError: no acceptable solution; the caller still holds `state`.
        """
        if not 0.0 < step_s < math.inf:
            raise InputError(f"step {step_s} s must be positive and finite")
        first = self._with_films(state, loads, step_s)
        end, result = self._step(state, world_from_flange, first, step_s, before, aim)
        films, pairs = self.self_contact, first.self_contact
        if films is None:
            return end, result
        if films.waits(state) and films.press(end, step_s):
            pairs = films.step_pairs(state, step_s)
            if pairs is not None:
                again = replace(loads, self_contact=pairs)
                end, result = self._step(state, world_from_flange, again, step_s, before, aim)
        films.work_J = 0.0 if pairs is None else pairs.work(state.positions, end.positions)
        return end, result

    def _step(
        self,
        state: SoftState,
        world_from_flange: Pose,
        loads: Loads,
        step_s: float,
        before: Pose | None,
        aim: StepAim | None,
    ) -> tuple[SoftState, newton_options.NewtonResult]:
        """Advance by one step with the films that may touch one another in it; see `step`."""
        scheme = self.scheme_of(state, step_s)
        begun = self.quick.has_begun(state)  # where the flange turns far, no step is
        if begun and aim is not None and aim.afresh:
            self.quick.forget()
            begun = False
        turns = before is not None and not begun and _turn(before, world_from_flange) > LARGE_TURN_RAD
        drive, start = (world_from_flange, loads), None if aim is None else aim.start
        if aim is not None and aim.tolerance_N >= self.options.tolerance_N:
            aim = None
        quick = (aim is None or begun) and not turns and self.quick.knows(loads)
        taken = self.quick.take(state, drive, scheme, step_s, start) if quick else None
        if taken is not None and aim is None:
            return taken
        if taken is not None:
            start, quick = taken[0].positions, False
        inertia, base = self._inertia(state, world_from_flange, scheme, step_s, aim)
        flight, jumps = self._flight(state, world_from_flange, step_s)
        starts = [state.positions] if quick else [flight, state.positions]
        if turns and before is not None:
            starts = self._ranked(starts, state, before, world_from_flange, loads, inertia)
        # flight is the better start, unless it takes films too far; then the step begins where it is
        if start is not None:
            starts = [start, *starts]
        for free in starts:
            placed = self.clamp.place(free, world_from_flange)
            result = self._solve(placed, state, world_from_flange, loads, inertia, aim, whole=jumps)
            result = self._with_losses(result, (state, world_from_flange, loads), inertia, aim)
            if result.converged or self._acceptable(result, aim):
                break
        else:
            system = self.solver.system
            where = place_of_largest(system.body, result.positions, system.gradient, self.solver.free)
            raise ConvergenceError(
                f"the soft step did not converge: {result.outcome.value}; residual {result.residual_N:.3g} N "
                f"after {result.iterations} iterations, the largest at {where}",
                result.residual_N,
                result.iterations,
            )
        velocities = (result.positions - base) / scheme.bed.span
        earlier, pairs = (state.positions, state.velocities), loads.self_contact
        touching = None if pairs is None else pairs.memory(result.positions)
        memory = self.solver.system.advanced(result.positions, result.memory)
        return SoftState(result.positions, velocities, memory, earlier, touching), result

    def _with_films(self, state: SoftState, loads: Loads, step_s: float) -> Loads:
        """Return the loads with the films that may touch one another in a step from a state."""
        films = self.self_contact
        if films is None or films.waits(state):
            return loads
        return replace(loads, self_contact=films.step_pairs(state, step_s))

    def factorise(self, state: SoftState, world_from_flange: Pose, loads: Loads, step_s: float) -> bool:
        """Factorise the tangent of a step that ends at a state; False where it is indefinite.

        Args:
            state: at the end of a step.
            world_from_flange: pose of the flange there.
            loads: there.
            step_s: h [s].
        """
        scheme = self.scheme_of(state, step_s)  # where the bed is at rest has no part in the tangent
        rates = self.quick.sides.rates
        self.quick.sides.fill_rates(state, scheme.bed)
        inertia = Inertia(scheme.inertia, state.positions, step_s, self.options.closely, rates)
        loads = self._with_films(state, loads, step_s)
        return self.solver.factorise(
            state.positions, state.memory, loads, inertia, world_from_flange.rotation
        )

    def _ranked(
        self, starts: list[Array], state: SoftState, before: Pose, after: Pose, loads: Loads, inertia: Inertia
    ) -> list[Array]:
        """Return the starts and that which goes with the flange, the one of least potential first.

        Free flight goes along tangents: where the flange turns far in a step, it stretches the film.
        """
        system, positions = self.solver.system, state.positions
        carried = np.ascontiguousarray((after @ before.inverse()).apply(positions))
        share = system.segment_share(positions, loads, state.memory)

        def potential(start: Array) -> float:
            placed = self.clamp.place(start, after)
            value = system.evaluate(placed, loads, share, state.memory, inertia=inertia, hessian=False)
            return value if math.isfinite(value) else math.inf

        return sorted([*starts, carried], key=potential)

    def wrench(self, end: SoftState, world_from_flange: Pose) -> Wrench:
        """Return what the body exerts on the flange, at its origin, world axes, at the end of a step."""
        system, damped = self.solver.system, None
        if self._scheme is not None and self._scheme.bed.share > 0.0:
            bed = self._scheme.bed  # of the step that has led there
            damped = Damped(system.body.node_mass, bed.share, bed.span, self.solver.along), end.velocities
        return self.clamp.wrench(system.gradient, end.positions, world_from_flange, damped)

    def scheme_of(self, state: SoftState, step_s: float) -> StepScheme:
        """Return the scheme of a step; the same object for the same kind of step."""
        bed, last = self.options.bed(step_s, first=state.earlier is None), self._scheme
        if last is None or last.bed != bed:
            last = self._scheme = StepScheme.of(bed, self.options, self.solver.system.body.node_mass)
        return last

    def _inertia(
        self, state: SoftState, flange: Pose, scheme: StepScheme, step_s: float, aim: StepAim | None = None
    ) -> tuple[Inertia, Array]:
        """Return inertia and losses of a step as an elastic bed, and the base (n, 3) [m] of v."""
        base, target = np.empty_like(state.positions), np.empty_like(state.positions)
        self.quick.sides.fill_bed(state, flange, scheme.bed, base, target)
        closely = self.options.closely or (aim is not None and aim.tolerance_N < self.options.tolerance_N)
        return Inertia(scheme.inertia, target, step_s, closely, self.quick.sides.rates), base

    def _flight(self, state: SoftState, world_from_flange: Pose, step_s: float) -> tuple[Array, bool]:
        """Return where the nodes (n, 3) [m] get in free flight, and whether the flange jumps with them."""
        flight = np.empty_like(state.positions)
        before = state.velocities if state.earlier is None else state.earlier[1]
        fill_flight(state.positions, state.velocities, before, step_s, self.options.gain, flight)
        return flight, place_flight(self.clamp.held, flange_axes(world_from_flange), flight)

    def _solve(
        self,
        start: Array,
        state: SoftState,
        flange: Pose,
        loads: Loads,
        inertia: Inertia,
        aim: StepAim | None,
        *,
        whole: bool,
    ) -> newton_options.NewtonResult:
        options, frame = self.options, flange.rotation
        if aim is not None:
            coarse, fine = aim.newton(options)
            result = self.solver.solve(start, state.memory, loads, coarse, inertia, frame)
            if not result.converged or result.residual_N < aim.tolerance_N:
                return result
            spent = result.iterations
            result = self.solver.solve(result.positions, state.memory, loads, fine, inertia, frame)
            return replace(result, iterations=spent + result.iterations)
        # a contact that is half solved would push with a force of its own making; a jump is solved as well
        if whole or loads.contact is not None or loads.self_contact is not None:
            return self.solver.solve(start, state.memory, loads, self._whole, inertia, frame)
        result = self.solver.solve(start, state.memory, loads, self._first, inertia, frame)
        if result.outcome is not newton_options.Outcome.ITERATION_LIMIT or self._acceptable(result):
            return result
        spent = result.iterations
        memory = self.solver.system.unslid(result.memory, state.memory)
        result = self.solver.solve(result.positions, memory, loads, self._whole, inertia, frame)
        return replace(result, iterations=spent + result.iterations)

    def _with_losses(
        self,
        result: newton_options.NewtonResult,
        drive: tuple[SoftState, Pose, Loads],
        inertia: Inertia,
        aim: StepAim | None,
    ) -> newton_options.NewtonResult:
        """Repeat while the shape changes the losses of cables of commanded length: stiff ones feel that."""
        (state, flange, loads), system = drive, self.solver.system
        if not losses_follow(system.body.cables, loads.cable_length_m):
            return result
        bound, frame = self.options.tolerance_N if aim is None else aim.tolerance_N, flange.rotation
        options = replace(self.options.newton, tolerance_N=bound, start_tolerance_N=bound)
        for _ in range(_LOSS_ROUNDS_MAX):
            if not (result.converged or self._acceptable(result, aim)):
                break
            memory = system.unslid(result.memory, state.memory)
            again = self.solver.solve(result.positions, memory, loads, options, inertia, frame)
            if not again.converged:
                break
            spent = result.iterations + again.iterations
            result = replace(
                again, iterations=spent, factorisations=result.factorisations + again.factorisations
            )
            if again.iterations == 0:
                break
        return result

    def _acceptable(self, result: newton_options.NewtonResult, aim: StepAim | None = None) -> bool:
        """Whether an ordinary step may end here: all iterations spent, residual within its bound."""
        if aim is not None:
            # below an ordinary step's tolerance rounding may leave no descent
            return result.residual_N <= self.options.tolerance_N
        limit = result.outcome is newton_options.Outcome.ITERATION_LIMIT
        return limit and result.residual_N <= self.options.bound_N(self.solver.system.body.node_mass)
