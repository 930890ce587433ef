"""Cost and accuracy of the contact query: points of a soft body against shapes around it.

    python benchmarks/contact_query.py [--json FILE] [--points N] [--shapes M]

N points on a ball of 40 mm radius, M shapes that all cut it (boxes, balls, capsules, cylinders, ellipsoids,
hulls of 60 vertices), and the same shapes 0.5 m away. Times are thread CPU times, the least of many.
Errors: how far the foot of the normal is from the surface, and how much nearer a surface sample is.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks.measure.calls import least_ms
from cosim.base.frames import Array
from cosim.rigid.distance.signed_distance import ContactQuery

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.rigid.shapes import SIZES, compiled, level, surface_samples, to_world

REACH_M = 0.003
BALL_M = 0.04


def scene(shapes: int, apart_m: float) -> ContactQuery:
    """Return a query on free bodies whose surfaces cut the ball, moved `apart_m` along x."""
    rng = np.random.default_rng(0)
    names = [name for name in SIZES if name not in ("plane", "round ellipsoid")]
    spec = mujoco.MjSpec()
    hull = rng.normal(size=(60, 3))
    spec.add_mesh(name="hull").uservert = (
        (hull / np.linalg.norm(hull, axis=1)[:, None] * (0.03, 0.02, 0.025)).ravel().tolist()
    )
    for k in range(shapes):
        kind, size = SIZES[names[k % len(names)]]
        way = rng.normal(size=3)
        place = 0.055 * way / np.linalg.norm(way) + np.array([apart_m, 0.0, 0.0])
        body = spec.worldbody.add_body(pos=place, quat=rng.normal(size=4))
        geom = body.add_geom(type=kind, size=size)
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            geom.meshname = "hull"
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return ContactQuery(model, data, np.arange(shapes))


def cost(points: Array, shapes: int, apart_m: float) -> dict[str, Any]:
    """Return time and hits of a whole query: poses, broad phase, distances."""
    query = scene(shapes, apart_m)
    low, high = points.min(axis=0), points.max(axis=0)

    def ask() -> int:
        query.update()
        active = query.near(low, high, REACH_M)
        return len(query.distances(points, REACH_M, active)) if len(active) else 0

    hits = ask()
    return {"hits": hits, "ms": least_ms(ask, 300)}


def accuracy(name: str, count: int = 4000) -> dict[str, float]:
    """Return the largest errors of one shape over depths from its middle to 30 mm outside."""
    rng = np.random.default_rng(4)
    points = rng.uniform(-0.05, 0.05, size=(count, 3))
    world = to_world(name, points)
    model, data = compiled()
    hits = ContactQuery(model, data, [model.geom(name).id]).distances(world, 1.0)
    body = model.body(name).id
    turn, place = data.xmat[body].reshape(3, 3), data.xpos[body]
    foot = (world - hits.distance[:, None] * hits.normal - place) @ turn
    samples = surface_samples(name, 20000)
    nearest = np.array([np.linalg.norm(samples - p, axis=1).min() for p in points[::10]])
    return {
        "deepest_m": float(hits.distance.min()),
        "foot_off_surface_m": float(np.abs(level(name, foot)).max()),
        "nearer_sample_m": float(np.maximum(np.abs(hits.distance[::10]) - nearest, 0.0).max()),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--points", type=int, default=1300)
    parser.add_argument("--shapes", type=int, default=10)
    options = parser.parse_args()
    points = np.random.default_rng(1).normal(size=(options.points, 3))
    points *= BALL_M / np.linalg.norm(points, axis=1)[:, None]
    figures: dict[str, Any] = {
        "points": options.points,
        "shapes": options.shapes,
        "near": cost(points, options.shapes, 0.0),
        "far": cost(points, options.shapes, 0.5),
        "accuracy": {name: accuracy(name) for name in SIZES},
    }
    for case in ("near", "far"):
        found = figures[case]
        print(
            f"{options.points} points, {options.shapes} shapes, {case}: "
            f"{found['ms']:.4f} ms, {found['hits']} hits"
        )
    for name, errors in figures["accuracy"].items():
        print(f"  {name:<16}" + ", ".join(f"{key} {value:.1e}" for key, value in errors.items()))
    if options.json:
        options.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
