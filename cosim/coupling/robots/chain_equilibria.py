"""Equilibria of a chain of frames on a flange, by continuation from known ones."""

from dataclasses import replace
from typing import final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.errors import ConvergenceError, OutOfRangeError
from cosim.reduced.section_model import SectionBody, carried
from cosim.reduced.sections.figures import supplied_wrench
from cosim.reduced.solve.chain_film import chain_of, film_of
from cosim.reduced.solve.chain_solver import ChainSolver, ChainTask
from cosim.reduced.solve.chain_step import ChainScheme, ChainStep
from cosim.reduced.solve.clamp import FrameClamp, upright
from cosim.reduced.solve.commanded_cables import solve_loaded
from cosim.reduced.solve.stability import RestingChain
from cosim.reduced.solve.working_range import INSTEAD, check_pressure, place_in_range
from cosim.soft.body.loads import Loads
from cosim.soft.solve.equilibrium import CONTACT_ROUNDS_MAX, extrapolate
from cosim.soft.solve.newton_options import NewtonOptions, Outcome
from cosim.soft.solve.state import Equilibrium, Obstacles

_SPLITS_MAX = 8


@final
class ChainEquilibria:
    """Follows equilibria of one chain.

    `obstacles` returns the possible contacts; None to use those in the loads.

    Args:
        section: the chain.
        solver: of it.
        options: bounds of the iteration.
    """

    def __init__(self, section: SectionBody, solver: ChainSolver, options: NewtonOptions) -> None:
        self._section, self._solver, self._options = section, solver, options
        self.obstacles: Obstacles | None = None

    def start(self, clamp: FrameClamp, flange: Pose, loads: Loads) -> Equilibrium:
        """Return the equilibrium of a chain, first without pressure, then loaded.

        If films without gas are unstable, the first equilibrium is with gas and gravity along the axis.

        Raises:
            ConvergenceError: none was found.
            OutOfRangeError: none within the model's range.
        """
        slack = (0.0,) * len(self._section.body.cables)
        hanging = Loads((), slack, loads.gravity)
        try:
            # as drawn, the films are in contact, where a section has no stiffness to start from
            hung = self.solve(self._straight(0.0, flange), clamp, flange, hanging)
            return self.follow(hung, clamp, flange, loads)
        except ConvergenceError:
            if self._section.gas(loads) is not None:
                raise
        pressure = self._section.pressure(loads)
        x, y, z = (float(np.linalg.norm(loads.gravity)) * flange.rotation[:, 2]).tolist()
        hanging = Loads((pressure,) * self._section.copies, slack, (x, y, z))
        try:
            hung = self.solve(self._straight(pressure, flange), clamp, flange, hanging)
            return self.follow(hung, clamp, flange, loads)
        except OutOfRangeError as error:
            text = f"{error}; or start with more gas"
            raise OutOfRangeError(text, error.residual_N, error.iterations, error.place) from error

    def _straight(self, pressure_Pa: float, flange: Pose) -> Array:
        return carried(self._section.straight(pressure_Pa), flange)

    def solve(
        self, frames: Array, clamp: FrameClamp, flange: Pose, loads: Loads, begin_Pa: float = 0.0
    ) -> Equilibrium:
        """Return the equilibrium near frames (f, 4, 3); begin_Pa is the guess for a sealed gas' pressure.

        Raises:
            ConvergenceError: none was found.
            OutOfRangeError: none within the model's range, or at a pressure beyond it.
        """
        options = self._options
        solution, loads = self._solve_contacts(clamp.place(frames, flange), clamp, loads, begin_Pa)
        effort = solution.residual_N, solution.iterations
        if solution.outcome is not Outcome.CONVERGED:
            end = place_in_range(self._section, solution.frames, solution.pressure_Pa)
            text = (
                f"no equilibrium found: {solution.outcome.value}; residual {solution.residual_N:.3g} N, "
                f"bound {options.tolerance_N:.3g} N, {solution.iterations} iterations"
            )
            if end.at_its_end:
                text = f"{text}; the section model ends here: {end.text}; {INSTEAD}"
                raise OutOfRangeError(text, *effort, end.text)
            raise ConvergenceError(text, *effort)
        check_pressure(self._section, solution.pressure_Pa, *effort)
        film = film_of(self._section, solution.chain)
        resting = RestingChain(self._solver, clamp, solution.frames, loads, solution.pressure_Pa)
        return Equilibrium(
            film,
            flange,
            loads,
            supplied_wrench(solution.figures),
            solution.residual_N,
            solution.iterations,
            solution.potential_J,
            solution.shifted,
            negative_pivots=resting.negative_pivots,
        )

    def _solve_contacts(
        self, start: Array, clamp: FrameClamp, loads: Loads, begin_Pa: float
    ) -> tuple[ChainStep, Loads]:
        """Solve, and repeat while the contacts at the solution differ from those it was solved with.

        Returns:
            The solution, and the loads with its contacts.
        """
        trail = list[Array]()
        options, lever = self._options, self._solver.lever_m
        scheme = ChainScheme.of_statics(options.tolerance_N, lever, options.iterations_max)
        task = ChainTask(clamp, scheme)
        if self.obstacles is None:
            return solve_loaded(self._solver, task, loads, start, begin_Pa), loads
        pressure = begin_Pa if self._section.gas(loads) is not None else self._section.pressure(loads)
        iterations = shifted = 0
        for round_ in range(CONTACT_ROUNDS_MAX):
            loads = replace(loads, contact=self.obstacles(self._section.positions(start, pressure)))
            solution = solve_loaded(self._solver, task, loads, start, pressure)
            settled = round_ > 0 and solution.iterations == 0
            iterations, shifted = iterations + solution.iterations, shifted + solution.shifted
            pressure = solution.pressure_Pa
            if settled or solution.outcome is not Outcome.CONVERGED:
                return replace(solution, iterations=iterations, shifted=shifted), loads
            trail.append(solution.frames.reshape(-1, 3))
            start = upright(extrapolate(trail).reshape(start.shape))
        raise ConvergenceError(
            f"no equilibrium found: the contacts still change after {CONTACT_ROUNDS_MAX} rounds, "
            f"{len(loads.contact or ())} points near obstacles; try smaller increments",
            solution.residual_N,
            iterations,
        )

    def follow(
        self, begin: Equilibrium, clamp: FrameClamp, flange: Pose, loads: Loads, pressure_Pa: float = 0.0
    ) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads, in load steps that halve as needed.

        Args:
            begin: start.
            clamp: frames held by the flange.
            flange: pose of the flange at the end.
            loads: at the end.
            pressure_Pa: guess of the sealed gas' pressure at the start.

        Raises:
            ConvergenceError: a load step of 1/256 did not converge.
        """
        if self._section.gas(begin.loads) is None:
            pressure_Pa = self._section.pressure(begin.loads)
        equilibrium, reached_factor, load_step, iterations = begin, 0.0, 1.0, 0
        while reached_factor < 1.0:
            load_factor = min(1.0, reached_factor + load_step)
            pose = begin.world_from_flange.interpolated(flange, load_factor)
            motion = pose @ equilibrium.world_from_flange.inverse()
            chain = chain_of(self._section, equilibrium.state, equilibrium.world_from_flange, pressure_Pa)
            load, frames = begin.loads.interpolated(loads, load_factor), chain.frames
            if self._section.gas(load) is None:
                frames = self._section.stretched(frames, chain.pressure_Pa, self._section.pressure(load))
            try:
                next_equilibrium = self.solve(carried(frames, motion), clamp, pose, load, chain.pressure_Pa)
            except ConvergenceError as error:
                iterations, load_step = iterations + error.iterations, 0.5 * load_step
                if load_step < 0.5**_SPLITS_MAX:
                    raise
                continue
            equilibrium, reached_factor = next_equilibrium, load_factor
            iterations += next_equilibrium.iterations
        return replace(equilibrium, iterations=iterations)
