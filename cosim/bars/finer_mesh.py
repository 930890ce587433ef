"""Equilibria of a run's film on its mesh refined once, by which the error of the mesh is measured.

The solution on the refined mesh starts from the shape on the run's: nodes where those are, new ones halfway
along their edges. Where Newton's method finds none from there, a damped body slides until it rests.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from cosim.base.frames import Array, Mask, Pose
from cosim.coupling.robots import film_robot
from cosim.errors import ConvergenceError
from cosim.soft.body import body, places
from cosim.soft.body.loads import Loads
from cosim.soft.contact.self_contact_pairs import FilmMemory
from cosim.soft.solve.state import Clamp, Equilibrium, SoftState

ITERATIONS_MAX = 600
"""Of each try to find a state at rest, on either mesh."""
PATIENCE = 100
"""Iterations within which a slide to rest halves what is out of balance, on either mesh."""
_FOLDED = 100.0
"""Times as far out of balance as without it: what is taken along from another state has folded films."""
_LEFT_N = 0.005
"""Out of balance on the refined mesh: it changes bars by at most 0.3 %, those of fingers most."""
NOTHING_PRESSES = FilmMemory(np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros((0, 3)))


def least_out_of_balance(
    side: film_robot.FilmRobot, starts: Sequence[SoftState], flange: Pose, loads: Loads, along: float = 1.0
) -> SoftState:
    """Return the start that is the less out of balance: what is taken along may fold films.

    Args:
        side: the body.
        starts: the plain one and, where there is one, that with a difference that is taken along.
        flange: pose.
        loads: that act.
        along: how many times as far out of balance as the plain one the other may be.
    """
    if len(starts) == 1:
        return starts[0]
    plain_N, along_N = (side.equilibrium_solver.out_of_balance(start, flange, loads) for start in starts)
    return starts[1] if along_N < along * plain_N else starts[0]


@contextmanager
def left_out_of_balance(side: film_robot.FilmRobot, left_N: float) -> Iterator[None]:
    """Let equilibria that are found within leave so much out of balance; what holds the body stays."""
    solver, before = side.equilibrium_solver, side.equilibrium_solver.options
    left_N = max(left_N, before.tolerance_N)
    solver.options = replace(before, tolerance_N=left_N, start_tolerance_N=left_N)
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
    """Finds the equilibria of a body on its refined mesh.

    Attributes: `side`, the body there, held as it is on the run's mesh since the last solution; `iterations`
    of Newton's method that were spent.

    Args:
        coarse: the body on the run's mesh.
        side: new, on the mesh refined once.
        iterations_max: of each try to find a state at rest.

    Raises:
        MeshError: it is not the same body.
    """

    def __init__(
        self, coarse: body.SoftBody, side: film_robot.FilmRobot, iterations_max: int = ITERATIONS_MAX
    ) -> None:
        self.side, self._parents, self.iterations = side, places.parents(coarse, side.body), 0
        self._iterations_max = iterations_max

    def hold(self, clamp: Clamp) -> None:
        """Let the refined mesh be held as a clamp has it, see `clamp`."""
        if not clamp.holds_as(self.side.clamp):
            self.side.hold(clamp)

    def at_rest(self, clamp: Clamp, rest: Equilibrium, before: Pair | None = None) -> Equilibrium:
        """Return the equilibrium near one of the run's mesh, with its flange and loads.

        Args:
            clamp: of the refined mesh.
            rest: on the run's mesh.
            before: of another phase end, whose difference is added to the start; None: nothing is added.

        Raises:
            ConvergenceError: no equilibrium was found near it, nor does a damped body slide to one.
        """
        side, shape, flange = self.side, rest.state.positions, rest.world_from_flange
        self.hold(clamp)
        wanted, loads = shape[self._parents].mean(axis=1), self._loads(rest)
        starts = [side.state_at_rest(wanted, flange)]
        if before is not None:
            finer, coarse = before.finer, before.rest.state.positions
            turn = flange.rotation @ finer.world_from_flange.rotation.T
            away = finer.state.positions - coarse[self._parents].mean(axis=1)
            starts.append(SoftState.at_rest(wanted + away @ turn.T, finer.state.memory))
        # of several shapes near one another, the difference of the earlier phase end leads to the same one
        start = least_out_of_balance(side, starts, flange, loads, along=_FOLDED)
        if rest.loads.self_contact is not None:  # films that press on the run's mesh do so on this one
            start = replace(start, touching=NOTHING_PRESSES)
        most = self._iterations_max
        return self._spent(lambda: side.find_rest(start, flange, loads, most, min(most, PATIENCE)))

    def followed(self, clamp: Clamp, rest: Equilibrium, earlier: Equilibrium) -> Equilibrium:
        """Return the equilibrium that one of the refined mesh is followed to.

        Args:
            clamp: of the refined mesh.
            rest: on the run's mesh, with the flange and loads at the end.
            earlier: on the refined mesh, held in the same way.

        Raises:
            ConvergenceError: none was found.
        """
        self.hold(clamp)
        side, flange, loads = self.side, rest.world_from_flange, self._loads(rest)
        with side.effort.within(self._iterations_max):
            return self._spent(lambda: side.follow(earlier, flange, loads))

    def _loads(self, rest: Equilibrium) -> Loads:
        """Return the loads of an equilibrium of the run's mesh, as the refined one bears them."""
        loads = replace(rest.loads, self_contact=None)
        force = loads.nodal_force
        return loads if force is None else replace(loads, nodal_force=self._spread(force))

    def _spent(self, search: Callable[[], Equilibrium]) -> Equilibrium:
        """Return what a search finds, where the body is then; its iterations are counted."""
        try:
            with left_out_of_balance(self.side, _LEFT_N):
                found = search()
        except ConvergenceError as error:
            self.iterations += error.iterations
            raise
        self.iterations += found.iterations
        self.side.commit(found)
        return found

    def _spread(self, force: Array) -> Array:
        """Return forces (n, 3) [N] on the nodes of the run's mesh as the refined one bears them.

        Each is shared between its node, and halves of the new nodes on edges to nodes that bear one as well.
        """
        first, second = self._parents.T
        bears: Mask = np.any(force != 0.0, axis=1)
        shared = np.where(first == second, 1.0, 0.5) * (bears[first] & bears[second])
        count = np.bincount(first, shared, len(force))
        count += np.bincount(second, np.where(first == second, 0.0, shared), len(force))
        each = force / np.maximum(count, 1.0)[:, None]
        both = each[first] + np.where((first == second)[:, None], 0.0, each[second])
        return np.asarray(shared[:, None] * both)

    def clamp(self, coarse: Clamp, before: Pair | None = None) -> Clamp:
        """Return what holds the refined mesh: new nodes are held in what both ends of their edge are.

        Args:
            coarse: holds the run's mesh.
            before: of the phase end after which other nodes were held; None: it is held as it is drawn.
        """
        first, second = self._parents.T
        mask = coarse.mask(int(self._parents.max()) + 1)
        held: Mask = mask[first] & mask[second]
        if before is None:
            nodes = np.flatnonzero(np.any(held, axis=1))
            return Clamp(nodes, self.side.body.positions[nodes], held[nodes])
        kept, rest = before.clamp.without(np.flatnonzero(~np.any(held, axis=1))), before.finer
        return kept.holding(held, rest.state.positions, rest.world_from_flange)
