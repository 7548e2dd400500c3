"""Round numbers on an axis."""

from __future__ import annotations

import math

from ..elements import fixed, number

STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
"""Distances of ticks, times a power of ten."""
ROUNDING = 1e-6
"""Share of a step by which a limit may miss a tick that it was meant to include."""
MAX_DECIMALS = 4
"""Smaller numbers are written with a power of ten, and so are those from LARGE on."""
LARGE = 1e6


def round_ticks(low: float, high: float, most: int) -> list[float]:
    """Multiples of one round step from `low` to `high`: as many as possible, at most `most`, which is 4 or more.

    Neighbouring steps differ by a factor of two at most, so at least two ticks result.
    """
    power = math.floor(math.log10((high - low) / most))
    for step in (mantissa * 10.0**exponent for exponent in (power, power + 1) for mantissa in STEPS):
        first, last = math.ceil(low / step - ROUNDING), math.floor(high / step + ROUNDING)
        if last - first < most:
            break
    # Divided where the step is below 1: 3 / 10 has the digits of 0.3, and 3 * 0.1 has not.
    return [k / round(1.0 / step, 9) if step < 1.0 else k * step for k in range(first, last + 1)]


def tick_texts(ticks: list[float]) -> list[str]:
    """The ticks with as many decimals as tell them apart, and a true minus sign."""
    if len(ticks) < 2:
        return [number(tick) for tick in ticks]
    step, largest = ticks[1] - ticks[0], max(abs(tick) for tick in ticks)
    for decimals in range(MAX_DECIMALS + 1):
        if largest < LARGE and abs(round(step, decimals) - step) < ROUNDING * step:
            return [fixed(tick + 0.0, decimals) for tick in ticks]
    # Two more than the decades between them: a step of 2.5 has a digit more than one of 2.
    digits = 2 + math.ceil(math.log10(largest / step))
    return [number(tick, digits) for tick in ticks]
