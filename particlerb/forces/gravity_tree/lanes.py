"""Sums of products of rows of numbers in SIMD lanes, compiled without a loop over the products.

A buffer is flat: row r has the numbers r BUCKET to (r + 1) BUCKET. What `multipole` sums has some
seven hundred products, known while compiling; as a loop over a table each would be read, added to
and written in turn, so `sums_of` writes the instructions one after another instead, which keeps
sums in registers. Where the compiler is switched off the same list is gone through in Python.
"""

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple, TypeAlias

from llvmlite import ir
from numba import types
from numba.core import cgutils

from particlerb.compiled.instructions import with_stand_in
from particlerb.compiled.jit import inline, unsigned
from particlerb.compiled.lanes import in_all_lanes
from particlerb.maths.vec3 import Floats

BUCKET: Final = 16  # particles of a bucket, and cells that are summed over at a time
_REGISTER: Final = 8  # numbers of a SIMD register; LLVM takes several where they are smaller
_FMA: Final = ("contract",)  # a b + c in one rounding

_Summing: TypeAlias = Callable[[Floats, Floats], None]


class Product(NamedTuple):
    """row[out] = (row[out] if `adds`) + factor row[b] (row[a], or number a of a list)."""

    out: int
    b: int
    a: int = -1  # row, if any
    number: int = -1  # in the list, if any
    factor: float = 1.0
    adds: bool = True


@inline
def at(row: int, lane: int) -> int:
    """Place in the buffer: unsigned, so that Numba asks not whether it is negative."""
    return unsigned(row * BUCKET + lane)


@inline
def clear(rows: Floats, first: int, end: int) -> None:
    """Write zeros into rows."""
    for i in range(first * BUCKET, end * BUCKET):
        rows[unsigned(i)] = 0.0


@inline
def lane_sum(rows: Floats, row: int) -> float:
    """Sum of a row, which is overwritten."""
    half = BUCKET // 2
    while half > 0:
        for i in range(half):
            rows[at(row, i)] += rows[at(row, i + half)]
        half //= 2
    return rows[at(row, 0)]


def sums_of(products: Sequence[Product], kept: range) -> _Summing:
    """Function of a buffer and a list of numbers that takes all products, one after another.

    Parameters
    ----------
    products : sequence of Product
        Those that the next ones need first.
    kept : range
        Rows that are written; others that are summed into have no defined values afterwards.
    """

    def typed(typing: Any, rows: Any, numbers: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            arrays = [
                context.make_array(kind)(context, builder, value).data
                for kind, value in zip(signature.args, arguments, strict=True)
            ]
            groups = ir.Constant(context.get_value_type(types.intp), BUCKET // _REGISTER)
            with cgutils.for_range(builder, groups) as loop:
                _Lanes(builder, arrays, loop.index).take(products, kept)
            return context.get_dummy_value()

        return types.void(rows, numbers), generate

    return with_stand_in(_in_python(products), typed)


class _Lanes:
    """Instructions for a register of lanes."""

    def __init__(self, builder: Any, arrays: Sequence[Any], group: Any) -> None:
        self.builder, self.arrays, self.group = builder, arrays, group
        self.vector = ir.VectorType(ir.DoubleType(), _REGISTER)
        self.rows: dict[int, Any] = {}
        self.numbers: dict[int, Any] = {}

    def take(self, products: Sequence[Product], kept: range) -> None:
        """Write the instructions of all products."""
        for product in products:
            self.rows[product.out] = self.value_of(product)
        for row in kept:
            self.builder.store(self.rows[row], self.address(row), align=8)

    def value_of(self, product: Product) -> Any:
        """Value that the row will have."""
        value = self.row(product.b)
        if product.factor != 1.0:
            factor = ir.Constant(self.vector, [product.factor] * _REGISTER)
            value = self.builder.fmul(value, factor, flags=_FMA)
        if product.a >= 0:
            value = self.builder.fmul(self.row(product.a), value, flags=_FMA)
        if product.number >= 0:
            value = self.builder.fmul(self.number(product.number), value, flags=_FMA)
        return (
            self.builder.fadd(self.row(product.out), value, flags=_FMA) if product.adds else value
        )

    def address(self, row: int) -> Any:
        """Where the lanes of a row are."""
        place = self.builder.mul(self.group, self.group.type(_REGISTER))
        place = self.builder.add(place, self.group.type(row * BUCKET))
        pointer = self.builder.gep(self.arrays[0], [place])
        return self.builder.bitcast(pointer, self.vector.as_pointer())

    def row(self, row: int) -> Any:
        """Lanes of a row, as they are by now."""
        if row not in self.rows:
            self.rows[row] = self.builder.load(self.address(row), align=8)
        return self.rows[row]

    def number(self, k: int) -> Any:
        """A number of the list in all lanes."""
        if k not in self.numbers:
            number = self.builder.load(self.builder.gep(self.arrays[1], [self.group.type(k)]))
            self.numbers[k] = in_all_lanes(self.builder, number, self.vector)
        return self.numbers[k]


def _in_python(products: Sequence[Product]) -> _Summing:
    """The same, for plain Python."""

    def sums(rows: Floats, numbers: Floats) -> None:
        row = rows.reshape(-1, BUCKET)
        for out, b, a, number, factor, adds in products:
            value = factor * row[b]
            value = value * row[a] if a >= 0 else value
            value = value * numbers[number] if number >= 0 else value
            row[out] = row[out] + value if adds else value

    return sums
