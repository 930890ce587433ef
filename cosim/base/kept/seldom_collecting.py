"""Compiling looks for garbage seldom."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

_OBJECTS_BETWEEN = 100_000  # two collections of garbage


@contextmanager
def seldom_collecting() -> Iterator[None]:
    """Look for garbage seldom: numba makes so many small objects that it would take a seventh of the time."""
    usual = gc.get_threshold()
    gc.set_threshold(_OBJECTS_BETWEEN, *usual[1:])
    try:
        yield
    finally:
        gc.set_threshold(*usual)
