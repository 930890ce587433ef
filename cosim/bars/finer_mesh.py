"""Equilibria of a run's film on its mesh refined once, which measure the error of the mesh. They start from
the shape on the run's mesh, with new nodes in the middle of its edges; if Newton's method fails from there, a
damped body slides until it rests.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, Mask, Pose
from cosim.coupling.robots import film_robot
from cosim.errors import ConvergenceError
from cosim.soft.body import body, places
from cosim.soft.body.loads import Loads
from cosim.soft.contact.self_contact_pairs import FilmMemory
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.state import Equilibrium, SoftState

ITERATIONS_MAX: Final = 600
"""Iterations of each search for a state at rest, on either mesh."""
PATIENCE: Final = 100
"""Iterations within which a slide must halve the residual, on either mesh."""
_FOLDED: Final = 100.0
"""Residual of a start with the difference of another state, over that without: above, it has folded films."""
_RESIDUAL_N: Final = 0.005
"""Residual on the refined mesh: it changes bars by at most 0.3 %, those of fingers most."""
NO_FILM_CONTACT: Final = FilmMemory(np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros((0, 3)))


def better_start(
    side: film_robot.FilmRobot, starts: Sequence[SoftState], flange: Pose, loads: Loads, factor: float = 1.0
) -> SoftState:
    """Return the start with the smaller residual, as the difference of another state may fold films.

    Args:
        side: the body.
        starts: the plain one and, if there is one, that with the difference of another state.
        flange: pose.
        loads: on the body.
        factor: on the plain start's residual.
    """
    if len(starts) == 1:
        return starts[0]
    plain_N, other_N = (side.equilibrium_solver.out_of_balance(start, flange, loads) for start in starts)
    return starts[1] if other_N < factor * plain_N else starts[0]


@contextmanager
def residual_allowed(side: film_robot.FilmRobot, residual_N: float) -> Iterator[None]:
    """Solve equilibria in a block up to a residual."""
    solver, before = side.equilibrium_solver, side.equilibrium_solver.options
    residual_N = max(residual_N, before.tolerance_N)
    solver.options = replace(before, tolerance_N=residual_N, start_tolerance_N=residual_N)
    try:
        yield
    finally:
        solver.options = before


@final
@dataclass(frozen=True)
class Pair:
    """States at rest at the end of a phase.

    Args:
        rest: on the run's mesh.
        finer: on the refined mesh.
        clamp: of the refined mesh.
    """

    rest: Equilibrium
    finer: Equilibrium
    clamp: Clamp


@final
class FinerMesh:
    """Solves equilibria of a body on its refined mesh.

    Attributes: `side`, the body on the refined mesh, with the last clamp; `iterations`, those of Newton's
    method so far.

    Args:
        coarse: the body on the run's mesh.
        side: new, on the mesh refined once.
        iterations_max: of each search for a state at rest.

    Raises:
        MeshError: it is not the same body.
    """

    def __init__(
        self, coarse: body.SoftBody, side: film_robot.FilmRobot, iterations_max: int = ITERATIONS_MAX
    ) -> None:
        self.side, self._parents, self.iterations = side, places.parents(coarse, side.body), 0
        self._iterations_max = iterations_max

    def hold(self, clamp: Clamp) -> None:
        """Set the clamp of the refined mesh, see `clamp`."""
        if not clamp.holds_as(self.side.clamp):
            self.side.hold(clamp)

    def at_rest(self, clamp: Clamp, rest: Equilibrium, before: Pair | None = None) -> Equilibrium:
        """Return the equilibrium near one on the run's mesh, with its flange and loads.

        Args:
            clamp: of the refined mesh.
            rest: on the run's mesh.
            before: of another phase end, whose difference is added to the start; None: nothing is added.

        Raises:
            ConvergenceError: no equilibrium was found, by sliding neither.
        """
        side, shape, flange = self.side, rest.state.positions, rest.world_from_flange
        self.hold(clamp)
        positions, loads = shape[self._parents].mean(axis=1), self._loads(rest)
        starts = [side.state_at_rest(positions, flange)]
        if before is not None:
            finer, coarse = before.finer, before.rest.state.positions
            turn = flange.rotation @ finer.world_from_flange.rotation.T
            difference = finer.state.positions - coarse[self._parents].mean(axis=1)
            starts.append(SoftState.at_rest(positions + difference @ turn.T, finer.state.memory))
        # with several equilibria near one another, this difference leads to the corresponding one
        start = better_start(side, starts, flange, loads, _FOLDED)
        if rest.loads.self_contact is not None:  # films in contact on the run's mesh are so on this one
            start = replace(start, touching=NO_FILM_CONTACT)
        most = self._iterations_max
        return self._counted(lambda: side.find_rest(start, flange, loads, most, min(most, PATIENCE)))

    def followed(self, clamp: Clamp, rest: Equilibrium, earlier: Equilibrium) -> Equilibrium:
        """Return the equilibrium by continuation from an earlier one on the refined mesh.

        Args:
            clamp: of the refined mesh.
            rest: on the run's mesh, with the flange and loads at the end.
            earlier: on the refined mesh, with the same clamp.

        Raises:
            ConvergenceError: none was found.
        """
        self.hold(clamp)
        side, flange, loads = self.side, rest.world_from_flange, self._loads(rest)
        with side.effort.within(self._iterations_max):
            return self._counted(lambda: side.follow(earlier, flange, loads))

    def _loads(self, rest: Equilibrium) -> Loads:
        """Return the loads of an equilibrium on the run's mesh for the refined mesh."""
        loads = replace(rest.loads, self_contact=None)
        force = loads.nodal_force
        return loads if force is None else replace(loads, nodal_force=self._spread(force))

    def _counted(self, search: Callable[[], Equilibrium]) -> Equilibrium:
        """Return the result of a search, set as the body's state; count its iterations."""
        try:
            with residual_allowed(self.side, _RESIDUAL_N):
                result = search()
        except ConvergenceError as error:
            self.iterations += error.iterations
            raise
        self.iterations += result.iterations
        self.side.commit(result)
        return result

    def _spread(self, force: Array) -> Array:
        """Return forces (n, 3) [N] on the nodes of the run's mesh, distributed to those of the refined mesh.

        Each force is distributed to its node, and with half the weight to new nodes on edges between nodes
        with forces.
        """
        first, second = self._parents.T
        loaded: Mask = np.any(force != 0.0, axis=1)
        weight = np.where(first == second, 1.0, 0.5) * (loaded[first] & loaded[second])
        count = np.bincount(first, weight, len(force))
        count += np.bincount(second, np.where(first == second, 0.0, weight), len(force))
        each = force / np.maximum(count, 1.0)[:, None]
        both = each[first] + np.where((first == second)[:, None], 0.0, each[second])
        return np.asarray(weight[:, None] * both)

    def clamp(self, coarse: Clamp, before: Pair | None = None) -> Clamp:
        """Return the clamp of the refined mesh; new nodes are held in the components of both their ends.

        Args:
            coarse: clamp of the run's mesh.
            before: of the phase end after which other nodes were held; None: nodes are held where drawn.
        """
        first, second = self._parents.T
        mask = coarse.mask(int(self._parents.max()) + 1)
        held: Mask = mask[first] & mask[second]
        if before is None:
            nodes = np.flatnonzero(np.any(held, axis=1))
            return Clamp(nodes, self.side.body.positions[nodes], held[nodes])
        still_held, rest = before.clamp.without(np.flatnonzero(~np.any(held, axis=1))), before.finer
        return still_held.holding(held, rest.state.positions, rest.world_from_flange)
