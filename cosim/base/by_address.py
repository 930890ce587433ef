"""Records and kernels by address, until their last users have gone."""

import _thread
import logging
from collections.abc import Callable
from ctypes import CFUNCTYPE, addressof, c_char, c_int64, c_void_p, cast
from functools import cache
from struct import Struct
from typing import Any, TypeVar, final

import llvmlite.binding as llvm
import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import lower_cast, lower_getattr_generic, models, register_model

from cosim.base import compilation, numba_insides
from cosim.base.kernel_types import numba_type
from cosim.base.numba_insides import KNOWN, untyped_intrinsic

if KNOWN:
    from numba.core.cgutils import get_or_insert_function, if_unlikely, unpack_tuple
    from numba.core.typeconv.castgraph import Conversion
    from numba.core.typing.templates import AttributeTemplate, infer_getattr

Record = TypeVar("Record")
_FIND = "cosim_code_at"  # the name of what finds kernels, in compiled code
_lower_cast: Callable[..., Callable[..., Any]] = lower_cast
_lower_getattr: Callable[..., Callable[..., Any]] = lower_getattr_generic
BASE_TUPLE: Any = types.BaseTuple


@final
class RecordAt(types.Type):
    """A named tuple in memory: kernels read each field where they need it, and it is never copied whole.

    Given by value, each of its numbers is a variable of each function that it comes by: the kernel of rows of
    ticks, with 2,400 of them, takes 31 s to compile; with those at their addresses see `RecordStore`.
    """

    def __init__(self, record: Any) -> None:
        self.record, self.fields = record, record.instance_class._fields
        super().__init__(f"RecordAt({record.instance_class.__module__}.{record.instance_class.__name__})")

    def kind_of(self, place: int) -> Any:
        """Return the type as which a field is read."""
        kind = self.record.types[place]
        return RecordAt(kind) if isinstance(kind, types.BaseNamedTuple) else kind

    def can_convert_to(self, _context: Any, other: Any) -> Any:
        """Return that it can be copied where a named tuple is asked for."""
        return Conversion.safe if KNOWN and other == self.record else None


@register_model(RecordAt)
class _RecordModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, ir.IntType(8).as_pointer())


if KNOWN:

    @infer_getattr
    class _RecordFields(AttributeTemplate):
        key = RecordAt

        def generic_resolve(self, kind: Any, name: str) -> Any:  # type: ignore[override]
            return kind.kind_of(kind.fields.index(name)) if name in kind.fields else None


def words_of(kind: Any) -> int:
    """Return of how many words of 8 bytes an argument of some type is, in memory."""
    if isinstance(kind, types.Array):
        return 5 + 2 * int(kind.ndim)
    return sum(words_of(part) for part in kind.types) if isinstance(kind, BASE_TUPLE) else 1


def _field(context: Any, builder: Any, kind: Any, value: Any, place: int) -> Any:
    begin = ir.Constant(ir.IntType(32), 8 * sum(map(words_of, kind.record.types[:place])))
    at, wanted = builder.gep(value, [begin]), kind.kind_of(place)
    if isinstance(wanted, RecordAt):
        return at
    loaded = builder.load(builder.bitcast(at, context.get_value_type(wanted).as_pointer()))
    loaded.set_metadata("invariant.load", builder.module.add_metadata([]))  # nobody changes it meanwhile
    return loaded


@_lower_getattr(RecordAt)
def _read_field(context: Any, builder: Any, kind: Any, value: Any, name: str) -> Any:
    return _field(context, builder, kind, value, kind.fields.index(name))


def _as_value(context: Any, builder: Any, value: Any, from_: Any, to: Any) -> Any:
    """Return a value of one type as another, with copies of records, within tuples as well."""
    if from_ == to:
        return value
    if isinstance(from_, RecordAt) or (isinstance(from_, BASE_TUPLE) and isinstance(to, BASE_TUPLE)):
        parts = []
        for place, wanted in enumerate(to.types):
            if isinstance(from_, RecordAt):
                part, kind = _field(context, builder, from_, value, place), from_.kind_of(place)
            else:
                part, kind = builder.extract_value(value, place), from_.types[place]
            parts.append(_as_value(context, builder, part, kind, wanted))
        return context.make_tuple(builder, to, parts)
    return context.cast(builder, value, from_, to)


@_lower_cast(RecordAt, BASE_TUPLE)
def _copy_record(context: Any, builder: Any, from_: Any, to: Any, value: Any) -> Any:
    return _as_value(context, builder, value, from_, to)


def reference(address: Any, kind: Any, record: Any) -> Any:
    """Return type and code of what takes an integer for the address of a record; a copy unless `KNOWN`."""

    def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        at = builder.inttoptr(values[0], ir.IntType(8).as_pointer())
        return at if KNOWN else _as_value(context, builder, at, RecordAt(record), record)

    return (RecordAt(record) if KNOWN else record)(address, kind), generate


def number_at(name: str, place: c_int64) -> Any:
    """Return what reads, in a kernel, a number of this process; kept machine code finds it by its name.

    Args:
        name: in compiled code.
        place: of the number; it stays where it is.
    """
    llvm.add_symbol(name, addressof(place))

    def read(_typing: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, _given: Any) -> Any:
            known = builder.module.globals.get(name)
            return builder.load(known or ir.GlobalVariable(builder.module, ir.IntType(64), name))

        return types.int64(), generate

    return untyped_intrinsic(read)


def code_for_c(kernel: Any, signature: Any) -> int:
    """Return the address at which C may call a compiled kernel."""
    compiled = kernel.overloads[tuple(signature.args)]
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_cfunc_wrapper_name))


def find_kernels_by(find: Callable[[int], int]) -> Any:
    """Let compiled code ask for a kernel that is called for the first time; return what has to stay for it.

    Args:
        find: takes a kernel's place, see `caller`; returns the address of its code, 0 if compiling fails.
    """
    kept = CFUNCTYPE(c_int64, c_int64)(find)
    llvm.add_symbol(_FIND, cast(kept, c_void_p).value)
    return kept


def _emit_code_at(context: Any, builder: Any, place: Any) -> Any:
    """Return the address of the code of the kernel of a place; raise if it cannot be compiled."""
    begin, word = builder.block, ir.IntType(64)
    known = builder.load(builder.inttoptr(place, word.as_pointer()))
    with if_unlikely(builder, builder.icmp_unsigned("==", known, word(0))):
        find = get_or_insert_function(builder.module, ir.FunctionType(word, [word]), _FIND)
        found = builder.call(find, [place])
        with if_unlikely(builder, builder.icmp_unsigned("==", found, word(0))):
            context.call_conv.return_user_exc(builder, RuntimeError, ("a kernel could not be compiled",))
        late = builder.block
    code = builder.phi(word)
    code.add_incoming(known, begin)
    code.add_incoming(found, late)
    return code


def caller(kernel: Any) -> Any:
    """Return what calls a kernel from within others: call(place, tuple of arguments).

    The place is memory that holds the address of the kernel's code, 0 until it is first called: what a run
    does not call needs no compilation, and nothing is called that is not there. A kernel called by name is
    compiled within each that calls it: 128 instead of 86 s.
    """
    if not KNOWN:
        return numba.njit(lambda _place, given: kernel(*given))
    wanted, returned = types.Tuple(kernel.fixed_signature.args), kernel.fixed_signature.return_type

    def call(_typing: Any, place: Any, given: Any) -> Any:
        def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
            convention, at = context.call_conv, _emit_code_at(context, builder, values[0])
            code = convention.get_function_type(returned, wanted.types)
            function = builder.inttoptr(at, ir.PointerType(code))
            pairs = zip(unpack_tuple(builder, values[1]), given.types, wanted.types, strict=True)
            as_wanted = [_as_value(context, builder, value, from_, to) for value, from_, to in pairs]
            status, result = convention.call_function(builder, function, returned, wanted.types, as_wanted)
            with if_unlikely(builder, status.is_error):
                convention.return_status_propagate(builder, status)
            return result

        return returned(types.int64, given), generate

    return untyped_intrinsic(call)


@untyped_intrinsic
def call_native(_typing: Any, address: Any, first: Any, second: Any) -> Any:
    """Call a C function of two pointers by its address: through Python it takes several times as long."""

    def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        code = ir.FunctionType(ir.VoidType(), [value.type for value in values[1:]])  # pointers as integers
        builder.call(builder.inttoptr(values[0], code.as_pointer()), values[1:])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), generate


@cache
def address_of(kernel: Any) -> int:
    """Return the place of a kernel, by which others call it, see `caller`: it need not be compiled yet."""
    place = c_int64(0)
    _PLACES[addressof(place)] = kernel, place
    return addressof(place)


def c_address(kernel: Any) -> int:
    """Return the address at which C calls a kernel that was made for it; it is compiled if need be."""
    compilation.compile_kernels((kernel,))
    kernel.compile(kernel.fixed_signature)  # here as well, or from the cache
    return code_for_c(kernel, kernel.fixed_signature)


def _code_at(at: int) -> int:
    """Return where the code of the kernel of a place is, and keep it there; 0 if it cannot be compiled.

    With it the other kernels of its module are compiled, which is announced as before a run.
    """
    kernel, place = _PLACES[at]
    signature, log = kernel.fixed_signature, logging.getLogger("cosim")
    try:
        if not kernel.overloads:
            compilation.compile_kernels((kernel,))
        kernel.compile(signature)
        compiled = kernel.overloads[tuple(signature.args)]
        place.value = compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
    except KeyboardInterrupt:
        _thread.interrupt_main()  # raised where compiled code ends, as it cannot be within
    except Exception:
        log.exception("%s() could not be compiled", kernel.__name__)
    return place.value


_PLACES: dict[int, tuple[Any, c_int64]] = {}
_FINDS = find_kernels_by(_code_at)


@final
class RecordStore:
    """Keeps a record where kernels read it by its address, see `record_at`: as 8 bytes for each number.

    Args:
        kind: named tuple of what kernels take.
    """

    def __init__(self, kind: Any) -> None:
        self._layout = _layout(numba_type(kind))
        self._words, self._last = np.zeros(self._layout[0], np.int64), None

    def address(self, record: Any) -> int:
        """Return where a record is until the next one is given; only what has changed is written.

        Raises:
            TypeError: an array in it is none that the kernels take.
        """
        last, self._last = self._last, None
        self._write(self._layout, record, last, 0)
        self._last = record  # so that its arrays stay
        return int(self._words.ctypes.data)

    def _write(self, layout: Any, given: Any, last: Any, begin: int) -> None:
        if given is last:
            return
        _, kind, parts = layout
        if parts is not None:
            earlier = (None,) * len(parts) if last is None else last
            for part, value, before in zip(parts, given, earlier, strict=True):
                if value is not before:
                    self._write(part, value, before, begin)
                begin += part[0]
        elif kind == "float64":
            self._words.view(np.float64)[begin] = given
        elif kind is None:
            self._words[begin] = given
        elif given.dtype != kind[0] or given.ndim != kind[1] or not (given.flags.c_contiguous or kind[3]):
            raise TypeError(f"an array of {given.dtype} {given.shape} is none of {kind[:2]}")
        else:
            # read-only arrays, or with gaps, have no buffer for ctypes; numpy's way takes six times as long
            place = 0
            if given.size:
                writable = given.flags.writeable and given.flags.c_contiguous
                place = addressof(c_char.from_buffer(given)) if writable else given.ctypes.data
            numbers = given.size, given.itemsize, place, *given.shape, *given.strides
            # the first two words are its owner, which none asks for
            kind[2](self._words, 8 * (begin + 2), *numbers)


def _layout(kind: Any) -> tuple[int, Any, Any]:
    """Return words, type of a number or of the entries of an array, and the parts of a tuple."""
    words = words_of(kind)
    if isinstance(kind, BASE_TUPLE):
        return words, None, [_layout(part) for part in kind.types]
    if isinstance(kind, types.Array):
        dtype = np.dtype("bool" if kind.dtype == types.boolean else str(kind.dtype))
        return words, (dtype, kind.ndim, Struct(f"{words - 2}q").pack_into, kind.layout == "A"), None
    return words, "float64" if kind == types.float64 else None, None


@untyped_intrinsic
def _record_at(_typing: Any, address: Any, kind: Any) -> Any:
    return reference(address, kind, numba_type(kind.instance_class))


record_at: Callable[[int, type[Record]], Record] = _record_at


def handing_on_views(function: Any) -> Any:
    """Mark a device function that hands on, in named tuples, views of arrays that it is given."""
    result: Any = numba_insides.device_function(
        function, nogil=True, error_model="numpy", **numba_insides.counting(allocates=False)
    )
    result.hands_on_views = True
    return result
