"""Elements: the terms of a soft body's potential, each described by one frozen class in one file.

An element says which nodes it couples and what it adds to potential, gradient and tangent. Everything else
is a loop over the elements of a body: its checks, the sparsity pattern, copies and attachments, the content
hash, saved states and the kernels to compile. What these loops need to know of a field is its mark:
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
    """What the terms of a body ask of the loads (`Loads`)."""

    @property
    def cable_tension_N(self) -> tuple[float, ...]:
        """Tension of each cable at its base end."""

    @property
    def gravity_vector(self) -> Array:
        """Gravity (3,) [m/s^2]."""

    def pressures(self, chambers: int) -> tuple[float, ...]:
        """Return the given gauge pressure [Pa] of each of so many chambers."""

    def gases(self, chambers: int) -> tuple[SealedGas | None, ...]:
        """Return the sealed gas of each of so many chambers, None where the pressure is given."""


class Remembered(NamedTuple):
    """What kernels know of an element's memory.

    Args:
        before: (m,), of the last accepted state.
        now: (m,), filled.
    """

    before: Vector
    now: Vector


class Instant(NamedTuple):
    """What acts on an element besides the shape.

    Args:
        memory: (m,), what the element remembers of the last accepted state; of one that remembers nothing,
            anything.
        tracked: (m,), filled with what it makes of that at the present shape; equal to `memory` beforehand.
        step_s: length of an implicit step; infinite in statics.
        loads: that act; None where only the body itself is looked at.
        closely: whether the step is solved below the tolerance of an ordinary one.
    """

    memory: Array = _NOTHING
    tracked: Array = _NOTHING
    step_s: float = np.inf
    loads: Acting | None = None
    closely: bool = False

    def part(self, own: slice) -> "Instant":
        """Return the same for one of several elements that remember something, its part cut out."""
        return self._replace(memory=self.memory[own], tracked=self.tracked[own])


STILL: Final = Instant()


def _no_hessian(*_: object) -> Any:
    raise LookupError("only the gradient is summed here")


@final
@dataclass(frozen=True)
class Sums:
    """What terms add to; only the gradient where nobody asks for the Hessian.

    Args:
        gradient: (n, 3) [N].
        blocks: (pattern.blocks, 3, 3) [N/m].
        diagonal: (n,), where the pair of each node with itself is in `blocks`.
        slots: nodes (parts, k) -> where their pairs are in `blocks`, see `BlockPattern.slots`.
    """

    gradient: Array
    blocks: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))
    diagonal: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    slots: Callable[[IntArray], IntArray] = _no_hessian


class Call(NamedTuple):
    """A leaf with its arguments: the energy [J] is leaf(x, *given), x the positions (n, 3) [m].

    Args:
        leaf: compiled.
        given: its further arguments, made once.
    """

    leaf: Callable[..., float]
    given: tuple[Any, ...]


def writable(array: _Array) -> _Array:
    """Return an array as leaves take it: in one stretch and writable; a copy where it is not."""
    return cast(_Array, np.require(array, requirements=["C", "W"]))


class Term(Protocol):
    """Elements of one kind, or what else a body has a potential of, with their places in the tangent."""

    def add(self, positions: Array, at: Instant, hessian: bool) -> float:
        """Add the gradient and, if told to, the Hessian; return the energy [J]."""


class NodalPotential(Protocol):
    """A further potential of the nodes' positions, which comes and goes with what acts on a body."""

    def add(self, positions: Array, sums: Sums, hessian: bool) -> float:
        """Add the gradient and, if told to, the Hessian; return the energy [J]."""


class Element(ABC):
    """A term of the potential, or several equal ones; a subclass is a frozen dataclass.

    Nothing in it depends on where in space the body is drawn: what has a direction is said in axes of its
    own, so that a copy elsewhere has the same values at other nodes.
    """

    label: ClassVar[str]
    """What messages call it."""
    single: ClassVar[bool] = False
    """Whether a body has one of the kind at most; that of an attached part becomes one with it."""
    merges: ClassVar[bool] = True
    """Whether those of a body's copies become one, row after row; otherwise they follow copy by copy."""
    counted: ClassVar[bool] = False
    """Whether a body's parts are named by their places in its rows: copies and attached parts come one after
    the other, and neighbours with the same constants become one."""
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
            sums: what they add to; there are blocks for all that they couple.
        """

    def first_memory(self, positions: Array) -> Array:
        """Return what it remembers (m,) in the drawn shape (n, 3) [m]; a rigid motion changes none of it."""
        return _NOTHING

    def advanced(self, positions: Array, tracked: Array) -> Array:
        """Return what it remembers (m,) once a shape (n, 3) [m] is accepted as a step's end.

        Args:
            positions: that shape.
            tracked: (m,), see `Instant`.
        """
        return tracked

    def fresh(self, memory: Array) -> Array:
        """Return memory (m,) as a static solution begins with it: without what another one has shown."""
        return memory

    @property
    def remembers_steps(self) -> bool:
        """Whether it remembers something of a step's end that it has not tracked: then it feels rates."""
        return type(self).advanced is not Element.advanced

    def shifted(self, nodes: int) -> Self:
        """Return the same element where this many nodes come before its own."""
        return _replaced(self, {name: getattr(self, name) + nodes for name in _marked(type(self), NODES)})

    @classmethod
    def joined(cls, elements: Sequence[Self]) -> Self:
        """Return several as one, row after row.

        Raises:
            MeshError: constants of them differ.
        """
        first = elements[0]
        for other in elements[1:]:
            for name in first.differences(other):
                one, another = getattr(first, name), getattr(other, name)
                raise MeshError(f"{cls.label} differ in {name}: {one} and {another}")
        rows = [name for name, mark in layout(cls).items() if mark is not None]
        return _replaced(
            first, {name: np.concatenate([getattr(entry, name) for entry in elements]) for name in rows}
        )

    def differences(self, other: Self) -> list[str]:
        """Return the names of the constants in which another element of the kind differs."""
        constants = (name for name, mark in layout(type(self)).items() if mark is None)
        return [name for name in constants if getattr(self, name) != getattr(other, name)]

    def all_nodes(self) -> IntArray:
        """Return the indices (k,) of all nodes that it names."""
        return np.concatenate([np.ravel(getattr(self, name)) for name in _marked(type(self), NODES)])


class DirectElement(Element):
    """An element that shares nothing with others of its kind."""

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
            at: what acts besides the shape.
        """

    @classmethod
    def bound(cls, alike: Sequence[Self], sums: Sums) -> Sequence[Term]:
        return [_Direct(element, sums) for element in alike]


@final
class _Direct:
    """A direct element with its places in the tangent."""

    def __init__(self, element: DirectElement, sums: Sums) -> None:
        self._add, self._slots = element.add, sums.slots(element.coupled)
        self._gradient, self._blocks = sums.gradient, sums.blocks

    def add(self, positions: Array, at: Instant, hessian: bool) -> float:
        slots = self._slots if hessian else _NO_TABLE
        return self._add(positions, slots, self._gradient, self._blocks, at)


class LeafElement(DirectElement):
    """A direct element that one leaf adds, whose arguments are made once for a body."""

    @abstractmethod
    def call(
        self, memory: Remembered, slots: IntArray, gradient: Array, blocks: Array, *, moving: bool
    ) -> Call | None:
        """Return what adds it; None where it does nothing, whatever the shape.

        Args:
            memory: what it remembers, and room for what it makes of that.
            slots: of the pairs of `coupled`, from `BlockPattern.slots`; empty: the gradient alone is added.
            gradient: (n, 3) [N].
            blocks: (pattern.blocks, 3, 3) [N/m].
            moving: whether it is in a step in time that is not solved closely, see `Instant`.
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
    """Return all kinds of elements that were imported."""
    kinds = of.__subclasses__()
    return [*kinds, *(further for kind in kinds for further in kinds_known(kind))]


@cache
def layout(kind: type[Element]) -> dict[str, str | None]:
    """Return the mark of each field of a kind of elements.

    Raises:
        TypeError: it is no frozen dataclass, or has an array without a mark, which copies would not know.
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
    plain = resolved(hint)
    return get_origin(plain) is np.ndarray or any(_holds_array(entry) for entry in get_args(plain))


def _marked(kind: type[Element], mark: str) -> list[str]:
    return [name for name, found in layout(kind).items() if found == mark]


def _replaced(element: _Kind, changes: dict[str, Any]) -> _Kind:
    any_dataclass: Any = element
    changed: _Kind = replace(any_dataclass, **changes)
    return changed


class EyeletLaws(NamedTuple):
    """Cables and what they lose at their eyelets, for kernels; segment by segment where nothing else is said.

    Args:
        segments: (s, 2), of all cables.
        routes: (cables + 1,), where the segments of each cable begin.
        places: (s,), where the eyelet's anchor is in the memory, -1 where it remembers nothing.
        laws: (s, 4), c, mu, F [N] and k [N/m].
    """

    segments: IndexTable
    routes: Indices
    places: Indices
    laws: Matrix

    @property
    def tied(self) -> list[IntArray]:
        """Nodes of each cable that remembers, base to tip; none of the others."""
        own = (self.segments[first:last] for first, last in pairwise(self.routes.tolist()))
        firsts = self.places[self.routes[:-1]]
        return [
            np.append(rows[:, 0], rows[-1, 1]) if place >= 0 else np.zeros(0, np.int64)
            for rows, place in zip(own, firsts, strict=True)
        ]
