"""Elements: the terms of a soft body's potential, each described by one frozen class in one file.

An element says which nodes it couples and what it adds to potential, gradient and tangent. Everything else
is a loop over the elements of a body: its checks, the sparsity pattern, copies and attachments, the content
hash, saved states and the kernels to compile. For these loops each field of an element is marked as:
    NODES   node indices, one row for each of many equal parts,
    ROWS    further values, one row for each part,
    none    a constant of all parts; not an array.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache
from itertools import pairwise
from typing import (
    Annotated,
    Any,
    ClassVar,
    Final,
    NamedTuple,
    Protocol,
    Self,
    TypeVar,
    cast,
    final,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import IndexTable, Indices, Matrix, Vector
from cosim.base.state_checks import resolved
from cosim.errors import MeshError
from cosim.soft.elements.gas import SealedGas

NODES: Final = "nodes"
ROWS: Final = "rows"

_Kind = TypeVar("_Kind", bound="Element")
_Array = TypeVar("_Array", bound=np.ndarray[Any, Any])

_NO_TABLE = np.zeros((0, 0), np.int64)
_NOTHING = np.zeros(0)


class Acting(Protocol):
    """The loads that elements read, a part of `Loads`."""

    @property
    def cable_tension_N(self) -> tuple[float, ...]:
        """Tension of each cable at its base end."""

    @property
    def gravity_vector(self) -> Array:
        """Gravity (3,) [m/s^2]."""

    def pressures(self, chambers: int) -> tuple[float, ...]:
        """Return the commanded gauge pressure [Pa] of each chamber, given their number."""

    def gases(self, chambers: int) -> tuple[SealedGas | None, ...]:
        """Return the sealed gas of each chamber, None for a commanded pressure, given their number."""


class Remembered(NamedTuple):
    """Memory of an element, for kernels.

    Args:
        before: (m,), of the last accepted state.
        now: (m,), of the evaluated shape; filled.
    """

    before: Vector
    now: Vector


class Instant(NamedTuple):
    """Inputs of an element in addition to the positions.

    Args:
        memory: (m,), of the element at the last accepted state; not used by elements without memory.
        tracked: (m,), filled with the memory at the present shape; equal to `memory` beforehand.
        step_s: length of an implicit step; infinite in statics.
        loads: that act; None for the body alone.
        closely: whether the step is solved below the tolerance of an ordinary one.
    """

    memory: Array = _NOTHING
    tracked: Array = _NOTHING
    step_s: float = np.inf
    loads: Acting | None = None
    closely: bool = False

    def part(self, own: slice) -> "Instant":
        """Return the same inputs with the memory of one element, cut out of that of the body."""
        return self._replace(memory=self.memory[own], tracked=self.tracked[own])


STILL: Final = Instant()


def _no_hessian(*_: object) -> Any:
    raise LookupError("only the gradient is summed here")


@final
@dataclass(frozen=True)
class Sums:
    """The sums that terms add to; without `blocks` only the gradient is summed.

    Args:
        gradient: (n, 3) [N].
        blocks: (pattern.blocks, 3, 3) [N/m].
        diagonal: (n,), index in `blocks` of the pair of each node with itself.
        slots: nodes (parts, k) -> indices of their pairs in `blocks`, see `BlockPattern.slots`.
    """

    gradient: Array
    blocks: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))
    diagonal: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    slots: Callable[[IntArray], IntArray] = _no_hessian


class Call(NamedTuple):
    """A kernel with its arguments: the energy [J] is leaf(x, *given), with positions x (n, 3) [m].

    Args:
        leaf: compiled.
        given: its other arguments, prepared once.
    """

    leaf: Callable[..., float]
    given: tuple[Any, ...]


def writable(array: _Array) -> _Array:
    """Return a C-contiguous, writable array, as kernels need it; a copy only if it is not one already."""
    return cast(_Array, np.require(array, requirements=["C", "W"]))


class Term(Protocol):
    """Terms of a body's potential, such as all elements of one kind, with their indices in the tangent."""

    def add(self, positions: Array, at: Instant, hessian: bool) -> float:
        """Add the gradient and, if `hessian`, the Hessian; return the energy [J]."""


class NodalPotential(Protocol):
    """An additional potential of the nodes' positions, which is part of the loads, not of the body."""

    def add(self, positions: Array, sums: Sums, hessian: bool) -> float:
        """Add the gradient and, if `hessian`, the Hessian; return the energy [J]."""


class Element(ABC):
    """A term of the potential, or several equal ones; a subclass is a frozen dataclass.

    It does not depend on the drawn position and orientation of the body: directions are in local axes, so a
    copy of the body elsewhere has the same values.
    """

    label: ClassVar[str]
    """Name of the kind in messages."""
    single: ClassVar[bool] = False
    """Whether a body has at most one of the kind; that of an attached part is joined with it."""
    merges: ClassVar[bool] = True
    """Whether elements of a body's copies are joined, row after row; otherwise they follow copy by copy."""
    counted: ClassVar[bool] = False
    """Whether parts of a body are identified by their row number: elements of copies and attached parts
    follow one another, and neighbours with the same constants are joined."""
    far: ClassVar[bool] = False
    """Whether it couples nodes across the mesh."""

    @property
    def coupled(self) -> IntArray:
        """Nodes (parts, k) that it couples with one another: the field marked NODES."""
        (name,) = _marked(type(self), NODES)
        nodes: IntArray = getattr(self, name)
        return nodes

    @classmethod
    @abstractmethod
    def bound(cls, alike: Sequence[Self], sums: Sums) -> Sequence[Term]:
        """Return the terms of a body's elements of this kind: one for each, or one for all.

        Args:
            alike: these elements, in the body's order.
            sums: that they add to; they have blocks for all coupled nodes.
        """

    def first_memory(self, positions: Array) -> Array:
        """Return the memory (m,) in the drawn shape (n, 3) [m]; rigid motions do not change it."""
        return _NOTHING

    def advanced(self, positions: Array, tracked: Array) -> Array:
        """Return the memory (m,) after a shape (n, 3) [m] is accepted as the end of a step.

        Args:
            positions: that shape.
            tracked: (m,), see `Instant`.
        """
        return tracked

    def fresh(self, memory: Array) -> Array:
        """Return the memory (m,) at the start of a static solution, without results of other solutions."""
        return memory

    @property
    def remembers_steps(self) -> bool:
        """Whether its memory changes at the end of a step, not in evaluations: then it depends on rates."""
        return type(self).advanced is not Element.advanced

    def shifted(self, nodes: int) -> Self:
        """Return the same element with all node indices increased by a number."""
        return _replaced(self, {name: getattr(self, name) + nodes for name in _marked(type(self), NODES)})

    @classmethod
    def joined(cls, elements: Sequence[Self]) -> Self:
        """Return several elements joined to one, row after row.

        Raises:
            MeshError: their constants differ.
        """
        first = elements[0]
        for other_element in elements[1:]:
            for name in first.differences(other_element):
                constant, other_constant = getattr(first, name), getattr(other_element, name)
                raise MeshError(f"{cls.label} differ in {name}: {constant} and {other_constant}")
        rows = [name for name, mark in layout(cls).items() if mark is not None]
        return _replaced(
            first, {name: np.concatenate([getattr(element, name) for element in elements]) for name in rows}
        )

    def differences(self, other: Self) -> list[str]:
        """Return the names of the constants in which another element of the kind differs."""
        constants = (name for name, mark in layout(type(self)).items() if mark is None)
        return [name for name in constants if getattr(self, name) != getattr(other, name)]

    def all_nodes(self) -> IntArray:
        """Return the indices (k,) of all nodes in its fields."""
        return np.concatenate([np.ravel(getattr(self, name)) for name in _marked(type(self), NODES)])


class DirectElement(Element):
    """An element that is evaluated independently of others of its kind."""

    @abstractmethod
    def add(
        self, positions: Array, slots: IntArray, gradient: Array, blocks: Array, at: Instant = STILL
    ) -> float:
        """Add the gradient and, if slots is not empty, the Hessian; return the energy [J].

        Args:
            positions: (n, 3) [m], C-contiguous.
            slots: of the pairs of `coupled`, from `BlockPattern.slots`, or empty.
            gradient: (n, 3) [N].
            blocks: (pattern.blocks, 3, 3) [N/m].
            at: memory, loads and step.
        """

    @classmethod
    def bound(cls, alike: Sequence[Self], sums: Sums) -> Sequence[Term]:
        return [_Direct(element, sums) for element in alike]


@final
class _Direct:
    """A direct element with its indices in the tangent."""

    def __init__(self, element: DirectElement, sums: Sums) -> None:
        self._add, self._slots = element.add, sums.slots(element.coupled)
        self._gradient, self._blocks = sums.gradient, sums.blocks

    def add(self, positions: Array, at: Instant, hessian: bool) -> float:
        slots = self._slots if hessian else _NO_TABLE
        return self._add(positions, slots, self._gradient, self._blocks, at)


class LeafElement(DirectElement):
    """A direct element that one kernel adds, with arguments that are prepared once for a body."""

    @abstractmethod
    def call(
        self, memory: Remembered, slots: IntArray, gradient: Array, blocks: Array, *, moving: bool
    ) -> Call | None:
        """Return the kernel call that adds it; None if it is zero in every shape.

        Args:
            memory: of the element; the present one is filled.
            slots: of the pairs of `coupled`, from `BlockPattern.slots`; empty for the gradient alone.
            gradient: (n, 3) [N].
            blocks: (pattern.blocks, 3, 3) [N/m].
            moving: whether it is an ordinary step in time, not solved closely, see `Instant`.
        """

    def add(
        self, positions: Array, slots: IntArray, gradient: Array, blocks: Array, at: Instant = STILL
    ) -> float:
        before = at.memory if len(at.memory) else self.first_memory(positions)
        memory = Remembered(before, at.tracked if len(at.tracked) else np.empty_like(before))
        moving = at.step_s < np.inf and not at.closely
        call = self.call(memory, slots, gradient, blocks, moving=moving)
        return 0.0 if call is None else call.leaf(positions, *call.given)


def kinds_known(of: type[Element] = Element) -> list[type[Element]]:
    """Return all imported kinds of elements."""
    kinds = of.__subclasses__()
    return [*kinds, *(further for kind in kinds for further in kinds_known(kind))]


@cache
def layout(kind: type[Element]) -> dict[str, str | None]:
    """Return the mark of each field of a kind of elements.

    Raises:
        TypeError: it is not a frozen dataclass, or has an array without a mark, so that it cannot be copied.
    """
    described: Any = kind
    if "__dataclass_params__" not in vars(kind) or not described.__dataclass_params__.frozen:
        raise TypeError(f"{kind.__name__} must be a frozen dataclass")
    hints, marks = get_type_hints(kind, include_extras=True), dict[str, str | None]()
    for name in (entry.name for entry in fields(described)):
        mark = next((entry for entry in get_args(hints[name])[1:] if entry in (NODES, ROWS)), None)
        marks[name] = mark if get_origin(hints[name]) is Annotated else None
        if marks[name] is None and _holds_array(hints[name]):
            raise TypeError(f"{kind.__name__}.{name} is an array; mark it with NODES or ROWS")
    return marks


def _holds_array(hint: Any) -> bool:
    resolved_hint = resolved(hint)
    return get_origin(resolved_hint) is np.ndarray or any(
        _holds_array(argument) for argument in get_args(resolved_hint)
    )


def _marked(kind: type[Element], mark: str) -> list[str]:
    return [name for name, field_mark in layout(kind).items() if field_mark == mark]


def _replaced(element: _Kind, changes: dict[str, Any]) -> _Kind:
    any_dataclass: Any = element
    changed: _Kind = replace(any_dataclass, **changes)
    return changed


class EyeletLaws(NamedTuple):
    """All cables with the losses at their eyelets, for kernels; one row per segment unless noted.

    Args:
        segments: (s, 2), of all cables.
        routes: (cables + 1,), index of the first segment of each cable.
        places: (s,), index of the eyelet's anchor in the memory; -1 for none.
        laws: (s, 4), c, mu, F [N] and k [N/m].
    """

    segments: IndexTable
    routes: Indices
    places: Indices
    laws: Matrix

    @property
    def tied(self) -> list[IntArray]:
        """Nodes of each cable, base to tip; empty for cables without memory."""
        segments_of_cable = (self.segments[first:last] for first, last in pairwise(self.routes.tolist()))
        first_anchors = self.places[self.routes[:-1]]
        return [
            np.append(rows[:, 0], rows[-1, 1]) if first_anchor >= 0 else np.zeros(0, np.int64)
            for rows, first_anchor in zip(segments_of_cable, first_anchors, strict=True)
        ]
