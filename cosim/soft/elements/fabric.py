"""Yarns of woven film that straighten as they are stretched; law and source: see `material`."""

from __future__ import annotations

from cosim.base.kernels import Matrix, Vector, device_function


@device_function
def straighten(strain: tuple[float, float, float], yarns: Matrix, n: Vector, c: Matrix) -> float:
    """Add to n (3,) and c (3, 3) what yarns resist beyond the drawn weave; return the density [J/m^2].

    It has no compression and is convex, so that a tension field with it is one.

    Args:
        strain: E11, E22, 2 E12, along warp and weft.
        yarns: (2, 2), see `Film.yarns`.
        n: added to.
        c: added to.
    """
    density = 0.0
    for i in range(2):
        grown, full = yarns[i, 0], yarns[i, 1]
        bent = min(max(strain[i], 0.0), full)
        beyond = max(strain[i] - full, 0.0)
        n[i] += grown * (0.5 * bent * bent / full + beyond)
        c[i, i] += grown * bent / full
        density += grown * (bent * bent * bent / (6.0 * full) + 0.5 * beyond * (bent + beyond))
    return density
