"""Vectors of three values for kernels: tuples, so that loops over lanes vectorise."""

from __future__ import annotations

from cosim.base.kernels import inlined


@inlined
def dot(a, b):  # type: ignore[no-untyped-def]
    """Return a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a, b):  # type: ignore[no-untyped-def]
    """Return a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def scaled(factor, a):  # type: ignore[no-untyped-def]
    """Return factor a."""
    return factor * a[0], factor * a[1], factor * a[2]


@inlined
def added(a, b):  # type: ignore[no-untyped-def]
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]
