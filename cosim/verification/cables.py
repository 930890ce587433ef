"""Known answers: cables, hanging, around a post, and beside a strip that they bow.

A hanging chain: a strip without bending stiffness between two supports.

A cable with friction around a round post.

A strip of stiff panels on hinges, bowed by a cable that runs beside it.
"""

import math
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq

from cosim.base.frames import Array
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.material import Film
from cosim.soft.solve import assembly, newton_options
from cosim.verification.case import UNLOADED, Figure, Specimen, case
from cosim.verification.strips import Strip

SPANS = (1.0 / 1.05, 1.0 / 1.2, 0.5)
COARSE, FINE = 16, 32
_GRAVITY = 9.81


def exact(span: float) -> tuple[float, float]:
    """Return (sag / s, H / (w s)) for a chain of length 1 over a span s.

    sinh u / u = 1 / s, a = s / (2 u):  sag = a (cosh u - 1), H = w a.
    """
    u = float(brentq(lambda v: math.sinh(v) / v - 1.0 / span, 1e-6, 20.0, xtol=1e-14))
    return (math.cosh(u) - 1.0) / (2.0 * u), 1.0 / (2.0 * u)


def hanging(panels: int, span: float) -> tuple[float, float]:
    """Return (sag / s, H / (w s)) of a strip of length 1 m; H is the support's reaction."""
    strip = Strip(panels, film=Film(1e9, 0.0, 1e-3), density=1.0, hinged=False)
    clamped = strip.clamped()
    clamped[strip.tip] = True
    weight = strip.density * strip.width_m * _GRAVITY  # per length
    specimen = Specimen(
        strip.body(), clamped, newton_options.NewtonOptions(1e-7 * weight, iterations_max=400, step_max_m=0.2)
    )
    start = strip.body().positions
    fraction = np.maximum(start[:, 0], 0.0)
    start[:, 2] = -4.0 * math.sqrt(0.375 * span * (1.0 - span)) * fraction * (1.0 - fraction)
    start[:, 0] = np.where(start[:, 0] > 0.0, span * start[:, 0], start[:, 0])
    found = specimen.solve(specimen.drawn(start), replace(UNLOADED, gravity=(0.0, 0.0, -_GRAVITY)))
    pull = float(specimen.gradient(found)[strip.tip, 0].sum())
    return -float(found.state.positions[:, 2].min()) / span, pull / (weight * span)


@case("catenary", "Hanging chain: sag and horizontal pull", "Leibniz, Huygens, Johann Bernoulli 1691")
def catenary() -> tuple[Figure, ...]:
    """Sag and horizontal pull of a chain for three lengths.

    Cables of the model have a given tension and no weight, so the chain is a strip of film without hinges,
    stiff enough to keep its length within 1e-6.
    """
    figures = []
    for span in SPANS:
        reference, coarse, fine = exact(span), hanging(COARSE, span), hanging(FINE, span)
        names = {f"{name}, l / s = {1.0 / span:g}": "1" for name in ("sag / s", "H / (w s)")}
        figures += Figure.all_refined(names, coarse, fine, reference)
    return tuple(figures)


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


@case("capstan", "Cable with friction around a post", "Euler 1769, Eytelwein 1808: T_1 / T_2 = exp(mu phi)")
def capstan() -> tuple[Figure, ...]:
    """Forces on the eyelets of a cable laid half a turn around a post.

    The eyelets circumscribe the post, so the cable turns by exactly pi. The last eyelet feels T_2, all
    eyelets of the post together T_1 + T_2 downwards, and their moment about its axis is (T_1 - T_2) R.
    """
    path = wrapped(EYELETS)
    cable = Cable(np.arange(len(path)), friction_coefficient=FRICTION)
    film = Film(1e6, 0.3, 1e-3)
    body = SoftBody.from_arrays(path, np.array([[0, 1, 2]]), film, cables=(cable,))
    system = assembly.SoftSystem(body)
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


@case(
    "bowed_strip",
    "Cable beside a strip of hinged panels",
    "moment balance: k theta = T (a cos(theta/2) + h sin(theta/2))",
)
def bowed_strip() -> tuple[Figure, ...]:
    """Angles of all hinges under three tensions of a cable without friction; far beyond small angles.

    Every hinge feels the same tension with the same lever, so all turn alike. What is left as error, some
    1e-3, is what the film yields: k / h^2 is 1e-4 of E t.
    """
    body = panels()
    specimen = Specimen(
        body,
        np.isin(np.arange(body.nodes), (0, 1, 2, 3)),
        newton_options.NewtonOptions(1e-6, iterations_max=400, step_max_m=0.3),
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
