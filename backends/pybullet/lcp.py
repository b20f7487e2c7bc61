"""Linear complementarity with a positive definite matrix, and the triangular solves around it;
compiled."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_FAST = {"reassoc", "contract"}
"""Sums may be reordered, so that they use vector instructions; NaN and infinity keep their
meaning."""

_BLOCK_TRIALS = 3
_MAX_PIVOTS = 1000
_ROUND_OFF = 1e-13


@numba.njit(cache=True, fastmath=_FAST)
def append_row(whole: Array, row: int, size: int, inverse: Array) -> None:
    """Solve L y = b in place, with b and then y in a row below the factor.

    Args:
        whole: the lower factor L in its first `size` rows, shape (rows, size).
        row: which row to solve for.
        size: order of L.
        inverse: one over the diagonal of L, shape (size,).
    """
    target = whole[row]
    for k in range(size):
        pivot = whole[k]
        value = target[k]
        for i in range(k):
            value -= target[i] * pivot[i]
        target[k] = value * inverse[k]


@numba.njit(cache=True, fastmath=_FAST)
def factor(whole: Array, size: int) -> Array:
    """Cholesky factor of the symmetric matrix in the lower triangle of the first `size` rows, in
    place.

    Returns:
        One over the diagonal of the factor, shape (size,).
    """
    inverse = np.empty(size)
    for row in range(size):
        target = whole[row]
        for k in range(row):
            pivot = whole[k]
            value = target[k]
            for i in range(k):
                value -= target[i] * pivot[i]
            target[k] = value * inverse[k]
        value = target[row]
        for i in range(row):
            value -= target[i] * target[i]
        target[row] = np.sqrt(value)
        inverse[row] = 1.0 / target[row]
    return inverse


@numba.njit(cache=True, fastmath=_FAST)
def solve_transposed(whole: Array, size: int, inverse: Array, vector: Array) -> None:
    """Solve L^T x = b in place; `vector` is b, then x, shape (size,)."""
    for k in range(size - 1, -1, -1):
        vector[k] *= inverse[k]
        for i in range(k):
            vector[i] -= vector[k] * whole[k, i]


@numba.njit(cache=True)
def solve_complementarity(matrix: Array, vector: Array, count: int, solution: Array) -> None:
    """Solve 0 <= x complementary to A x + b >= 0, which has one solution as A is positive definite.

    Block principal pivoting (Judice and Pires) exchanges all infeasible variables at once. After a
    few rounds in which their number does not fall, it exchanges only the last (Murty), which ends.

    Args:
        matrix: A in the first `count` rows and columns.
        vector: b in the first `count` places.
        count: order of the problem.
        solution: x, shape (at least count,); its positive entries are the first guess of the basis.
    """
    basis = solution[:count] > 0.0
    members = np.empty(count, np.int64)
    scale = 0.0
    for i in range(count):
        scale = max(scale, abs(vector[i]))
    least, trials = count + 1, _BLOCK_TRIALS
    for _ in range(_MAX_PIVOTS):
        order = 0
        for i in range(count):
            if basis[i]:
                members[order] = i
                order += 1
        block = np.empty((order + 1, order))
        for row in range(order):
            for k in range(row + 1):
                block[row, k] = matrix[members[row], members[k]]
            block[order, row] = -vector[members[row]]
        inverse = factor(block, order)
        append_row(block, order, order, inverse)
        solve_transposed(block, order, inverse, block[order])
        solution[:count] = 0.0
        for row in range(order):
            solution[members[row]] = block[order, row]

        infeasible, last = 0, -1
        wrong = np.zeros(count, np.bool_)
        for i in range(count):
            if basis[i]:
                wrong[i] = solution[i] * matrix[i, i] < -_ROUND_OFF * scale
            else:
                value = vector[i]
                for k in range(order):
                    value += matrix[i, members[k]] * block[order, k]
                wrong[i] = value < -_ROUND_OFF * scale
            if wrong[i]:
                infeasible += 1
                last = i
        if infeasible == 0:
            break
        if infeasible < least:
            least, trials = infeasible, _BLOCK_TRIALS
        else:
            trials -= 1
        for i in range(count):
            if wrong[i] and (trials >= 0 or i == last):
                basis[i] = not basis[i]
    for i in range(count):
        solution[i] = max(solution[i], 0.0)
