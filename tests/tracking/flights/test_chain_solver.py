"""Laws of the recursion along a chain: steps and covariances are those of one large matrix."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from diethrow.tracking.flights.chain_solver import MAX_LINK_SIZE, chain_covariance, empty_stages, solve_chain

Array = NDArray[np.float64]

D = 13


class Chain:
    """A random chain of links, some open, some with conditions; and the same as one large problem."""

    def __init__(self, seed: int, count: int) -> None:
        rng = np.random.default_rng(seed)
        self.count = count
        rows = rng.normal(size=(count + 1, 30, D))
        self.normal = np.swapaxes(rows, 1, 2) @ rows
        self.gradient = rng.normal(size=(count + 1, D))
        self.stages = empty_stages(count, D)
        for k in range(count):
            size = 12 if k % 3 == 2 else 7
            self.stages.sizes[k] = size
            self.stages.by_state[k, 12, 12] = 1.0  # the parameter that all flights share
            self.stages.by_link[k, :12, :size] = rng.normal(size=(12, size))
            if size == 7:
                self.stages.by_state[k, :12, :12] = rng.normal(size=(12, 12)) / 3.0
                self.stages.impact_by_state[k] = rng.normal(size=(4, D))
                self.stages.impact_by_link[k, :, :7] = rng.normal(size=(4, 7))
                self.stages.violation[k] = rng.normal(size=4)

    def maps(self) -> tuple[list[Array], list[Array]]:
        """From all parameters (first state, then those of each link) to each flight's state, and to those of each link."""
        total = D + int(self.stages.sizes.sum())
        state, column = np.eye(D, total), D
        states, links = [state], []
        for k, size in enumerate(self.stages.sizes):
            own = np.zeros((MAX_LINK_SIZE, total))
            own[np.arange(size), column + np.arange(size)] = 1.0
            links.append(own)
            state = self.stages.by_state[k] @ state + self.stages.by_link[k] @ own
            states.append(state)
            column += int(size)
        return states, links

    def conditions(self) -> list[tuple[Array, Array]]:
        """Rows of each link's conditions in all parameters, and their violation."""
        states, links = self.maps()
        s = self.stages
        return [
            (s.impact_by_state[k] @ states[k] + s.impact_by_link[k] @ links[k], s.violation[k])
            for k in range(self.count)
        ]

    def matrix(self) -> tuple[Array, Array]:
        """The large normal matrix and gradient."""
        states, _ = self.maps()
        A = sum(M.T @ N @ M for M, N in zip(states, self.normal, strict=True))
        g = sum(M.T @ g for M, g in zip(states, self.gradient, strict=True))
        A = A + sum(rows.T @ rows for rows, _ in self.conditions())
        return np.asarray(A), np.asarray(g + sum(rows.T @ violation for rows, violation in self.conditions()))


@pytest.mark.parametrize("count", [0, 1, 4, 9])
def test_the_recursion_takes_the_step_of_the_large_matrix(count: int) -> None:
    chain = Chain(count, count)
    A, g = chain.matrix()
    wanted = -np.linalg.solve(A, g)
    first, changes = solve_chain(chain.normal, chain.gradient, chain.stages, 1e-14)
    found = np.concatenate([first, *(change[:size] for change, size in zip(changes, chain.stages.sizes, strict=True))])
    # `LEAST_DAMPING` is 1e-9, and the least eigenvalue of the large matrix of nine links some 1e-3.
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=2e-6 * np.abs(wanted).max())


@pytest.mark.parametrize("count", [0, 1, 4, 9])
def test_the_covariance_for_white_noise_is_the_inverse_of_the_large_matrix(count: int) -> None:
    chain = Chain(20 + count, count)
    inverse = np.linalg.inv(chain.matrix()[0])
    states, links = chain.maps()
    last, joint_covariance = chain_covariance(chain.normal, chain.normal, chain.stages)
    np.testing.assert_allclose(last, states[-1] @ inverse @ states[-1].T, atol=1e-9)
    for k in range(count):
        both = np.vstack([states[k], links[k]])
        np.testing.assert_allclose(joint_covariance[k], both @ inverse @ both.T, atol=1e-9)


@pytest.mark.parametrize("count", [1, 4, 9])
def test_the_covariance_for_other_noise_is_the_sandwich(count: int) -> None:
    chain = Chain(40 + count, count)
    A, _ = chain.matrix()
    rows = np.random.default_rng(count).normal(size=(count + 1, 8, D))
    noises = np.swapaxes(rows, 1, 2) @ rows
    states, links = chain.maps()
    B = sum(M.T @ N @ M for M, N in zip(states, noises, strict=True))
    B = B + sum(rows.T @ rows for rows, _ in chain.conditions())
    sandwich = np.linalg.inv(A) @ B @ np.linalg.inv(A)
    last, joint_covariance = chain_covariance(chain.normal, noises, chain.stages)
    np.testing.assert_allclose(last, states[-1] @ sandwich @ states[-1].T, atol=1e-9)
    for k in range(count):
        both = np.vstack([states[k], links[k]])
        np.testing.assert_allclose(joint_covariance[k], both @ sandwich @ both.T, atol=1e-9)


def test_an_undetermined_parameter_stays_where_it_is() -> None:
    chain = Chain(3, 2)
    # The last flight has no frames: its link is undetermined without conditions.
    chain.normal[-1], chain.gradient[-1] = 0.0, 0.0
    chain.stages.impact_by_state[-1], chain.stages.impact_by_link[-1], chain.stages.violation[-1] = 0.0, 0.0, 0.0
    first, changes = solve_chain(chain.normal, chain.gradient, chain.stages, 1e-12)
    np.testing.assert_array_equal(changes[-1], 0.0)
    assert np.isfinite(first).all()
    last, joint_covariance = chain_covariance(chain.normal, chain.normal, chain.stages)
    assert np.isfinite(last).all()
    assert np.isfinite(joint_covariance).all()
