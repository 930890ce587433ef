"""Silicone membranes that lift a mass, beside measured ones: pressure over the height of the contact disc.

    python benchmarks/silicone_discs.py [--designs FILE] [--sectors 36] [--picture FILE] [--json FILE]
    python benchmarks/silicone_discs.py --robot robots/silicone_disc.obj

A membrane of Ecoflex 00-30, clamped at a radius of 70 mm, lifts a dead load through a stiff disc in its
middle. Some have stiff rings in the silicone. FILE has a design and a measured point in each row, as
docs/silicone_discs.csv; rows with only a design and its load are predicted at heights of 10 to 60 mm. Fits
use the measured file alone.

Three models; all that is not named as fitted is predicted:
    rubber      neo-Hookean; its modulus is fitted to the membrane without rings under the smallest load.
                Rings bend freely and have the 3 MPa of the authors' simulation.
    stiffening  the same, with the stiffening of published Ecoflex 00-30: Yeoh's constants C_1 = 8.4 kPa and
                C_2 = 0.1 kPa, c = C_2 / C_1 (repository BJCaasenbrood/SorotokiCode, Ecoflex0030.m).
    other rings the same, with the rings' modulus fitted to the smallest load of each membrane with rings.
A ring reaches from its radius less its width to its radius plus its width, as the authors' simulation has it:
so all designs keep gaps of 3 mm. The disc is a rigid plate and stays level. At each height the pressure is
sought at which it carries the load.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from scipy.optimize import brentq

from cosim.base.frames import Array, IntArray, Mask
from cosim.bench.known_answers import UNLOADED, Specimen
from cosim.errors import ConvergenceError
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.material import Film
from cosim.soft.geometry.surface import interior_hinges
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Equilibrium

MEASURED: Final = Path(__file__).resolve().parents[1] / "docs" / "silicone_discs.csv"
RIM_m, CLAMPED_m = 0.07, 0.074
"""Radius at which the membrane is clamped, and to which a robot's mesh goes on under the clamp."""
STIFFENING: Final = 0.1 / 8.4
HEIGHTS_m: Final = np.arange(0.010, 0.0601, 0.005)
"""Over which errors are counted."""
ROW_m: Final = 0.004
"""Largest distance of two rows of nodes."""
EASY_N, LOADS, HALVES = 12.0, 6, 2
"""A load that all designs carry at the first height, from which the load rises in so many steps; steps
between two heights."""
RING_Pa: Final = 3e6
"""Modulus of the rings in the authors' simulation."""
HINGE_Nm: Final = 1e-3
"""Stiffness of the hinges in a ring [N m/rad], which hardly matters."""
DESIGN: Final = (
    "thickness_mm", "contact_radius_mm",
    "ring1_radius_mm", "ring1_width_mm", "ring2_radius_mm", "ring2_width_mm",
)  # fmt: skip


@dataclass(frozen=True)
class Design:
    """A membrane.

    Args:
        thickness_m: of the silicone.
        contact_radius_m: of the disc.
        rings_m: inner and outer radius of each ring.
    """

    thickness_m: float
    contact_radius_m: float
    rings_m: tuple[tuple[float, float], ...] = ()

    @classmethod
    def of(cls, row: Mapping[str, str]) -> Design:
        """Return the design of a row of the file."""
        thickness, contact, *rings = (1e-3 * float(row[name]) for name in DESIGN)
        pairs = [(a - b, a + b) for a, b in zip(rings[::2], rings[1::2], strict=True)]
        return cls(thickness, contact, tuple(pair for pair in pairs if not math.isnan(pair[0])))

    @cached_property
    def radii(self) -> Array:
        """Radii of the rows of nodes outside the disc, from its edge to the clamp [m]."""
        edges = sorted(
            {self.contact_radius_m, RIM_m, *(min(r, RIM_m) for ring in self.rings_m for r in ring)}
        )
        rows = [np.linspace(a, b, 1 + max(2, math.ceil((b - a) / ROW_m))) for a, b in pairwise(edges)]
        return np.unique(np.concatenate(rows).round(9))

    def __str__(self) -> str:
        rings = ", ".join(f"{1e3 * a:.1f} to {1e3 * b:.1f}" for a, b in self.rings_m)
        return (
            f"{1e3 * self.thickness_m:g} mm, disc {1e3 * self.contact_radius_m:g} mm, rings {rings or 'none'}"
        )


@dataclass(frozen=True)
class Rubber:
    """What membranes are made of.

    Args:
        young_modulus_Pa: of the silicone.
        stiffening: of the silicone, see `Film`.
        ring_Pa: modulus of the rings.
    """

    young_modulus_Pa: float
    stiffening: float = 0.0
    ring_Pa: float = RING_Pa


@dataclass(frozen=True)
class Membrane:
    """The mesh of a design: the disc is a fan about node 0, then come rows of nodes about the axis z.

    Args:
        design: of it.
        sectors: nodes of a row.
    """

    design: Design
    sectors: int

    @cached_property
    def positions(self) -> Array:
        """(n, 3) [m], flat."""
        turn = 2.0 * np.pi * np.arange(self.sectors) / self.sectors
        around = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
        return np.concatenate([np.zeros((1, 3)), *(r * around for r in self.design.radii)])

    @cached_property
    def triangles(self) -> IntArray:
        """(m, 3), seen from above counter-clockwise."""
        count, k = self.sectors, np.arange(self.sectors)
        following = (k + 1) % count
        found = [np.stack([0 * k, 1 + k, 1 + following], axis=1)]
        for row in range(len(self.design.radii) - 1):
            a, b = 1 + row * count + k, 1 + row * count + following
            c, d = a + count, b + count
            other = (k + row) % 2 == 1  # diagonals lean both ways, so that none is preferred
            first = np.where(other[:, None], np.stack([a, c, d], axis=1), np.stack([a, c, b], axis=1))
            second = np.where(other[:, None], np.stack([a, d, b], axis=1), np.stack([b, c, d], axis=1))
            found += [first, second]
        return np.concatenate(found)

    @cached_property
    def in_ring(self) -> Mask:
        """(m,) bool, whether a triangle is of a ring."""
        radius = np.hypot(*self.positions[self.triangles].mean(axis=1)[:, :2].T)
        return np.any([(a < radius) & (radius < b) for a, b in self.design.rings_m] or [radius < 0.0], axis=0)

    @property
    def disc(self) -> IntArray:
        """Nodes of the contact disc."""
        return np.arange(1 + self.sectors)

    @property
    def rim(self) -> IntArray:
        """Nodes that are clamped."""
        return len(self.positions) - self.sectors + np.arange(self.sectors)

    def body(self, rubber: Rubber) -> SoftBody:
        """Return the membrane as a soft body."""
        modulus, thickness = rubber.young_modulus_Pa, self.design.thickness_m
        silicone = Film(modulus, 0.5, thickness, "neo_hookean", stiffening=rubber.stiffening)
        ring = Film(rubber.ring_Pa, 0.3, thickness)
        groups = {"silicone": np.flatnonzero(~self.in_ring), "ring": np.flatnonzero(self.in_ring)}
        films = {"silicone": silicone} | ({"ring": ring} if self.in_ring.any() else {})
        nodes = interior_hinges(self.triangles[self.in_ring]) if self.in_ring.any() else None
        return SoftBody.from_arrays(
            self.positions, self.triangles, films, face_groups={name: groups[name] for name in films},
            hinge_nodes=nodes, hinge_stiffness=HINGE_Nm, tip=self.disc[1:],
        )  # fmt: skip


class Lifting:
    """Pressures at which a membrane carries a dead load, height by height.

    Args:
        membrane: its mesh.
        rubber: what it is made of.
    """

    def __init__(self, membrane: Membrane, rubber: Rubber) -> None:
        self._membrane = membrane
        body = membrane.body(rubber)
        held = np.zeros(body.nodes, dtype=bool)
        held[membrane.disc] = held[membrane.rim] = True
        options = NewtonOptions(tolerance_N=1e-5, iterations_max=200, step_max_m=0.02)
        self._specimen = Specimen(body, held, options)

    def pressures(self, load_N: float, heights_m: Sequence[float]) -> Array:
        """Return the pressure [Pa] at each height, rising; nan from where none is found."""
        found = np.full(len(heights_m), np.nan)
        area = np.pi * (0.5 * (RIM_m + self._membrane.design.contact_radius_m)) ** 2
        height, here, pressure = heights_m[0], None, EASY_N / area
        try:
            for load in np.linspace(EASY_N, load_N, LOADS):
                here, pressure = self._at(height, float(load), pressure, here)
            for k, goal in enumerate(heights_m):
                for at in np.linspace(height, goal, 1 if k == 0 else 1 + HALVES)[-HALVES:]:
                    here, pressure = self._at(float(at), load_N, pressure, here)
                height, found[k] = goal, pressure
        except ConvergenceError:
            pass  # the other heights stay nan, which the table counts
        return found

    def _at(
        self, height_m: float, load_N: float, begin_Pa: float, near: Equilibrium | None
    ) -> tuple[Equilibrium, float]:
        """Return the equilibrium at a height under a load and its pressure, by secants."""
        here = self._lifted(height_m, begin_Pa, near)
        pressures, forces = [begin_Pa], [self._force(here)]
        step_Pa = 0.05 * begin_Pa * (1.0 if forces[0] < load_N else -1.0)
        for _ in range(30):
            pressures.append(pressures[-1] + step_Pa)
            here = self._specimen.follow(here, replace(UNLOADED, pressure_Pa=(pressures[-1],)))
            forces.append(self._force(here))
            if abs(forces[-1] - load_N) < 1e-3:
                return here, pressures[-1]
            slope = (forces[-1] - forces[-2]) / (pressures[-1] - pressures[-2])
            step_Pa = float(np.clip((load_N - forces[-1]) / slope, -0.15 * begin_Pa, 0.15 * begin_Pa))
        raise ConvergenceError("no pressure was found", abs(forces[-1] - load_N), 30)

    def _lifted(self, height_m: float, pressure_Pa: float, near: Equilibrium | None) -> Equilibrium:
        """Return the equilibrium with the disc at a height, from one nearby, or from a cone that bulges."""
        specimen, disc = self._specimen, self._membrane.disc
        if near is None:
            x = specimen.body.positions.copy()
            inner = self._membrane.design.contact_radius_m
            share = np.clip((RIM_m - np.hypot(x[:, 0], x[:, 1])) / (RIM_m - inner), 0.0, 1.0)
            x[:, 2] = height_m * share + 0.3 * height_m * np.sin(np.pi * share)
            here = specimen.solve(specimen.drawn(x), replace(UNLOADED, pressure_Pa=(0.1 * pressure_Pa,)))
            return specimen.follow(here, replace(UNLOADED, pressure_Pa=(pressure_Pa,)), 10)
        x = near.state.positions.copy()
        x[:, 2] *= height_m / x[disc[0], 2]
        return specimen.solve(replace(near.state, positions=np.ascontiguousarray(x)), near.loads)

    def _force(self, here: Equilibrium) -> float:
        """Return the load [N] that the disc carries."""
        return -float(self._specimen.gradient(here)[self._membrane.disc, 2].sum())


@dataclass(frozen=True)
class Curve:
    """A design under a load, and what was measured.

    Args:
        design: of the membrane.
        load_N: dead load.
        heights_m: of the disc.
        measured_Pa: at each height; nan: not measured.
        deviation_Pa: of the measured pressures.
    """

    design: Design
    load_N: float
    heights_m: Array
    measured_Pa: Array
    deviation_Pa: Array


def read_curves(path: Path) -> list[Curve]:
    """Return the curves of a file, see the module's text."""
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    rows: dict[tuple[Design, float], list[dict[str, str]]] = {}
    for row in csv.DictReader(lines):
        rows.setdefault((Design.of(row), float(row["force_N"])), []).append(row)
    curves = []
    for (design, load), points in rows.items():
        known = {
            round(1e-3 * float(row["contact_height_mm"]), 6): row
            for row in points
            if row.get("contact_height_mm")
        }
        at = [known.get(round(height, 6), {}) for height in HEIGHTS_m]
        values = [
            [float(row.get(name) or "nan") for row in at] for name in ("pressure_mean_Pa", "pressure_std_Pa")
        ]
        curves.append(Curve(design, load, HEIGHTS_m, *map(np.array, values)))
    return curves


def predicted(curve: Curve, rubber: Rubber, sectors: int) -> Array:
    """Return the pressures [Pa] at the curve's heights."""
    lifting = Lifting(Membrane(curve.design, sectors), rubber)
    return lifting.pressures(curve.load_N, curve.heights_m.tolist())


def mean_error(curves: Sequence[Curve], rubber: Rubber, sectors: int) -> float:
    """Return the mean of the relative errors over some curves."""
    off = [predicted(curve, rubber, sectors) / curve.measured_Pa - 1.0 for curve in curves]
    return float(np.nanmean(np.concatenate(off)))


def models(sectors: int) -> dict[str, Rubber]:
    """Return the three models, fitted to the measured curves that the module's text names."""
    curves = read_curves(MEASURED)
    least = min(curve.load_N for curve in curves)
    plain = [c for c in curves if c.load_N == least and not c.design.rings_m]
    ringed = [c for c in curves if c.load_N == least and c.design.rings_m]

    def of(stiffening: float) -> Rubber:
        def off(modulus: float) -> float:
            return mean_error(plain, Rubber(modulus, stiffening), sectors)

        return Rubber(float(brentq(off, 5e4, 1.6e5, rtol=1e-3)), stiffening)

    stiffening = of(STIFFENING)

    def with_rings(log_ring_Pa: float) -> Rubber:
        return replace(stiffening, ring_Pa=math.exp(log_ring_Pa))

    bounds = math.log(3e5), math.log(3e7)
    fitted = brentq(lambda x: mean_error(ringed, with_rings(x), sectors), *bounds, xtol=0.02)
    return {"rubber": of(0.0), "stiffening": stiffening, "other rings": with_rings(float(fitted))}


def described(curve: Curve, pressure_Pa: Array) -> dict[str, Any]:
    """Return a row of the table: errors relative to the measured pressures."""
    off = pressure_Pa / curve.measured_Pa - 1.0
    known = np.abs(off[np.isfinite(off)])
    return {
        "design": str(curve.design), "load_N": curve.load_N, "heights_m": curve.heights_m.tolist(),
        "pressure_Pa": pressure_Pa.tolist(), "measured_Pa": curve.measured_Pa.tolist(),
        "median": float(np.median(known)) if len(known) else None,
        "largest": float(known.max()) if len(known) else None,
        "compared": len(known), "lost": int(np.isnan(pressure_Pa[np.isfinite(curve.measured_Pa)]).sum()),
    }  # fmt: skip


def draw(curves: Sequence[Curve], found: Mapping[str, Sequence[Array]], path: Path) -> None:
    """Draw measured points with their deviation, and the predicted curves, a panel for each design."""
    import matplotlib as mpl  # here: only pictures need it

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    designs = list(dict.fromkeys(curve.design for curve in curves))
    figure, axes = plt.subplots(
        1, len(designs), figsize=(4.0 * len(designs), 3.6), squeeze=False, sharey=True
    )
    for design, panel in zip(designs, axes[0], strict=True):
        panel.set_title(str(design).replace(", rings", "\nrings"), fontsize=9)
        panel.set_xlabel("height of the disc [mm]")
        for k, curve in enumerate(curves):
            if curve.design != design:
                continue
            colour = f"C{[c.load_N for c in curves if c.design == design].index(curve.load_N)}"
            panel.errorbar(
                1e3 * curve.heights_m, 1e-3 * curve.measured_Pa, 1e-3 * curve.deviation_Pa, fmt="o", ms=3,
                color=colour, label=f"{curve.load_N:.1f} N",
            )  # fmt: skip
            for pressures, style in zip(found.values(), (":", "-", "--"), strict=True):
                panel.plot(1e3 * curve.heights_m, 1e-3 * pressures[k], style, color=colour, lw=1.2)
        panel.legend(fontsize=8)
    axes[0, 0].set_ylabel("pressure [kPa]")
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def write_robot(path: Path, design: Design, sectors: int) -> None:
    """Write the mesh of a design [mm] as the body of a robot's file.

    Groups: "disc", "film", "rings" if there are any, and "clamp", a row of triangles outside the rim.
    """
    membrane, held = Membrane(design, sectors), np.arange(sectors)
    x = np.concatenate([membrane.positions, membrane.positions[membrane.rim] * CLAMPED_m / RIM_m])
    inner = np.stack([membrane.rim, len(membrane.positions) + held, np.roll(membrane.rim, -1)], axis=1)
    outer = np.stack([inner[:, 2], inner[:, 1], np.roll(inner[:, 1], -1)], axis=1)
    disc = np.arange(len(membrane.triangles)) < sectors
    groups = {
        "disc": membrane.triangles[disc],
        "film": membrane.triangles[~disc & ~membrane.in_ring],
        "rings": membrane.triangles[membrane.in_ring],
        "clamp": np.concatenate([inner, outer]),
    }
    lines = [f"# {design}: clamped at {1e3 * RIM_m:g} mm, by benchmarks/silicone_discs.py --robot"]
    lines += ["v {:.7g} {:.7g} {:.7g}".format(*(1e3 * point)) for point in x]
    for name, triangles in groups.items():
        if len(triangles):
            lines += [f"g {name}", *("f {} {} {}".format(*(1 + nodes)) for nodes in triangles)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    """Fit, predict, print the tables; write what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--designs", type=Path, default=MEASURED)
    parser.add_argument("--sectors", type=int, default=36)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--robot", type=Path, help="write the mesh of the first design, and nothing else")
    options = parser.parse_args()
    curves = read_curves(options.designs)
    if options.robot:
        write_robot(options.robot, curves[0].design, options.sectors)
        return
    found: dict[str, list[Array]] = {}
    rows: dict[str, Any] = {}
    for name, rubber in models(options.sectors).items():
        print(
            f"\n{name}: E = {1e-3 * rubber.young_modulus_Pa:.1f} kPa, c = {rubber.stiffening:.4f}, rings of "
            f"{1e-6 * rubber.ring_Pa:.2f} MPa\n"
            "| membrane | load [N] | heights | median | largest |\n|---|---:|---:|---:|---:|"
        )
        found[name] = [predicted(curve, rubber, options.sectors) for curve in curves]
        table = [described(*pair) for pair in zip(curves, found[name], strict=True)]
        for row in table:
            of = f"{row['compared']} of {row['compared'] + row['lost']}"
            errors = "- | - |" if row["median"] is None else f"{row['median']:.1%} | {row['largest']:.1%} |"
            print(f"| {row['design']} | {row['load_N']:.1f} | {of} | {errors}")
            if row["median"] is None:
                print("    pressures [Pa]:", *np.round(row["pressure_Pa"]))
        rows[name] = {**vars(rubber), "curves": table}
    if options.picture:
        draw(curves, found, options.picture)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
