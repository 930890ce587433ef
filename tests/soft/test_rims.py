"""Rims of a surface: ordered so that their fans close it."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.errors import MeshError
from cosim.soft.geometry.surface import directed_edges, rims
from tests.soft.own_tube import tube


def test_fans_on_the_rims_close_a_tube() -> None:
    body = tube().body
    found = rims(body.triangles)
    assert [set(rim.tolist()) for rim in found] == [set(body.base.tolist()), set(body.tip.tolist())]
    triangles = [body.triangles]
    for center, rim in enumerate(found, start=body.nodes):
        triangles.append(np.stack([np.full_like(rim, center), rim, np.roll(rim, -1)], axis=1))
    edges = directed_edges(np.concatenate(triangles)).tolist()
    assert sorted(edges) == sorted([b, a] for a, b in edges)  # every edge runs both ways, once


def test_a_closed_surface_has_none_and_rims_that_meet_are_refused() -> None:
    tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    assert rims(tetrahedron) == ()
    with pytest.raises(MeshError, match="two rims of the film meet in node 0"):
        rims(np.array([[0, 1, 2], [0, 3, 4]]))
