"""Connected components of graphs, against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cosim.base.components import components


@pytest.mark.parametrize("seed", range(8))
def test_components_are_those_of_scipy(seed: int) -> None:
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 60))
    edges = random.integers(0, count, (int(random.integers(0, count)), 2))
    graph = coo_array((np.ones(len(edges)), edges.T), shape=(count, count))
    _, expected = connected_components(graph, directed=False)
    found = components(count, edges)
    first = [found.tolist().index(label) for label in range(found.max() + 1)]
    assert first == sorted(first)  # numbered in the order of their first nodes
    assert len({*zip(found.tolist(), expected.tolist(), strict=True)}) == len(first) == expected.max() + 1
