"""Contact of a soft body with itself: unit with unit, finger with finger.

For a step, or a round of a static solution, the pairs of points and triangles are found and kept; within it
their distances and normals are exact. Modelled is the outside of the film: different units of one body. Not
modelled are the inner sides of one unit, and one unit folded onto itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array
from cosim.errors import InputError
from cosim.soft.body.body import SoftBody
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.self_contact_candidates import furthest_from_mean
from cosim.soft.contact.self_contact_faces import FilmFaces, FilmPoints
from cosim.soft.contact.self_contact_pairs import FilmPairs
from cosim.soft.contact.self_contact_search import FilmSearch
from cosim.soft.solve.state import SoftState

_STEP_REACH_M = 1e-3  # looked ahead besides what the film moves in a step
_STATIC_REACH_M = 3e-3  # the same in statics, where nothing says how far it will move
_BEHIND_M = 5e-3  # how far behind a film a point still counts as one that came through it
_FROM_EACH_SIDE = 0.5  # of the stiffness: the points of both films are counted


@final
@dataclass(frozen=True)
class FilmContactLaw:
    """How films press and rub on each other.

    Args:
        law: of pressing and sticking, as on an obstacle.
        friction: coefficient of sliding.

    Raises:
        InputError: the coefficient is negative, or not a number.
    """

    law: ContactLaw
    friction: float = 0.5

    def __post_init__(self) -> None:
        if not self.friction >= 0.0:
            raise InputError(f"contact: the friction coefficient is {self.friction}; it must not be negative")


@final
class SelfContact:
    """Finds the pairs of films that may touch.

    Args:
        body: of which films.
        law: between them.
    """

    def __init__(self, body: SoftBody, law: FilmContactLaw) -> None:
        self.law, self.friction = law.law, law.friction
        self.faces = FilmFaces.of(body)
        self.points = FilmPoints.of(self.faces, body.positions)
        self._search = FilmSearch(self.faces, self.points)

    def step_pairs(self, state: SoftState, step_s: float) -> FilmPairs | None:
        """Return what may touch in a step, None for nothing.

        Args:
            state: before the step.
            step_s: length [s].
        """
        drift = furthest_from_mean(state.velocities)
        reach = 0.5 * self.law.smoothing_m + _STEP_REACH_M + 2.0 * drift * step_s
        pairs = self._pairs(state.positions, reach, None, 0.0)
        if pairs is None or state.touching is None:
            return pairs
        normal_force, stretch = state.touching.recall(pairs.key)
        return pairs.rubbing(self.friction * normal_force, stretch)

    def static_pairs(
        self, positions: Array, held: FilmPairs | None = None, slack: float = 0.0
    ) -> FilmPairs | None:
        """Return what may touch near an equilibrium, without friction; None for nothing.

        Args:
            positions: (n, 3) [m].
            held: pairs of the round before: those that still hold keep their triangle.
            slack: how far beyond the triangle's edges a foot still holds, as barycentric weight.
        """
        return self._pairs(positions, _STATIC_REACH_M, held, slack)

    def _pairs(self, x: Array, reach: float, held: FilmPairs | None, slack: float) -> FilmPairs | None:
        if not self.faces.can_meet:
            return None
        faces, hits = self.faces, self._search.near(x, reach, _BEHIND_M)
        point, triangle = hits.point, hits.triangle
        key = point * faces.units + faces.unit[triangle]
        if held is not None:
            kept = held.holding(x, slack, reach)
            triangle = np.concatenate([held.triangle[kept], triangle])
            # of two triangles of one unit the first counts: the one that is held
            key, first = np.unique(np.concatenate([held.key[kept], key]), return_index=True)
            point, triangle = key // faces.units, triangle[first]
        if not len(key):
            return None
        nodes = np.concatenate((self.points.nodes[point], faces.triangles[triangle]), axis=1)
        stiffness = _FROM_EACH_SIDE * self.law.stiffness_N_m3 * self.points.area[point]
        return FilmPairs.slack(key, triangle, nodes, self.points.weights[point], stiffness, self.law, x)
