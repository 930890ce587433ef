"""BDF2, the formula of steps that look back over two: v = (x - a) / s, with a and s of what came before.

    a = (4 x_n - x_n-1) / 3,   s = 2 h / 3;   of implicit Euler, which looks back over one: a = x_n, s = h.

Source: Hairer and Wanner, Solving ODEs II, chapter III.1.
"""

from typing import TypeVar

import numpy as np

from cosim.base.kernels import device_function

Amount = TypeVar("Amount", float, np.ndarray)


def two_step_base(now: Amount, before: Amount) -> Amount:
    """Return a: what a step that looks back over two counts from, by values one step apart."""
    return (4.0 * now - before) / 3.0


def step_span(step_s: float, two_steps: bool) -> float:
    """Return s [s] of a step of h [s]."""
    return 2.0 * step_s / 3.0 if two_steps else step_s


base_of_two = device_function(two_step_base)
"""The same within leaves."""
span_of_step = device_function(step_span)
"""The same within leaves."""
