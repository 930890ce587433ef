"""How deep units of a film are in one another, by winding numbers: independent of the contact search."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.soft.body.body import SoftBody
from cosim.soft.contact.self_contact_faces import FilmFaces, FilmPoints


def deepest_m(body: SoftBody, positions: Array) -> float:
    """Return how far the deepest contact point inside another unit is from that unit's film [m]; 0 for none.

    Args:
        body: whose film it is.
        positions: (n, 3) [m].
    """
    faces = FilmFaces.of(body)
    points = FilmPoints.of(faces, body.positions)
    places = np.einsum("pa,par->pr", points.weights, positions[points.nodes])
    deepest = 0.0
    for unit in range(faces.units):
        triangles = faces.triangles[faces.unit == unit]
        corners = np.concatenate([positions[triangles], _lids(positions, triangles)])
        others = (points.home[:, 1] != unit) & ~np.isin(points.nodes, triangles).any(axis=1)
        others &= ((places > corners.min(axis=(0, 1))) & (places < corners.max(axis=(0, 1)))).all(axis=1)
        inside = places[others][_winding(places[others], corners) > 0.5]
        if len(inside):
            deepest = max(deepest, float(_distance(inside, positions[triangles]).max()))
    return deepest


def _lids(positions: Array, triangles: IntArray) -> Array:
    """Return triangles (k, 3, 3) [m] that close the holes of a surface."""
    edges = {(a, b) for t in triangles.tolist() for a, b in zip(t, [*t[1:], t[0]], strict=True)}
    onward = {b: a for a, b in edges if (b, a) not in edges}
    lids = []
    while onward:
        first, there = onward.popitem()
        ring = [first]
        while there != first:
            ring.append(there)
            there = onward.pop(there)
        rim = positions[ring]
        lids += [(rim.mean(axis=0), a, b) for a, b in zip(rim, np.roll(rim, -1, axis=0), strict=True)]
    return np.array(lids).reshape(-1, 3, 3)


def _winding(points: Array, corners: Array) -> Array:
    """Return how often a closed surface (k, 3, 3) winds around each point (van Oosterom and Strackee)."""
    a, b, c = (corners[None, :, k] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    sine = np.einsum("ptr,ptr->pt", a, np.cross(b, c))
    cosine = la * lb * lc
    cosine += lc * (a * b).sum(axis=2) + la * (b * c).sum(axis=2) + lb * (c * a).sum(axis=2)
    return np.asarray(np.arctan2(sine, cosine).sum(axis=1) / (2.0 * np.pi))


def _distance(points: Array, corners: Array) -> Array:
    """Return the distance [m] of each point (p, 3) from the nearest of triangles (k, 3, 3)."""
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = area / np.linalg.norm(area, axis=1)[:, None]
    height = np.einsum("ptr,tr->pt", points[:, None] - corners[None, :, 0], normal)
    over, nearest = np.ones(height.shape, dtype=bool), np.full(height.shape, np.inf)
    for k in range(3):
        a, way = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        from_a = points[:, None] - a[None]
        along = np.einsum("ptr,tr->pt", from_a, way) / (way**2).sum(axis=1)
        rest = from_a - np.clip(along, 0.0, 1.0)[:, :, None] * way
        nearest = np.minimum(nearest, np.linalg.norm(rest, axis=2))
        over &= np.einsum("ptr,tr->pt", from_a, np.cross(normal, way)) >= 0.0
    return np.asarray(np.where(over, np.abs(height), nearest).min(axis=1))
