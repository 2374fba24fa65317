"""Small dense algebra of the rod's kernel: rows of (3, points) against coordinates, Gram matrices and their factors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.rod_compile import inner
from sim.rod_views import flat, flat_rows

FloatArray = NDArray[np.float64]

_SMALLEST_PIVOT = 1e-300


@inner
def copy_into(source: FloatArray, target: FloatArray) -> None:
    """target ← source, shape (n,) each."""
    for k in range(source.shape[0]):
        target[k] = source[k]


@inner
def integrate_three(values: FloatArray, integral: FloatArray, out: FloatArray) -> None:
    """Integrals from the middle outwards of three components (3, n), `outward` already in the values."""
    half = integral.shape[0]
    for k in range(values.shape[0]):
        for i in range(values.shape[1]):
            out[k, i] = 0.0
        for side in range(values.shape[1] // half):
            start = side * half
            for j in range(half):
                value = values[k, start + j]
                for i in range(half):
                    out[k, start + i] += value * integral[j, i]


@inner
def integrate_rows(values: FloatArray, integral: FloatArray, out: FloatArray) -> None:
    """out ← values · integral, row after row of as many as `integral`, (half, half), has."""
    half = integral.shape[0]
    for start in range(0, values.shape[0], half):
        for i in range(half):
            out[start + i] = 0.0
        for j in range(half):
            value = values[start + j]
            for i in range(half):
                out[start + i] += value * integral[j, i]


@inner
def gram(rows: FloatArray, size: int, out: FloatArray, add: bool) -> None:
    """Lower triangle of GᵀG over the first `size` columns of G, shape (columns, rows); added to `out` where asked."""
    length = rows.shape[1]
    for a in range(size):
        b = 0
        while b + 3 <= a:  # four at once: each load of row a serves four products
            s0 = s1 = s2 = s3 = 0.0
            for k in range(length):
                x = rows[a, k]
                s0 += x * rows[b, k]
                s1 += x * rows[b + 1, k]
                s2 += x * rows[b + 2, k]
                s3 += x * rows[b + 3, k]
            if add:
                out[a, b] += s0
                out[a, b + 1] += s1
                out[a, b + 2] += s2
                out[a, b + 3] += s3
            else:
                out[a, b], out[a, b + 1], out[a, b + 2], out[a, b + 3] = s0, s1, s2, s3
            b += 4
        while b <= a:
            s0 = 0.0
            for k in range(length):
                s0 += rows[a, k] * rows[b, k]
            out[a, b] = out[a, b] + s0 if add else s0
            b += 1


@inner
def factorise(matrix: FloatArray, size: int) -> bool:
    """Cholesky in place on the lower triangle, the diagonal as its inverse. False when not positive definite."""
    for a in range(size):
        for b in range(a):
            total = matrix[a, b]
            for k in range(b):
                total -= matrix[a, k] * matrix[b, k]
            matrix[a, b] = total * matrix[b, b]
        total = matrix[a, a]
        for k in range(a):
            total -= matrix[a, k] * matrix[a, k]
        if not total > _SMALLEST_PIVOT:
            return False
        matrix[a, a] = 1.0 / np.sqrt(total)
    return True


@inner
def solve_forward(matrix: FloatArray, size: int, vector: FloatArray) -> None:
    """vector ← L⁻¹ vector."""
    for a in range(size):
        total = vector[a]
        for k in range(a):
            total -= matrix[a, k] * vector[k]
        vector[a] = total * matrix[a, a]


@inner
def solve_backward(matrix: FloatArray, size: int, vector: FloatArray) -> None:
    """vector ← L⁻ᵀ vector."""
    for a in range(size - 1, -1, -1):
        value = vector[a] * matrix[a, a]
        vector[a] = value
        for k in range(a):
            vector[k] -= value * matrix[a, k]


@inner
def combine_rows(rows: FloatArray, size: int, vector: FloatArray, product: FloatArray) -> None:
    """product ← G vector, over `size` columns; rows and product as they are shaped in Work."""
    columns, out = flat_rows(rows), flat(product)
    length = out.shape[0]
    for k in range(length):
        out[k] = 0.0
    for a in range(size):
        share, column = vector[a], columns[a]
        for k in range(length):
            out[k] += share * column[k]


@inner
def dot(column: FloatArray, other: FloatArray) -> float:
    """Sum of the products of two arrays of one shape."""
    x, y = flat(column), flat(other)
    total = 0.0
    for k in range(x.shape[0]):
        total += x[k] * y[k]
    return total


@inner
def add_scaled(first: FloatArray, share: float, second: FloatArray, total: FloatArray) -> None:
    """total ← first + share · second, of one shape."""
    x, y, out = flat(first), flat(second), flat(total)
    for k in range(x.shape[0]):
        out[k] = x[k] + share * y[k]


@inner
def gather(coordinates: FloatArray, column: FloatArray, out: FloatArray) -> None:
    """out ← the columns' part of all coordinates."""
    for d in range(column.shape[0]):
        out[d] = coordinates[int(column[d])]
