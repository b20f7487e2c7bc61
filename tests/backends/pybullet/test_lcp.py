"""The solvers of complementarity problems."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.optimize import lsq_linear

from backends.pybullet.lcp import (
    factor,
    solve_boxed,
    solve_complementarity,
    solve_transposed,
    solve_with_equalities,
)


def test_a_factor_against_numpys() -> None:
    """The rows below the matrix are solved along; of the matrix only the upper triangle is read."""
    random = np.random.default_rng(0)
    for size, rows in ((1, 0), (1, 2), (4, 1), (7, 3)):
        root, below = random.normal(size=(size, size)), random.normal(size=(rows, size))
        matrix = root @ root.T + 0.1 * np.eye(size)
        whole = np.concatenate([np.triu(matrix) + np.tril(np.full_like(matrix, 9.0), -1), below])
        inverse, expected = factor(whole), np.linalg.cholesky(matrix)
        np.testing.assert_allclose(np.triu(whole[:size]), expected.T, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(inverse, 1 / np.diagonal(expected), rtol=1e-10)
        np.testing.assert_allclose(
            whole[size:], np.linalg.solve(expected, below.T).T, rtol=1e-9, atol=1e-10
        )
        vector = random.normal(size=size)
        solved = vector.copy()
        solve_transposed(whole, inverse, solved)
        np.testing.assert_allclose(solved, np.linalg.solve(expected.T, vector), rtol=1e-9)


def test_forces_of_linkages_and_cables_satisfy_their_conditions() -> None:
    """Neither pulls by less than zero, each lets go what is not at its end, and linkages hold."""
    random, pulling = np.random.default_rng(2), 0
    for _ in range(100):
        white, held = random.normal(size=(4, 9)), random.normal(size=(3, 9))
        matrix = white @ white.T + np.diag(random.uniform(0, 1, 4))
        vector, offset = random.normal(size=4), random.normal(size=3)
        x = np.maximum(random.normal(size=4), 0)
        y = solve_with_equalities(matrix, white, held, vector, offset, x)
        left = matrix @ x + white @ held.T @ y + vector
        assert (x >= 0).all()
        assert (left >= -1e-9).all()
        np.testing.assert_allclose(x * left, 0, atol=1e-9)
        np.testing.assert_allclose(held @ white.T @ x + held @ held.T @ y + offset, 0, atol=1e-9)
        pulling += (x > 0).sum()
    assert 100 < pulling < 300


def test_complementarity_against_trying_every_basis() -> None:
    random = np.random.default_rng(1)
    for trial in range(200):
        order = 5
        factor = random.normal(size=(order, order))
        matrix, vector = factor @ factor.T + 0.01 * np.eye(order), random.normal(size=order)
        vector[trial % order] *= trial % 3  # some are degenerate
        solutions = []
        for members in itertools.product([False, True], repeat=order):
            basis, x = np.array(members), np.zeros(order)
            x[basis] = np.linalg.solve(matrix[np.ix_(basis, basis)], -vector[basis])
            if (x >= 0).all() and (matrix @ x + vector >= -1e-12).all():
                solutions.append(x)
        for guess in (np.zeros(order), np.ones(order), random.uniform(-1, 1, order)):
            found = guess.copy()
            solve_complementarity(matrix, vector, found)
            np.testing.assert_allclose(found, solutions[0], rtol=1e-8, atol=1e-9)


def test_least_squares_within_bounds_against_scipy() -> None:
    """With A = L' L and b = -L' y it is the bounded least-squares problem |L x - y|; bounds may be
    infinite or equal, and the matrix nearly singular."""
    random = np.random.default_rng(2)
    for trial in range(60):
        order = int(random.integers(1, 40))
        root = np.vstack([random.normal(size=(order // 2, order)), 0.03 * np.eye(order)])
        aim = random.normal(size=len(root))
        upper = random.exponential(size=order)
        lower = np.where(random.random(order) < 0.3, -np.inf, -upper)
        upper[random.random(order) < 0.2] = np.inf
        found = random.normal(size=order)
        solve_boxed(root.T @ root, -root.T @ aim, lower, upper, found)
        exact = lsq_linear(root, aim, (lower, upper), tol=1e-14, method="bvls", max_iter=1000)
        assert exact.success
        np.testing.assert_allclose(found, exact.x, atol=1e-6)
        if trial == 0:
            bound = np.full(order, 0.5)
            solve_boxed(root.T @ root, -root.T @ aim, bound, bound, found)
            np.testing.assert_array_equal(found, bound)
