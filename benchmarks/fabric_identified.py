"""Moduli of inflated fabric tubes, identified at two pressures and used to predict a third one.

    python benchmarks/fabric_identified.py [--out DIR]

The measured curves are those of benchmarks/fabric_tubes.py (J. Breukels, PhD thesis, TU Delft, 2011): tip
deflection over tip load of a tube of r = 0.065 m, up to 60 % of the load at collapse. The scatter of the
tests is not known; 0.5 mm is taken as noise. `cosim identify` fits two moduli of the robot `fabric_boom`, of
crimped and of straight yarns, to 0.2 and 0.5 bar. The curve at 0.3 bar is held out.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from benchmarks.fabric_tubes import bending_N, collapse_m
from cosim.bench.fitting import identify
from cosim.bench.page import series_lines, value_lines, write_results
from cosim.config.benches import load_bench

RADIUS_m, ROWS, SHARE = 0.065, 8, 0.6
FITTED_bar, HELD_bar = (0.2, 0.5), (0.3,)
HEAD = """
scenario = "fabric_boom_reaches"
[set]
gravity_m_s2 = [0.0, 0.0, 0.0]
contact.enabled = false
start.flange = { position_m = [0.0, 0.0, 0.0], direction = [0.0, 0.0, 1.0] }
[[parameter]]
key = "soft_robot.film.fabric.modulus_warp_Pa"
also = ["soft_robot.film.fabric.modulus_weft_Pa"]
low = 0.02e9
high = 0.5e9
start = 0.1e9
[[parameter]]
key = "soft_robot.film.fabric.straight_modulus_warp_Pa"
also = ["soft_robot.film.fabric.straight_modulus_weft_Pa"]
low = 0.5e9
high = 4e9
start = 1.0e9
"""


def deflections_m(p: float, loads: np.ndarray) -> np.ndarray:
    """Return the measured deflections [m] at tip loads [N]."""
    v = np.linspace(0.0, collapse_m(p, RADIUS_m), 2000)
    return np.interp(loads, bending_N(p, RADIUS_m, v), v)


def write_bench(folder: Path) -> Path:
    """Write bench and curves; return the bench's path."""
    text = [HEAD]
    for p in (*FITTED_bar, *HELD_bar):
        most = SHARE * float(bending_N(p, RADIUS_m, np.array([collapse_m(p, RADIUS_m)]))[0])
        loads = np.linspace(most / ROWS, most, ROWS)
        pairs = zip(loads.tolist(), deflections_m(p, loads).tolist(), strict=True)
        name = f"bent_{p:.1f}_bar".replace(".", "_")
        rows = "\n".join(f"{load:.5f},{1e3 * v:.5f}" for load, v in pairs)
        (folder / f"{name}.csv").write_text(f"load_N,tip_mm\n{rows}\n")
        text.append(
            f'[[series]]\nname = "{name}"\nfile = "{name}.csv"\nquantity = "tip_position_m.x"\n'
            f'measured = "tip_mm"\nloads = {{ pressure_Pa = {1e5 * p}, "force_N.tip.x" = "load_N" }}\n'
            f"noise = 0.5\nhold_out = {1 if p in HELD_bar else 0}\n"
        )
    (folder / "bench.toml").write_text("\n".join(text))
    return folder / "bench.toml"


def main() -> None:
    """Print values and how well curves are met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, help="where page and robot go")
    options = parser.parse_args()
    with TemporaryDirectory() as folder:
        found = identify(*load_bench(write_bench(Path(folder))), tell=print)
    print("\n".join([*found.check.lines(), *value_lines(found), *series_lines(found)]))
    for number, entry in enumerate(found.series):
        rows = found.rows_of(number)
        loads, both = (
            entry.loads["force_N.tip.x"],
            1e3 * np.stack([found.measured, found.predicted, found.band]),
        )
        for load, (measured, predicted, band) in zip(loads, both[:, rows].T, strict=True):
            print(
                f"{entry.table.name}: {load:5.1f} N {measured:6.1f} mm, model {predicted:6.1f} +- {band:.1f}"
            )
    if options.out is not None:
        write_results(found, options.out, "fabric_identified.py")


if __name__ == "__main__":
    main()
