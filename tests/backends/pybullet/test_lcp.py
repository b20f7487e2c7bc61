"""The solver of linear complementarity problems."""

from __future__ import annotations

import itertools

import numpy as np

from backends.pybullet.lcp import solve_complementarity


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
