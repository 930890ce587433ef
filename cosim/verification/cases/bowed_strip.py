"""A strip of stiff panels on hinges, bowed by a cable that runs beside it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np
from scipy.optimize import brentq

from cosim.base.frames import Array
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.specimen import UNLOADED, Specimen

HINGES = 8
PULLS = (0.1, 0.3, 0.5)
"""Moment T a of the cable about a straight hinge, over the stiffness k of a hinge."""

_PANEL_M, _WIDTH_M, _OFFSET_M, _STIFFNESS_Nm = 0.04, 0.04, 0.01, 0.02
_FILM = Film(1e9, 0.3, 1e-3)


def turn(pull: float) -> float:
    """Return theta [rad] of each hinge under T a / k = pull.

    Two eyelets, each in the middle of a panel of length 2 h and at the distance a beside it, are
    d = 2 (h cos(theta / 2) - a sin(theta / 2)) apart. k theta^2 / 2 + T d is least where
        k theta = T (a cos(theta / 2) + h sin(theta / 2)):
    the moment of the hinge is that of the cable's tension with its lever.
    """
    ratio = 0.5 * _PANEL_M / _OFFSET_M

    def moment(theta: float) -> float:
        return theta - pull * (math.cos(0.5 * theta) + ratio * math.sin(0.5 * theta))

    return float(brentq(moment, 0.0, math.pi, xtol=1e-14))


def panels() -> SoftBody:
    """Return panels along x, hinged to one another; the first is to be clamped.

    Each panel is a pyramid of stiff film: four corners in the plane z = 0, and below their middle the eyelet.
    Nodes 2 s and 2 s + 1 are the line between panels s - 1 and s; the eyelets follow.
    """
    count = HINGES + 1
    lines = _PANEL_M * np.arange(count + 1)
    edge = np.zeros((2 * (count + 1), 3))
    edge[:, 0] = np.repeat(lines, 2)
    edge[1::2, 1] = _WIDTH_M
    eyelets = np.stack(
        [lines[:-1] + 0.5 * _PANEL_M, np.full(count, 0.5 * _WIDTH_M), np.full(count, -_OFFSET_M)], axis=1
    )
    a, e = 2 * np.arange(count), len(edge) + np.arange(count)
    quarters = [(a, a + 2, a + 1), (a + 1, a + 2, a + 3)]
    quarters += [(a, e, a + 2), (a + 2, e, a + 3), (a + 3, e, a + 1), (a + 1, e, a)]
    line = 2 * np.arange(1, HINGES + 1)
    return SoftBody.from_arrays(
        np.concatenate([edge, eyelets]),
        np.concatenate([np.stack(quarter, axis=1) for quarter in quarters]),
        _FILM,
        hinge_nodes=np.stack([line - 1, line, line + 1, line + 2], axis=1),
        hinge_stiffness=_STIFFNESS_Nm,
        cables=(Cable(e),),
    )


def turns(positions: Array) -> Array:
    """Return the angle (hinges,) [rad] by which each panel is turned against the one before, towards -z."""
    run = np.diff(positions[: 2 * (HINGES + 2) : 2], axis=0)
    return -np.diff(np.unwrap(np.arctan2(run[:, 2], run[:, 0])))


@final
@dataclass(frozen=True)
class BowedStrip(Case):
    """Angles of all hinges under three tensions of a cable without friction; far beyond small angles.

    Every hinge feels the same tension with the same lever, so all turn alike. What is left as error, some
    1e-3, is what the film yields: k / h^2 is 1e-4 of E t.
    """

    name: ClassVar[str] = "bowed_strip"
    title: ClassVar[str] = "Cable beside a strip of hinged panels"
    source: ClassVar[str] = "moment balance: k theta = T (a cos(theta/2) + h sin(theta/2))"

    def run(self) -> tuple[Figure, ...]:
        body = panels()
        specimen = Specimen(
            body,
            np.isin(np.arange(body.nodes), (0, 1, 2, 3)),
            NewtonOptions(1e-6, iterations_max=400, step_max_m=0.3),
        )
        here = specimen.solve(specimen.drawn(), replace(UNLOADED, cable_tension_N=(0.0,)))
        figures = []
        for pull in PULLS:
            tension = pull * _STIFFNESS_Nm / _OFFSET_M
            here = specimen.follow(here, replace(UNLOADED, cable_tension_N=(tension,)), 4)
            found, exact, note = turns(here.state.positions), turn(pull), f"T a / k = {pull:g}"
            figures += [
                Figure(f"turn of a hinge, {note}", "rad", float(found.mean()), exact, 5e-3),
                Figure(f"spread of the turns, {note}", "rad", float(np.ptp(found)), 0.0, 5e-3, absolute=True),
            ]
        return tuple(figures)
