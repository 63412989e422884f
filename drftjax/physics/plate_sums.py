"""Sums over a wheel's plates, all in one pass.

XLA makes a pass of each sum and computes again, in each, what leads up to it. One pass for all is
two to four times as fast. No transformation of JAX's own keeps it so under a batch of derivatives,
hence a primitive: https://docs.jax.dev/en/latest/jax-primitives.html.
"""

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float

Columns = tuple[Float[Array, "*batch plates"], ...]
Sums = tuple[Float[Array, "*batch"], ...]


def sums_over_plates(columns: Columns) -> Sums:
    """Sum of each column over its last axis, all in one pass.

    Args:
        columns: Arrays of one shape, shape (..., plates).

    Returns:
        Their sums, shape (...).
    """
    return tuple(_sums.bind(*columns))


def _in_one_pass(*columns: Array) -> list[Array]:
    def add(left: list[Array], right: list[Array]) -> list[Array]:
        return [a + b for a, b in zip(left, right, strict=True)]

    nought = [jnp.zeros((), column.dtype) for column in columns]
    return jax.lax.reduce([*columns], nought, add, (columns[0].ndim - 1,))


def _shapes(*columns: ShapedArray) -> list[ShapedArray]:
    return [column.update(shape=column.shape[:-1]) for column in columns]


def _derivative(primals: Columns, tangents: tuple) -> tuple[list[Array], list[Array]]:
    full = [ad.instantiate_zeros(t) if isinstance(t, ad.Zero) else t for t in tangents]
    return _sums.bind(*primals), _sums.bind(*full)


def _transpose(changes: list, *columns) -> list:
    def spread(change, column):
        if isinstance(change, ad.Zero):
            return ad.Zero(column.aval)
        return jnp.broadcast_to(change[..., None], column.aval.shape)

    return [spread(*pair) for pair in zip(changes, columns, strict=True)]


def _batched(columns: Columns, axes: tuple) -> tuple[list[Array], list[int]]:
    size = next(c.shape[a] for c, a in zip(columns, axes, strict=True) if a is not None)
    leading = [
        jnp.broadcast_to(column, (size, *column.shape))
        if axis is None
        else jnp.moveaxis(column, axis, 0)
        for column, axis in zip(columns, axes, strict=True)
    ]
    return _sums.bind(*leading), [0] * len(columns)


_sums = Primitive("sums_over_plates")
_sums.multiple_results = True
_sums.def_impl(jax.jit(_in_one_pass))
_sums.def_abstract_eval(_shapes)
mlir.register_lowering(_sums, mlir.lower_fun(_in_one_pass, multiple_results=True))
ad.primitive_jvps[_sums] = _derivative
ad.primitive_transposes[_sums] = _transpose
batching.primitive_batchers[_sums] = _batched
