"""Helpers are copied into kernels, have no code of their own, and can be called from Python."""

import math

import numpy as np
import pytest
from numba import types
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult

from particlerb.compiled.jit import compile_with, config, inline, kernel, unfused_kernel
from particlerb.maths import vec3

pytestmark = [
    pytest.mark.compiled,
    pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled in plain Python"),
]

_ARRAY = types.Array(types.float64, 1, "C")


@inline
def _cube(x):
    return x * x * x


@inline
def _fourth(x):
    return x * _cube(x)


@kernel
def _sum(values):
    total = 0.0
    for x in values:
        total += _cube(x) + _fourth(x)
    return total


@inline
def _checked(x):
    if x < 0.0:
        raise ValueError("below zero")
    return math.sqrt(x)


@kernel
def _root(x):
    return _checked(x)


@kernel
def _product(m, out):
    """Some hundred instructions: too long to be copied into what calls it."""
    for i in range(6):
        a, b, c, d, e, f = m[i], m[i + 6], m[i + 12], m[i + 18], m[i + 24], m[i + 30]
        out[i] = a * b + c * d + e * f
        out[i + 6] = math.sqrt(a * a + b * b + c * c) / (1.0 + d * d + e * e + f * f)
        out[i + 12] = (a - b) * (c - d) * (e - f) + (a + b) * (c + d) * (e + f)


@inline
def _two_products(m, out):
    _product(m, out)
    _product(out, m)


@kernel
def _four_products(m, out):
    _two_products(m, out)
    _two_products(out, m)


@unfused_kernel
def _four_rounded(m, out):
    _two_products(m, out)
    _two_products(out, m)


_FOUR = [_four_products, _four_rounded]
if not config.DISABLE_JIT:
    _FOUR.append(compile_with()(_four_products.py_func))


def from_no_disk(*kernels):
    """Have kernels compiled, even where the tests before left them on disk."""
    for one in kernels:
        one._cache = NullCache()


if not config.DISABLE_JIT:
    from_no_disk(_sum, _root, _product, *_FOUR)


def machine_code(function):
    """Names of the functions that LLVM has made code of, for the signatures of a helper."""
    found = []
    for result in function.overloads.values():
        engine = result.library.codegen._engine
        found += [
            name for name in (result.fndesc.llvm_func_name,) if engine.is_symbol_defined(name)
        ]
    return found


def test_kernels_copy_helpers_that_have_no_code_of_their_own():
    assert _sum(np.array([1.0, 2.0, 0.5])) == 1.0 + 1.0 + 8.0 + 16.0 + 0.125 + 0.0625
    for helper in (_cube, _fourth):
        assert helper.overloads
        assert machine_code(helper) == []
    assert machine_code(_sum)
    names = [result.fndesc.llvm_func_name for result in _cube.overloads.values()]
    (code,) = (result.library.get_llvm_str() for result in _sum.overloads.values())
    assert not any(name in code for name in names)


def test_a_helper_can_be_called_from_python_before_and_behind_a_kernel():
    @inline
    def square(x):
        return _cube(x) / x

    assert square(3.0) == 9.0
    assert square(x=2) == 4.0
    assert square.py_func(5.0) == 25.0
    assert _fourth(2.0) == 16.0


def test_another_kernel_finds_the_code_of_a_helper_of_the_package_on_disk():
    def doubled(helper):
        def length(x):
            return helper((x, 0.0, 2.0 * x))

        return compile_with()(length)

    first, second = inline(vec3.norm.py_func), inline(vec3.norm.py_func)
    assert doubled(first)(4.0) == doubled(second)(4.0) == math.sqrt(80.0)
    assert sum(second.stats.cache_hits.values()) == 1
    assert machine_code(second) == []


def test_a_kernel_that_kernels_call_has_no_entry_of_its_own():
    @kernel
    def twice(x):
        return 2.0 * _root(x)

    from_no_disk(twice)
    assert twice(4.0) == 4.0
    assert _root.copied.overloads
    assert machine_code(_root.copied) == []
    assert _root(9.0) == 3.0
    assert machine_code(_root)


def test_a_helper_of_others_is_not_kept():
    """What it reaches may stand in another file, which may change."""
    for helper in (inline(_checked.py_func), inline(_checked.py_func)):
        assert compile_with()(lambda x, root=helper: root(x))(4.0) == 2.0
        assert not helper.stats.cache_hits


def test_an_error_of_a_helper_leaves_the_kernel():
    assert _root(4.0) == 2.0
    with pytest.raises(ValueError, match="below zero"):
        _root(-1.0)
    with pytest.raises(ValueError, match="below zero"):
        _checked(-1.0)


@pytest.mark.parametrize("four", _FOUR)
def test_a_large_kernel_is_optimised_once_and_called(four):
    rng = np.random.default_rng(1)
    found, plain = rng.normal(size=(2, 36)), rng.normal(size=(2, 36))
    plain[:] = found
    four.compile((_ARRAY, _ARRAY))
    four.overloads[_ARRAY, _ARRAY].entry_point(*found)
    for x, y in (plain, plain[::-1]):
        _product.py_func(x, y)
        _product.py_func(y, x)
    np.testing.assert_allclose(found, plain, rtol=1e-12)
    (name,) = (one.fndesc.llvm_func_name for one in _product.copied.overloads.values())
    (code,) = (one.library for one in _two_products.overloads.values())
    assert code._final_module.get_function(name).is_declaration
    assert four is not _four_rounded or "vfmadd" not in "".join(four.inspect_asm().values())


def test_a_kernel_and_an_unfused_one_of_one_function_are_kept_apart():
    """With x = 1 + 2^-27 the difference is 2^-54, which is lost where x² is rounded by itself."""

    def difference(x, square):
        return x * x - square

    x, square, numbers = 1.0 + 2.0**-27, 1.0 + 2.0**-26, (types.float64, types.float64)
    found = {kernel: set(), unfused_kernel: set()}
    for made in (kernel, unfused_kernel, unfused_kernel, kernel):  # the last from disk
        one = made(difference)
        one.compile(numbers)
        found[made].add(one.overloads[numbers].entry_point(x, square))
    assert found[unfused_kernel] == {difference(x, square)} == {0.0}
    assert len(found[kernel]) == 1


@kernel
def _add(rows: tuple[vec3.Floats, ...], by: float) -> None:
    for row in rows:
        row[:] += by


@kernel
def _add_twice(rows: tuple[vec3.Floats, ...], by: float) -> None:
    _add(rows, by)
    _add(rows, by)


@kernel
def _are_positive(rows: tuple[vec3.Floats, ...]) -> bool:
    return rows[0][0] > 0.0


@kernel
def _loop(rows):
    _add(rows, 0.25)
    _add_twice(rows, 1.0)
    return _are_positive(rows)


def test_what_is_large_and_has_a_type_that_is_known_is_compiled_behind_the_types():
    rows = tuple(np.zeros(2) for _ in range(10))
    assert _loop(rows) is True
    assert rows[9].tolist() == [2.25, 2.25]
    for helper in (_add.copied, _add_twice.copied, _are_positive.copied):
        assert len(helper.overloads) == 1
        assert all(isinstance(one, CompileResult) for one in helper.overloads.values())
