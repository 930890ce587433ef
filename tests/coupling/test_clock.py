"""Time is a count of ticks."""

from __future__ import annotations

import pytest

from cosim.coupling.schemes.ledger import Clock
from cosim.errors import InputError


def test_time_does_not_gather_rounding() -> None:
    clock = Clock(0.002)
    for _ in range(100_000):
        clock = clock.advanced()
    assert clock.tick == 100_000
    assert clock.time_s == 100_000 * 0.002
    assert Clock(0.002).advanced(7) == Clock(0.002, 7)


@pytest.mark.parametrize("tick_s", [0.0, -0.002, float("nan")])
def test_a_tick_has_a_length(tick_s: float) -> None:
    with pytest.raises(InputError, match="tick_s is"):
        Clock(tick_s)
