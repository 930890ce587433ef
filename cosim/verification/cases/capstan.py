"""A cable with friction around a round post."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np

from cosim.base.frames import Array
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.material import Film
from cosim.soft.solve.assembly import SoftSystem
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.specimen import UNLOADED

FRICTION = 0.2
EYELETS = 24
TENSION_N = 10.0
_RADIUS_M = 0.05


def wrapped(eyelets: int) -> Array:
    """Return the path (n, 3) [m]: a straight lead, half a turn around the post, a straight end."""
    angle = math.pi * (np.arange(eyelets) + 0.5) / eyelets
    arc = _RADIUS_M / math.cos(0.5 * math.pi / eyelets) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ends = np.array([[_RADIUS_M, -0.1], [-_RADIUS_M, -0.1]])
    path = np.concatenate([ends[:1], arc, ends[1:]])
    return np.stack([path[:, 0], path[:, 1], np.zeros(len(path))], axis=1)


@final
@dataclass(frozen=True)
class Capstan(Case):
    """Forces on the eyelets of a cable laid half a turn around a post.

    The eyelets circumscribe the post, so the cable turns by exactly pi. The last eyelet feels T_2, all
    eyelets of the post together T_1 + T_2 downwards, and their moment about its axis is (T_1 - T_2) R.
    """

    name: ClassVar[str] = "capstan"
    title: ClassVar[str] = "Cable with friction around a post"
    source: ClassVar[str] = "Euler 1769, Eytelwein 1808: T_1 / T_2 = exp(mu phi)"

    def run(self) -> tuple[Figure, ...]:
        path = wrapped(EYELETS)
        cable = Cable(np.arange(len(path)), friction_coefficient=FRICTION)
        film = Film(1e6, 0.3, 1e-3)
        body = SoftBody.from_arrays(path, np.array([[0, 1, 2]]), film, cables=(cable,))
        system = SoftSystem(body)
        loads = replace(UNLOADED, cable_tension_N=(TENSION_N,))
        system.evaluate(path, loads, system.segment_share(path, loads), system.memory, hessian=False)
        force = -system.gradient
        end = float(np.linalg.norm(force[-1]))
        post = force[1:-1]
        moment = float(np.cross(path[1:-1], post)[:, 2].sum())
        exact = TENSION_N * math.exp(-FRICTION * math.pi)
        return (
            Figure("T_1 / T_2 over half a turn", "1", TENSION_N / end, math.exp(FRICTION * math.pi), 1e-9),
            Figure("force on the post", "N", -float(post[:, 1].sum()), TENSION_N + exact, 1e-9),
            Figure("moment on the post", "N m", abs(moment), (TENSION_N - exact) * _RADIUS_M, 1e-9),
        )
