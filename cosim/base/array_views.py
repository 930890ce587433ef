"""Device functions that hand on views of arrays."""

from __future__ import annotations

from typing import Any

from cosim.base.kernels import Function, device_function


def handing_on_views(function: Function) -> Function:
    """Mark a device function that hands on, in named tuples, views of arrays that it is given.

    It makes no arrays, and counts no references: only what counts none either can call it.
    """
    dispatcher: Any = device_function(function)
    dispatcher.hands_on_views = True
    result: Function = dispatcher
    return result
