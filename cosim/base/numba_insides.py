"""numba's insides in one place: all that uses its private modules, or writes code in LLVM's language.

Measured on the reference arm (CPU time of the first run from an empty cache; relative time of the loop):

| compiled with | first run | run |
|---|---|---|
| public `njit(cache=True)` alone | 165 s | 1.41 |
| without counting references as well | 128 s | 1.14 |
| with calls by address as well | 86 s | 1.03 |
| with device functions as intermediate code as well | 41 s | 1.00 |

Since then kernels have grown; the first run takes 72 s, with large records read where they lie (`RecordAt`).

Any numba other than `KNOWN` compiles in its public way instead; results are the same up to rounding.
"""

import pickle
from collections.abc import Callable
from ctypes import CFUNCTYPE, addressof, c_int64, c_void_p, cast
from types import SimpleNamespace
from typing import Any, Final, NoReturn, final

import llvmlite.binding as llvm
import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, lower_cast, lower_getattr_generic, models, register_model

KNOWN: Final = str(numba.__version__).startswith("0.68.")  # its insides are as the code below expects
SLOW: Final = (
    ""
    if KNOWN
    else (
        f"numba {numba.__version__} is not 0.68: kernels compile by its public functions, four times as "
        "long; install numba>=0.68,<0.69"
    )
)
"""What to say where the insides are not known; empty where they are."""
_ALIGNMENT = 32  # [bytes], of the widest loads
_FIND = "cosim_code_at"  # the name of what finds kernels, in compiled code
processor: Any = llvm.get_host_cpu_name
untyped_intrinsic: Callable[..., Any] = intrinsic  # as those that follow: typed for mypy
_lower_cast: Callable[..., Callable[..., Any]] = lower_cast
_lower_getattr: Callable[..., Callable[..., Any]] = lower_getattr_generic
BASE_TUPLE: Any = types.BaseTuple


def to_bytes(compiled: Any, *, alone: bool) -> bytes | None:
    """Return what can be kept of compiled code; None where it holds addresses of this process.

    Args:
        compiled: as numba hands it to its cache.
        alone: leave out intermediate code, which calls by name need; a start then takes a tenth less.
    """
    from numba.core.serialize import dumps

    if compiled.library.has_dynamic_globals:
        return None
    if alone:  # numba asks for the names of its functions
        names = sorted(entry.name for entry in compiled.library.get_defined_functions())
        empty = "".join(f'define void @"{name}"() {{ ret void }}\n' for name in names)
        compiled.library._shared_module = llvm.parse_assembly(empty)
    return bytes(dumps(compiled._reduce()))


def from_bytes(data: bytes, context: Any) -> Any:
    """Return the compiled code of `to_bytes` in a target context of numba."""
    from numba.core.compiler import CompileResult

    return CompileResult._rebuild(context, *pickle.loads(data))


def has_arrays(kind: Any) -> bool:
    """Return whether a type of numba is an array, or a tuple with arrays in it."""
    return isinstance(kind, types.Array) or any(map(has_arrays, getattr(kind, "types", ())))


if KNOWN:
    from numba.core.cgutils import get_or_insert_function, if_unlikely, pack_array, unpack_tuple
    from numba.core.codegen import CPUCodeLibrary
    from numba.core.compiler import Compiler
    from numba.core.registry import CPUDispatcher
    from numba.core.targetconfig import ConfigStack
    from numba.core.typeconv.castgraph import Conversion
    from numba.core.typing.templates import AttributeTemplate, infer_getattr
    from numba.np.arrayobj import make_array, populate_array

    @final
    class IntermediateCode(CPUCodeLibrary):
        """Code of a function that is optimised with each kernel that calls it: 41 instead of 86 s."""

        codegen = SimpleNamespace(set_env=lambda *_given: None)  # keeps track of machine code: none is made

        def _optimize_final_module(self) -> None: ...

        def _finalize_final_module(self) -> None:
            self._finalize_dynamic_globals()
            self._finalized = True

        def get_pointer_to_function(self, name: str) -> int:
            return 0  # as there is no machine code

    @final
    class DeviceCompiler(Compiler):
        """Compiles a function to `IntermediateCode`."""

        def __init__(self, *given: Any) -> None:
            super().__init__(*given)
            self.state.library = IntermediateCode(self.state.targetctx.codegen(), "device_function")

    @final
    class DeviceFunction(CPUDispatcher):
        """A function that only kernels can call; a TypeError says where it is marked wrongly."""

        hands_on_views = False

        def __call__(self, *_given: Any) -> NoReturn:
            raise TypeError(f"only kernels can call {self.py_func.__name__}(), which has no code of its own")

        def get_call_template(self, *given: Any) -> Any:
            """Return how a function calls this one, unless it counts references, which this does not."""
            if self.hands_on_views and ConfigStack().top().nrt:
                what = f"{self.py_func.__name__}() counts no references to the views that it hands on"
                raise TypeError(f"{what}: what is marked as allocating cannot call it")
            return super().get_call_template(*given)

        def compile(self, signature: Any) -> Any:
            """Compile; numba refuses to return an uncounted array by itself, but not in a tuple."""
            found: Any = super().compile(signature)
            returned = any(has_arrays(entry.return_type) for entry in self.nopython_signatures)
            if returned and not self.targetoptions["_nrt"] and not self.hands_on_views:
                name = self.py_func.__name__
                raise TypeError(f"{name}() returns arrays: mark it as allocating or handing on views")
            return found

    @final
    class Kernel(CPUDispatcher):
        """A kernel without intermediate code, which kernels call by its address only."""

        def get_call_template(self, *_given: Any) -> NoReturn:
            """Refuse a call by name with a TypeError."""
            what = f"{self.py_func.__name__}() is a kernel of its own"
            raise TypeError(f"{what}: mark it as taken in, or call it by its address, see `caller`")


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


def _code_at(context: Any, builder: Any, place: Any) -> Any:
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
            convention, at = context.call_conv, _code_at(context, builder, values[0])
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


@untyped_intrinsic
def same_bits(_typing: Any, value: Any) -> Any:
    """Return the uint64 with the bits of a real number, or the reverse; loops over lanes stay vectorised."""
    kind = types.uint64 if isinstance(value, types.Float) else types.float64

    def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return builder.bitcast(values[0], context.get_value_type(kind))

    return kind(value), generate


def stack_array(lengths: tuple[Any, ...], *, zeros: bool = False) -> Any:
    """Return type and code of an array on a kernel's stack, which needs no counting; None if sizes vary."""
    shape = [int(length.literal_value) for length in lengths if isinstance(length, types.IntegerLiteral)]
    if len(shape) < len(lengths):
        return None
    made = types.Array(types.float64, len(shape), "C")

    def generate(context: Any, builder: Any, _signature: Any, _given: Any) -> Any:
        with builder.goto_entry_block():  # once, however often a loop comes by
            place = builder.alloca(ir.ArrayType(ir.DoubleType(), int(np.prod(shape))))
            place.align = _ALIGNMENT
        if zeros:
            builder.store(ir.Constant(place.type.pointee, None), place)
        array, integer = make_array(made)(context, builder), context.get_value_type(types.intp)
        strides = [8 * int(np.prod(shape[k + 1 :])) for k in range(len(shape))]
        sizes = [
            pack_array(builder, [ir.Constant(integer, size) for size in sizes]) for sizes in (shape, strides)
        ]
        data, item = builder.bitcast(place, ir.DoubleType().as_pointer()), ir.Constant(integer, 8)
        populate_array(array, data=data, shape=sizes[0], strides=sizes[1], itemsize=item, meminfo=None)
        return array._getvalue()

    return made(*lengths), generate
