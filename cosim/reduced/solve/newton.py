"""Newton's method for a chain of frames under the loads of a soft body, contact and sealed gas included.

The pressure of sealed gas in a chain: that which it has at the volume it gives the chamber.

Contact of the film on a chain of frames: contact points as combinations of the points of two frames.

A contact point is a combination of the nodes of one triangle, these are combinations of the points of the
frames beside them, and no triangle reaches across an outer ring: y = sum_s (w_s0 r_s + q_s), q_s = sum_i w_si
a_si, s the two frames. A change of the frames moves it by sum_s (w_s0 dr_s + phi_s x q_s) = J (dr, phi); its
energy adds J^T g to the gradient, J^T K J and the second order of the rotations to the Hessian, g and K by y.

How the tip of a chain of frames moves with its loads: the implicit function theorem.
"""

from dataclasses import dataclass, field, replace
from typing import Annotated, final

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, cho_solve_banded, cholesky_banded

from cosim.base.frames import Array, IntArray, Mask
from cosim.base.kernel_types import Blocks, Indices, Matrix
from cosim.base.kernels import kernel
from cosim.errors import ConvergenceError, InputError
from cosim.reduced.section_model import SectionBody
from cosim.reduced.sections import assembly, section_strains
from cosim.reduced.sections.section_strains import ANCHOR, FRICTION, NORMAL, OFFSET, STIFFNESS, Bed, ChainWork
from cosim.reduced.solve import chain_step
from cosim.reduced.solve.chain_step import GIVEN, ChainEnds, ChainScheme, ChainSide, ChainState, ChainStep
from cosim.reduced.solve.clamp import FrameClamp
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import TipFrame
from cosim.soft.contact.obstacle_contact import ContactPlanes, PlaneRows
from cosim.soft.solve.newton_options import Outcome
from cosim.soft.solve.state import inertia_weight

_ROUNDS_MAX = 30
_TOLERANCE = 1e-9  # of the absolute pressure
_STEP_MAX = 0.02  # the same, in one round


@kernel(taken_in=True)
def fill_rows(planes: PlaneRows, before: Indices, combination: Blocks, first: Indices, rows: Matrix) -> bool:
    """Fill contacts of the film's nodes as contacts of the frames, as a `LoadedChain` has them.

    Args:
        planes: k contacts.
        before: (n,), the first of the two frames that each node is between.
        combination: (n, 2, 4), each as a combination of their points.
        first: (k,), filled.
        rows: (k, COLUMNS), filled.

    Returns:
        False where a triangle reaches across a frame.
    """
    for k in range(planes.nodes.shape[0]):
        nodes = planes.nodes[k]
        f = min(before[nodes[0]], before[nodes[1]], before[nodes[2]])
        first[k] = f
        for i in range(NORMAL):
            rows[k, i] = 0.0
        for a in range(3):
            # a node on the second frame of its contact is the first of its own two, and of that one alone
            node, weight = nodes[a], planes.weights[k, a]
            shift = before[node] - f
            for i in range(4):
                rows[k, 4 * min(shift, 1) + i] += weight * combination[node, 0, i]
                beyond = weight * combination[node, 1, i]
                if shift == 0:
                    rows[k, 4 + i] += beyond
                elif shift > 1 or beyond != 0.0:
                    return False
        rows[k, OFFSET], rows[k, STIFFNESS] = planes.offset[k], planes.stiffness[k]
        rows[k, FRICTION] = planes.friction[k]
        for r in range(3):
            rows[k, NORMAL + r], rows[k, ANCHOR + r] = planes.normal[k, r], planes.anchor[k, r]
    return True


def nothing_touched() -> tuple[IntArray, Array, Array]:
    """Return what represents no contact in a `LoadedChain`."""
    return np.zeros(0, np.int64), np.zeros((0, section_strains.COLUMNS)), np.ones(2)


def _touched(
    section: SectionBody, planes: ContactPlanes, pressure_Pa: float
) -> tuple[IntArray, Array, Array]:
    """Return contacts of the film's nodes as contacts of the frames, as a `LoadedChain` has them.

    Raises:
        InputError: a triangle of the film reaches across a frame.
    """
    first, rows = np.empty(len(planes), np.int64), np.empty((len(planes), section_strains.COLUMNS))
    if not fill_rows(planes.rows, section.frames.before, section.node_weights(pressure_Pa), first, rows):
        raise InputError("section models need films between neighbouring rings; use fidelity = 'lumped'")
    return first, rows, np.array((planes.law.smoothing_m, planes.law.stick_m))


@final
@dataclass(frozen=True)
class KeptTangentState:
    """A kept factor.

    Args:
        low: (f, 6, 6), of the Cholesky factor.
        side: (f, 6, 6).
        step_s: length of the step that it was made in [s].
        two_steps: whether that looked back over two steps.
    """

    low: Annotated[Array, ("frames", 6, 6)]
    side: Annotated[Array, ("frames", 6, 6)]
    step_s: float
    two_steps: bool


@final
class KeptTangent:
    """Owns a factor, in `work`; it is for steps of one length and scheme in one clamp.

    Args:
        work: whose other arrays it shares.
    """

    def __init__(self, work: ChainWork) -> None:
        self.work = work._replace(low=np.zeros_like(work.low), side=np.zeros_like(work.side))
        self._clamp: FrameClamp | None = None
        self._step_s, self._two_steps = 0.0, False

    def serves(self, clamp: FrameClamp, step_s: float, two_steps: bool) -> bool:
        """Whether there is a factor that such a step may begin with."""
        return clamp is self._clamp and step_s == self._step_s and two_steps == self._two_steps

    def keep(self, kept: bool, clamp: FrameClamp, step_s: float, two_steps: bool) -> None:
        """Note the step in which the factor was made or used last, and whether it is worth keeping."""
        self._clamp, self._step_s, self._two_steps = clamp if kept else None, step_s, two_steps

    def save_state(self, clamp: FrameClamp) -> KeptTangentState | None:
        """Return the factor; None where none is kept for a clamp."""
        if clamp is not self._clamp:
            return None
        return KeptTangentState(self.work.low.copy(), self.work.side.copy(), self._step_s, self._two_steps)

    def restore_state(self, state: KeptTangentState | None, clamp: FrameClamp) -> None:
        """Return to a state of `save_state`, with the clamp of that moment."""
        if state is None:
            self._clamp = None
            return
        self.work.low[:], self.work.side[:] = state.low, state.side
        self.keep(True, clamp, state.step_s, state.two_steps)


@final
@dataclass(frozen=True)
class ChainTask:
    """What is to be solved: an equilibrium, or a step in time.

    Args:
        clamp: frames held by the flange.
        scheme: in what step, and how closely.
        begin: where a step begins; None in statics.
        two_steps: whether a step looks back over two.
        flange: (4, 3), its origin and axes at the end of a step.
        tangent: keeps the factor of a step.
    """

    clamp: FrameClamp
    scheme: ChainScheme
    begin: ChainState | None = None
    two_steps: bool = False
    flange: Array = field(default_factory=lambda: np.zeros((4, 3)))
    tangent: KeptTangent | None = None

    @property
    def bed(self) -> Bed:
        """Inertia of the step; none in statics."""
        if self.begin is None:
            return Bed(0.0, np.zeros_like(self.clamp.offsets))
        base, losses = self.begin.frames, self.scheme.damping + self.scheme.air_drag
        if self.two_steps and self.begin.earlier is not None:
            base = (4.0 * base - self.begin.earlier[0]) / 3.0
        return Bed(inertia_weight(self.span, losses), base)

    @property
    def span(self) -> float:
        """Span [s] of the step."""
        return 2.0 * self.scheme.h / 3.0 if self.two_steps else self.scheme.h


@final
class ChainSolver:
    """Solves one section body; owns the workspace.

    Args:
        section: what is solved.
    """

    def __init__(self, section: SectionBody) -> None:
        self.section = section
        count = len(section.frames)
        self.work = ChainWork.room(count)
        self.lever_m = float(
            np.mean([np.linalg.norm(shape, axis=1).mean() for shape in section.frames.shapes if len(shape)])
        )
        self._route()
        self._gravity: tuple[float, float, float] | None = None
        self._nodal: tuple[Array | None, float] = (None, 0.0)
        self._load = np.zeros((count, 4, 3))
        self._eyelets_at = np.nan
        self._eyelets = np.zeros((len(self._far), 2, 3))
        self._tensions: tuple[float, ...] | None = None
        self._tension = np.zeros(len(self._far))
        self._still, self._ends = np.zeros((count, 4, 3)), np.zeros((2, count, 4, 3))
        self._nothing = nothing_touched()

    def _route(self) -> None:
        """Find the frames of all cable segments; eyelets sit on rings of neighbouring units."""
        body, frames = self.section.body, self.section.frames
        self._segments = np.concatenate([np.zeros((0, 2), np.int64), *(c.segments for c in body.cables)])
        own = frames.before + (frames.fraction > 0.5)
        far = own[self._segments[:, 1]]
        on_rings = np.isin(frames.fraction[self._segments], (0.0, 1.0)).all()
        if not on_rings or (own[self._segments[:, 0]] != far - 1).any():
            raise InputError(
                "section models need every cable to run from unit to next unit through outer rings; "
                "use fidelity = 'lumped'"
            )
        self._far = far.astype(np.int64)
        side = (frames.fraction[self._segments] > 0.5).astype(int)
        table = self.section.model.nodes[:, self._segments, side, 1:]
        self._eyelet_table = np.ascontiguousarray(table).reshape(len(table), -1)
        self.losses_follow_shape = any(cable.friction_coefficient for cable in body.cables)
        self._ratios = [cable.tension_ratio(body.positions) for cable in body.cables]

    @property
    def eyelet_table(self) -> Array:
        """Eyelets of all cable segments in their frames (size, 6 k) [m], over the spline of pressure."""
        return self._eyelet_table

    def segment_tensions(self, tension_N: Array) -> Array:
        """Return the tension (n, k) [N] of all cable segments from those at the base ends (n, cables)."""
        pulls = [tension_N[:, c, None] * ratio for c, ratio in enumerate(self._ratios)]
        return np.concatenate([np.zeros((len(tension_N), 0)), *pulls], axis=1)

    def solve(
        self,
        start: Array,
        free: Mask,
        loads: Loads,
        tolerance_N: float,
        iterations_max: int,
        begin_Pa: float = 0.0,
    ) -> ChainStep:
        """Find the equilibrium near `start`, at given tensions.

        Args:
            start: (f, 4, 3), held frames where they shall be.
            free: (f,) frames that can move.
            loads: that act; nodal forces go to the frames beside each node.
            tolerance_N: residual at which it is done.
            iterations_max: bound.
            begin_Pa: gauge pressure at which the search for that of a sealed gas begins.
        """
        scheme = ChainScheme(0.0, 0.0, 0.0, tolerance_N, self.lever_m, iterations_max)
        return self.find(ChainTask(FrameClamp(~free, start), scheme), loads, start, begin_Pa)

    def find(self, task: ChainTask, loads: Loads, start: int | Array, begin_Pa: float) -> ChainStep:
        """Return the solution at given tensions, at the pressure that sealed gas has in it, by secants.

        Args:
            task: what is to be solved.
            loads: that act.
            start: one of the kernel's, or frames (f, 4, 3).
            begin_Pa: gauge pressure to begin with; without meaning where it is given.
        """
        gas = self.section.gas(loads)
        pressure, step, before = self.section.pressure(loads) if gas is None else begin_Pa, 0.0, 0.0
        found = self._attempt(task, loads, start, pressure)
        if gas is None:
            return found
        for _ in range(_ROUNDS_MAX - 1):
            if found.outcome is not Outcome.CONVERGED:
                break
            off = gas.gauge_pressure(float(self.section.volume(found.frames)[0])) - pressure
            whole = abs(pressure) + gas.ambient_Pa
            if abs(off) <= _TOLERANCE * whole:
                break
            slope = (off - before) / step if step else -1.0
            # more pressure, more volume: the true slope is below -1
            step = min(max(-off / min(slope, -1.0), -_STEP_MAX * whole), _STEP_MAX * whole)
            before, pressure = off, pressure + step
            found = self._attempt(task, loads, found.frames, pressure)
        return found

    def _attempt(self, task: ChainTask, loads: Loads, start: int | Array, pressure_Pa: float) -> ChainStep:
        """Solve at a pressure."""
        there, clamp, scheme, tangent = np.zeros_like(self._ends), task.clamp, task.scheme, task.tangent
        motion = there if task.begin is None else task.begin.motion
        gradient, figures, near = np.empty((len(there[0]), 6)), np.empty(assembly.FIGURES), motion[0]
        if not isinstance(start, int):
            there[0] = start
            near, start = there[0], GIVEN
        elif self.losses_follow_shape:
            near = near + scheme.h * motion[1]
        earlier = None if task.begin is None else task.begin.earlier
        work = self.work if tangent is None else tangent.work
        side = ChainSide(self.acting(loads, pressure_Pa, near), clamp.free, clamp.offsets, work)
        earlier = motion if earlier is None else earlier
        ends = ChainEnds(motion, earlier, task.flange, there, gradient, figures)
        kept = tangent is not None and tangent.serves(clamp, scheme.h, task.two_steps)
        outcome, iterations, residual, kept, potential, shifted = chain_step.solve_chain(
            side, scheme, ends, start, task.two_steps, kept
        )
        if tangent is not None:
            tangent.keep(kept, clamp, scheme.h, task.two_steps)
        return ChainStep(
            ChainState(there, None if task.begin is None else motion), gradient, figures,
            chain_step.OUTCOMES[outcome], iterations, residual, pressure_Pa, potential, shifted,
        )  # fmt: skip

    def evaluate(
        self,
        frames: Array,
        loads: Loads,
        pressure_Pa: float,
        bed: Bed | None = None,
        *,
        hessian: bool = False,
    ) -> Array:
        """Return the gradient (f, 6); with `hessian`, fill the tangent in `work` as well.

        Args:
            frames: (f, 4, 3).
            loads: that act.
            pressure_Pa: of the gas.
            bed: of an implicit step; None in statics.
            hessian: whether to fill the blocks.
        """
        gradient = np.empty((len(frames), 6))
        chain = self.acting(loads, pressure_Pa, frames)
        assembly.assemble(frames, chain, bed or Bed(0.0, self._still), gradient, self.work, hessian)
        return gradient

    def volume(self, frames: Array, pressure_Pa: float) -> Array:
        """Return the volumes (copies,) [m^3] enclosed by frames (f, 4, 3) at a gauge pressure."""
        self.section.set_pressure(pressure_Pa)
        return self.section.volume(frames)

    def acting(self, loads: Loads, pressure_Pa: float, frames: Array) -> section_strains.LoadedChain:
        """Bring the section to a pressure and return what acts on it.

        Args:
            loads: given on the film.
            pressure_Pa: of the gas.
            frames: (f, 4, 3) near the solution; losses of cables that rub follow the shape.

        Returns:
            The chain with dead loads, cables and contacts; the solver owns its arrays.

        Raises:
            InputError: a cable's length is commanded, or a triangle that may touch reaches across a frame.
        """
        section = self.section
        section.set_pressure(pressure_Pa)
        nodal = (loads.nodal_force, 0.0 if loads.nodal_force is None else pressure_Pa)
        if loads.gravity != self._gravity or nodal[0] is not self._nodal[0] or nodal[1] != self._nodal[1]:
            self._gravity, self._nodal = loads.gravity, nodal
            self._load = section.mass[:, 0, :, None] * np.array(loads.gravity)
            if loads.nodal_force is not None:
                self._load += section.spread(loads.nodal_force, pressure_Pa)
        if pressure_Pa != self._eyelets_at and len(self._far):
            self._eyelets_at = pressure_Pa
            section.terms.values(self._eyelet_table, self._eyelets.reshape(-1))
        if self._ratios:
            self._pull(loads, pressure_Pa, frames)
        touched = self._nothing
        if loads.contact is not None:
            touched = _touched(section, loads.contact, pressure_Pa)
        return section_strains.LoadedChain(
            *section.chain, self._load, self._far, self._eyelets, self._tension, *touched
        )

    def _pull(self, loads: Loads, pressure_Pa: float, frames: Array) -> None:
        """Bring the tension of all segments up to date."""
        if loads.cable_length_m and any(length is not None for length in loads.cable_length_m):
            raise InputError("a chain is solved at tensions; `solve_loaded` finds those of given lengths")
        if self.losses_follow_shape:
            x = self.section.positions(frames, pressure_Pa)
            self._ratios = [cable.tension_ratio(x) for cable in self.section.body.cables]
        elif loads.cable_tension_N == self._tensions:
            return
        self._tensions = loads.cable_tension_N
        pulls = zip(self._ratios, loads.cable_tension_N, strict=True)
        self._tension = np.concatenate([tension * ratio for ratio, tension in pulls])


def whole_tangent(
    solver: ChainSolver,
    frames: Array,
    acting: tuple[Loads, Array | None],
    pressure_Pa: float,
    bed: Bed | None = None,
) -> Array:
    """Return the tangent (6 f, 6 f) of a chain, see `ChainTangent`."""
    loads, extra = acting
    solver.evaluate(frames, loads, pressure_Pa, bed, hessian=True)
    count = len(frames)
    full = np.zeros((count, 6, count, 6))
    for f in range(count):
        full[f, :, f] = solver.work.diagonal[f]
        if f:
            full[f, :, f - 1] = solver.work.off[f]
            full[f - 1, :, f] = solver.work.off[f].T
    matrix = full.reshape(6 * count, -1)
    return matrix if extra is None else matrix + extra


_ROW, _COLUMN = np.tril_indices(6)
_BELOW, _BESIDE = np.indices((6, 6)).reshape(2, -1)


def _band_of(work: ChainWork, count: int, free: Mask) -> Array:
    """Return the lower band (12, 6 f) of the tangent in a chain's workspace; held frames are rows of one.

    Args:
        work: with the blocks of the first `count` frames.
        count: f.
        free: (f,) frames that can move.
    """
    band, beside = np.zeros((12, count, 6)), (free[1:] & free[:-1])[:, None]
    band[_ROW - _COLUMN, :, _COLUMN] = np.where(
        free[:, None], work.diagonal[:count, _ROW, _COLUMN], _ROW == _COLUMN
    ).T
    band[6 + _BELOW - _BESIDE, :-1, _BESIDE] = (beside * work.off[1:count, _BELOW, _BESIDE]).T
    return band.reshape(12, -1)


@final
class ChainTangent:
    """The factorised tangent of a chain: a band, unless something else is added to it.

    Args:
        solver: of the chain.
        frames: (f, 4, 3), where it is taken.
        free: (f,) frames that can move.
        acting: loads, and what is added to it (6 f, 6 f), such as that of commanded cables; None for nothing.
        pressure_Pa: of the gas; a sealed one is taken to keep it.
        bed: of an implicit step; None in statics.

    Raises:
        LinAlgError: it is not positive definite.
    """

    def __init__(
        self,
        solver: ChainSolver,
        frames: Array,
        free: Mask,
        acting: tuple[Loads, Array | None],
        pressure_Pa: float,
        bed: Bed | None = None,
    ) -> None:
        self._free, (loads, extra) = np.repeat(free, 6), acting
        self._band: Array | None = None
        if extra is None:
            solver.evaluate(frames, loads, pressure_Pa, bed, hessian=True)
            band = _band_of(solver.work, len(frames), free)
            self._band = cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)
            return
        matrix = whole_tangent(solver, frames, acting, pressure_Pa, bed)
        self._factor = cho_factor(matrix[np.ix_(self._free, self._free)])

    def solve(self, load: Array) -> Array:
        """Return the steps (k, f, 6) under loads (k, f, 6); zero where held."""
        flat = load.reshape(len(load), -1)
        if self._band is not None:
            given = np.where(self._free, flat, 0.0).T
            return cho_solve_banded((self._band, True), given, check_finite=False).T.reshape(load.shape)
        result = np.zeros_like(flat)
        result[:, self._free] = cho_solve(self._factor, flat[:, self._free].T).T
        return result.reshape(load.shape)


@final
class ChainSensitivity:
    """Derivatives of an equilibrium's tip.

    Args:
        solver: of the chain.
        frames: (f, 4, 3), at equilibrium.
        free: (f,) frames that can move.
        acting: see `ChainTangent`.
        pressure_Pa: of the gas.

    Raises:
        ConvergenceError: the equilibrium is not stable.
    """

    def __init__(
        self,
        solver: ChainSolver,
        frames: Array,
        free: Mask,
        acting: tuple[Loads, Array | None],
        pressure_Pa: float,
    ) -> None:
        self._solver, self._frames, self._loads, self._pressure = solver, frames, acting[0], pressure_Pa
        try:
            self._tangent = ChainTangent(solver, frames, free, acting, pressure_Pa)
        except LinAlgError as error:
            raise ConvergenceError(
                "the equilibrium is not stable (its tangent stiffness has a negative eigenvalue), so it has "
                "no useful sensitivity; change the pressure or the flange pose",
                0.0,
                0,
            ) from error
        section = solver.section
        self.tip = TipFrame.of(section.body, section.positions(frames, pressure_Pa))

    def to_gravity(self) -> Array:
        """Return d(tip motion)/d(gravity) (6, 3); the flange stays."""
        gx, gy, gz = self._loads.gravity
        return self._motion(
            [
                replace(self._loads, gravity=moved)
                for moved in ((gx + 1.0, gy, gz), (gx, gy + 1.0, gz), (gx, gy, gz + 1.0))
            ]
        )

    def to_tension(self) -> Array:
        """Return d(tip motion)/d(cable tension) (6, cables); the flange stays."""
        tension = self._loads.cable_tension_N
        if not tension:
            return np.zeros((6, 0))
        more = [tuple(t + 1.0 if k == c else t for k, t in enumerate(tension)) for c in range(len(tension))]
        return self._motion([replace(self._loads, cable_tension_N=pulled) for pulled in more])

    def _motion(self, loads: list[Loads]) -> Array:
        """Return the tip's motion (6, k) with loads that are one unit up; the gradient is linear in them."""
        still = self._solver.evaluate(self._frames, self._loads, self._pressure)
        change = [self._solver.evaluate(self._frames, load, self._pressure) - still for load in loads]
        return np.asarray(self._tangent.solve(-np.array(change))[:, -1].T)
