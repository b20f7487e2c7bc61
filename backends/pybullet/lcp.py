"""Solve the linear complementarity problem of the cables, compiled.

The matrices are small, so that a call of LAPACK takes longer than these loops.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cdcsr.compiled import compiled

Array = NDArray[np.float64]

_FAST = {"reassoc", "contract"}
"""Sums may be reordered, so that they use vector instructions; NaN and infinity keep their
meaning."""

_BLOCK_TRIALS = 3
_MAX_PIVOTS = 1000
_ROUND_OFF = 1e-13
_MAX_NEWTON, _MOST_HALVINGS = 100, 30
_FLAT = 1e-10
"""The slope at which a minimum is found, as a part of the largest of the vector."""
_DESCENT = 1e-4


@compiled(_FAST)
def factor(whole: Array) -> Array:
    """Replace a symmetric matrix by U with U' U equal to it, and each row b below it by U'^-1 b.

    Two rows of U are taken off all others at a time, which halves how often these are read and
    written; where both would take off nothing, the row is left alone.

    Args:
        whole: the matrix, of which only the upper triangle is read and replaced, and rows of its
            length below.

    Returns:
        One over the diagonal of U.
    """
    size, inverse = whole.shape[1], np.empty(whole.shape[1])
    for k in range(0, size, 2):
        above = whole[k]
        inverse[k] = _scale(above, k)
        if k + 1 == size:
            for row in range(size, len(whole)):
                whole[row, k] *= inverse[k]
            break
        below, along = whole[k + 1], above[k + 1]
        for i in range(k + 1, size):
            below[i] -= along * above[i]
        inverse[k + 1] = _scale(below, k + 1)
        for row in range(k + 2, len(whole)):
            target, start = whole[row], row
            first, second = above[min(row, size - 1)], below[min(row, size - 1)]
            if row >= size:
                first = target[k] * inverse[k]
                second = (target[k + 1] - first * along) * inverse[k + 1]
                target[k], target[k + 1], start = first, second, k + 2
            if first != 0.0 or second != 0.0:
                for i in range(start, size):
                    target[i] -= first * above[i] + second * below[i]
    return inverse


@compiled(_FAST)
def _scale(row: Array, start: int) -> float:
    """Divide a row from `start` on by the root of its first number, and return one over it."""
    inverse = 1.0 / np.sqrt(row[start])
    for i in range(start, row.size):
        row[i] *= inverse
    return inverse


@compiled(_FAST)
def solve_transposed(whole: Array, inverse: Array, vector: Array) -> None:
    """Replace a vector b by U^-1 b; the other arguments are as :func:`factor` leaves them."""
    for k in range(inverse.size - 1, -1, -1):
        value = vector[k]
        for i in range(k + 1, inverse.size):
            value -= whole[k, i] * vector[i]
        vector[k] = value * inverse[k]


@compiled()
def _solve_members(matrix: Array, vector: Array, members: NDArray[np.int64]) -> Array:
    """Return x with A x = -b in the rows and columns `members`, shape (members,)."""
    block = np.empty((members.size + 1, members.size))
    for row in range(members.size):
        block[-1, row] = -vector[members[row]]
        for k in range(row, members.size):
            block[row, k] = matrix[members[row], members[k]]
    inverse, solved = factor(block), block[-1]
    solve_transposed(block, inverse, solved)
    return solved


@compiled()
def solve_complementarity(matrix: Array, vector: Array, solution: Array) -> None:
    """Solve 0 <= x complementary to A x + b >= 0, which has one solution as A is positive definite.

    Block principal pivoting (Judice and Pires, 1994) exchanges all infeasible variables at once.
    After a few rounds in which their number does not fall, it exchanges only the last (Murty),
    which ends.

    Args:
        matrix: A, shape (count, count).
        vector: b, shape (count,).
        solution: x, shape (at least count,); its positive entries are the first guess of the basis.
    """
    count = vector.size
    basis = solution[:count] > 0.0
    scale = np.abs(vector).max() if count else 0.0
    least, trials = count + 1, _BLOCK_TRIALS
    for _ in range(_MAX_PIVOTS):
        members = np.flatnonzero(basis)
        solved = _solve_members(matrix, vector, members)
        solution[:count] = 0.0
        for row in range(members.size):
            solution[members[row]] = solved[row]

        infeasible, last = 0, -1
        wrong = np.zeros(count, np.bool_)
        for i in range(count):
            if basis[i]:
                wrong[i] = solution[i] * matrix[i, i] < -_ROUND_OFF * scale
            else:
                value = vector[i]
                for row in range(members.size):
                    value += matrix[i, members[row]] * solved[row]
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


@compiled()
def solve_with_equalities(
    matrix: Array, white: Array, held: Array, vector: Array, offset: Array, solution: Array
) -> Array:
    """Solve 0 <= x complementary to A x + W H' y + b >= 0 with H W' x + H H' y + c = 0.

    With H H' = U' U the second equation gives y. The first becomes one in x alone, in which
    Z = W H' U^-1 takes Z Z' from the matrix and Z U'^-1 c from b.

    Args:
        matrix: A, shape (count, count).
        white: W, shape (count, nv).
        held: H, shape (n, nv), of independent rows.
        vector: b, shape (count,).
        offset: c, shape (n,).
        solution: x, as for :func:`solve_complementarity`.

    Returns:
        y, shape (n,).
    """
    size, count = held.shape[0], vector.size
    whole = np.empty((size + count + 1, size))
    whole[:size], whole[size : size + count], whole[-1] = held @ held.T, white @ held.T, offset
    inverse = factor(whole)
    across, rest = whole[size : size + count], whole[-1]
    solve_complementarity(matrix - across @ across.T, vector - across @ rest, solution)
    rest += solution[:count] @ across
    solve_transposed(whole, inverse, rest)
    return -rest


@compiled()
def solve_boxed(matrix: Array, vector: Array, lower: Array, upper: Array, solution: Array) -> None:
    """Find where x' A x / 2 + b' x is least within bounds: there A x + b is zero for every x inside
    its bounds, not negative at the lower and not positive at the upper one.

    Bertsekas' projected Newton method (SIAM J. Control and Optimization 20, 1982): Newton steps for
    the variables that no bound stops, cut at the bounds, and shortened until the sum falls. It
    cannot cycle, as exchanges of many variables at once can, and takes about ten steps.

    Args:
        matrix: A, shape (count, count), positive definite.
        vector: b, shape (count,).
        lower, upper: shape (count,); they may be infinite, and equal.
        solution: x, shape (count,), replaced; the old ones are a first guess.
    """
    count = vector.size
    solution[:] = np.minimum(np.maximum(solution, lower), upper)
    scale = np.abs(vector).max() if count else 0.0
    slope, change, bends = matrix @ solution + vector, np.zeros(count), np.zeros(count)
    for _ in range(_MAX_NEWTON):
        stopped = ((solution <= lower) & (slope > 0)) | ((solution >= upper) & (slope < 0))
        free = np.flatnonzero(~stopped)
        if np.abs(np.where(stopped, 0.0, slope)).max() <= _FLAT * scale:
            break
        move = _solve_members(matrix, slope, free)
        length = 1.0
        for _ in range(_MOST_HALVINGS):
            change = np.zeros(count)
            for row in range(free.size):
                i = free[row]
                aim = solution[i] + length * move[row]
                change[i] = min(max(aim, lower[i]), upper[i]) - solution[i]
            bends = matrix @ change
            if slope @ change + 0.5 * change @ bends <= _DESCENT * (slope @ change):
                break
            length /= 2
        solution += change
        slope = slope + bends
