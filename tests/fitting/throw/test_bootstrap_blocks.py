"""Blocks of the bootstrap: neighbours stay neighbours, and no block spans two flights."""

import numpy as np
import pytest

from diethrow.fitting.throw.bootstrap import block_rows


@pytest.mark.parametrize("sizes", [[40], [30, 12, 55], [1, 1, 60], [2, 3, 2, 3, 2]])
@pytest.mark.parametrize("length", [1, 4, 25, 200])
def test_every_block_is_a_run_of_one_flight_laid_on_one_flight(sizes, length):
    flight = np.repeat(np.arange(len(sizes)) + 3, sizes)
    rng = np.random.default_rng(sum(sizes) + length)
    for _ in range(50):
        rows = block_rows(flight, length, rng)
        assert rows.min() >= 0
        assert rows.max() < len(flight)
        for begin, size in zip(np.cumsum([0, *sizes[:-1]]), sizes, strict=True):
            block = min(length, size)
            for first in range(begin, begin + size, block):
                taken = rows[first : min(first + block, begin + size)]
                np.testing.assert_array_equal(np.diff(taken), 1)
                assert len(np.unique(flight[taken])) == 1


def test_every_frame_of_a_long_flight_is_drawn_as_often_but_for_its_ends():
    """A frame at distance d < length from an end lies in d + 1 of them, the others in as many as a block is long."""
    flight, length = np.zeros(50, np.int64), 5
    rng = np.random.default_rng(6)
    counts = np.bincount(np.concatenate([block_rows(flight, length, rng) for _ in range(4000)]), minlength=50)
    inner = counts[length:-length] / counts[length:-length].mean()
    # 4300 of each: one standard deviation is 1.5 %.
    np.testing.assert_allclose(inner, 1.0, atol=0.08)
    np.testing.assert_allclose(
        counts[:length] / counts[length:-length].mean(), np.arange(1, length + 1) / length, atol=0.08
    )


def test_blocks_keep_the_correlation_of_errors_within_flights():
    """Of AR(1) errors with ρ = 0.8 in three flights, redrawn errors keep ρ but for one pair in a block."""
    rng, rho, length = np.random.default_rng(9), 0.8, 20
    flight = np.repeat([0, 1, 2], 400)
    errors = np.empty(len(flight))
    for k in range(len(flight)):
        first = k == 0 or flight[k] != flight[k - 1]
        errors[k] = rng.normal() if first else rho * errors[k - 1] + np.sqrt(1 - rho**2) * rng.normal()
    inside = np.flatnonzero(np.diff(flight) == 0)
    own = np.corrcoef(errors[inside], errors[inside + 1])[0, 1]
    drawn = [errors[block_rows(flight, length, rng)] for _ in range(200)]
    again = np.mean([np.corrcoef(some[inside], some[inside + 1])[0, 1] for some in drawn])
    assert again == pytest.approx(own * (1.0 - 1.0 / length), abs=0.02)
