"""Ways to solve with contacts between films, and what they cost: ten units that cables curl with 20 N.

    python benchmarks/self_contact.py [--json FILE]
    python benchmarks/self_contact.py --runs [PAIRS]

Costs of one Newton iteration's parts, the least thread CPU time of many calls, relative to a factorisation in
the body's own pattern: the wider pattern (factor, solve, and making its solver when the pairs change) against
the own pattern with a dense term per contact (its normal stiffness alone). Then the iterations from a load
step to balance with the exact tangent, and with one that fits the own pattern: blocks between the two films
dropped, those within doubled. Last, depth and cost over the stiffness of the law. With --runs instead: what
`contact.self_contact = "auto"` costs in scenarios whose films never press, and in `ur5e_hexagon_arm`, whose
films do: processor time of the loop over that with false, median and range of pairs that are run in turn;
and how far the tip of the latter is from that with true.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from benchmarks.measure.calls import least_ms
from cosim.app.driver import build_simulation
from cosim.base.frames import Array
from cosim.build.kernel_modules import compile_kernels
from cosim.config.loading import load_scenario
from cosim.soft.contact.contact_law import ContactLaw, feet
from cosim.soft.contact.self_contact_pairs import FilmPairs
from cosim.soft.linear.cholesky import EnvelopeCholesky
from cosim.soft.linear.linear_solver import LowRank
from cosim.soft.linear.pattern import CoupledPattern
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.self_contact import FilmContactLaw, SelfContact
from cosim.soft.solve.state import Equilibrium, SoftState
from tests.soft.bodies import HANGING, Held, PRESSURE_Pa, held, hexagon_arm, no_load
from tests.soft.interpenetration import deepest_m

TENSION_N = 20.0
NEVER_PRESS, FLAGSHIP = ("light_hexagon_arm", "tip_path"), "ur5e_hexagon_arm"


def curl(arm: Held, films: SelfContact | None) -> tuple[Equilibrium, int]:
    """Return the curled equilibrium and the iterations of the way there."""
    solver = EquilibriumSolver(arm.newton, arm.clamp, NewtonOptions(), films)
    here = solver.solve(SoftState.drawn(arm.body, HANGING), HANGING, no_load(arm.body))
    spent = 0
    for share in (0.25, 0.5, 1.0):
        here = solver.follow(here, HANGING, no_load(arm.body, pressure_Pa=(share * PRESSURE_Pa,)))
    for share in np.linspace(0.05, 1.0, 20):
        loads = no_load(arm.body, pressure_Pa=(PRESSURE_Pa,), cable_tension_N=(share * TENSION_N,) * 2)
        here = solver.follow(here, HANGING, loads)
        spent += here.iterations
    return here, spent


def solver_costs(arm: Held, here: Equilibrium, pairs: FilmPairs) -> dict[str, float]:
    """Return the costs of both ways [ms]."""
    system, x, free = arm.system, here.state.positions, arm.newton.free
    tension = system.segment_share(x, here.loads)
    system.evaluate(x, here.loads, tension, here.state.memory)
    body, wide = EnvelopeCholesky(system.pattern, free), EnvelopeCholesky(system.tangent_pattern, free)
    own, joined = system.blocks.copy(), system.tangent_blocks.copy()
    wide.factor(joined)
    load = np.random.default_rng(0).normal(size=x.shape)
    forces = pairs.memory(x)
    pressing = np.flatnonzero(np.isin(pairs.key, [] if forces is None else forces.key))
    foot, normal, _ = feet(x, pairs.rows.nodes, pairs.rows.weights)
    vectors = np.zeros((len(pressing), *x.shape))
    for row, k in enumerate(pressing):
        for node, weight in zip(pairs.rows.nodes[k], [*pairs.rows.weights[k], *-foot[k]], strict=True):
            vectors[row, node] += weight * normal[k]
    dense = LowRank(vectors, pairs.rows.stiffness[pressing])
    return {
        "pairs": len(pairs),
        "pressing": len(pressing),
        "own_bandwidth": body.bandwidth,
        "wide_bandwidth": wide.bandwidth,
        "own_factor_ms": least_ms(lambda: body.factor(own)),
        "wide_factor_ms": least_ms(lambda: wide.factor(joined)),
        "wide_solve_ms": least_ms(lambda: wide.solve(load)),
        "wide_setup_ms": least_ms(lambda: EnvelopeCholesky(wide.pattern, free), 10),
        "low_rank_factor_ms": least_ms(lambda: body.factor(own, low_rank=dense), 10),
    }


def iterations_to_balance(arm: Held, here: Equilibrium, pairs: FilmPairs, *, exact: bool) -> int:
    """Return the full Newton steps after 0.1 N more tension, with the pairs kept; at most 400."""
    system, x, angles = arm.system, here.state.positions.copy(), here.state.memory
    tension = tuple(t + 0.1 for t in here.loads.cable_tension_N)
    loads = replace(here.loads, cable_tension_N=tension, self_contact=pairs)
    coupled = CoupledPattern.of(system.pattern, pairs.rows.nodes)
    system.serving = pattern = coupled.pattern
    linear = EnvelopeCholesky(pattern, arm.newton.free)
    inside = np.zeros(pattern.blocks, dtype=bool)
    inside[coupled.from_body] = True
    for count in range(400):
        system.evaluate(x, loads, system.segment_share(x, loads), angles)
        if np.abs(system.gradient[arm.newton.free]).max() < 1e-6:
            return count
        blocks = system.tangent_blocks.copy()
        if not exact:
            contact = blocks - coupled.blocks(system.blocks)
            blocks += contact
            blocks[~inside] = 0.0
        assert linear.factor(blocks)
        x = x + linear.solve(-system.gradient)
    return 400


def stiffness_row(stiffness_N_m3: float) -> dict[str, float]:
    """Return how deep and how dear a law is."""
    arm = held(hexagon_arm(10))
    films = SelfContact(arm.body, FilmContactLaw(ContactLaw(stiffness_N_m3)))
    here, spent = curl(arm, films)
    touching = here.state.touching
    assert touching is not None
    return {
        "stiffness_N_m3": stiffness_N_m3,
        "iterations": spent,
        "force_N": touching.normal_force_N,
        "depth_mm": 1e3 * deepest_m(arm.body, here.state.positions),
    }


def measured() -> dict[str, Any]:
    """Return all figures."""
    arm = held(hexagon_arm(10))
    free, spent = curl(arm, None)
    films = SelfContact(arm.body, FilmContactLaw(ContactLaw()))
    here, _ = curl(arm, films)
    pairs = here.loads.self_contact
    assert pairs is not None
    x: Array = here.state.positions
    costs = solver_costs(arm, here, pairs)
    return {
        "solver": costs,
        "search_ms": least_ms(lambda: films.static_pairs(x)),
        "iterations_exact": iterations_to_balance(arm, here, pairs, exact=True),
        "iterations_majoriser": iterations_to_balance(arm, here, pairs, exact=False),
        "without": {"iterations": spent, "depth_mm": 1e3 * deepest_m(arm.body, free.state.positions)},
        "laws": [stiffness_row(stiffness) for stiffness in (1e8, 3e8, 1e9, 3e9, 1e10)],
    }


def taken(name: str, asked: str | bool) -> tuple[float, Array]:
    """Return the processor time of a scenario's loop [s], and its tip (ticks, 3) [m]."""
    simulation = build_simulation(load_scenario(name, {"contact.self_contact": asked}))
    batches, spent, tips = simulation.batches(), 0.0, list[Array]()
    while True:
        began = time.process_time()
        batch = next(batches, None)
        spent += time.process_time() - began
        if batch is None:
            return spent, np.concatenate(tips)
        tips.append(batch.tip_position)


def compared_runs(pairs: int) -> None:
    """Print what contact with itself costs in runs, and how far "auto" is from true."""
    compile_kernels(print)
    for name in (*NEVER_PRESS, FLAGSHIP):
        ratios = [taken(name, "auto")[0] / taken(name, False)[0] for _ in range(pairs)]
        ends = f"{min(ratios):.3f} to {max(ratios):.3f}"
        print(f"{name}: {np.median(ratios):.3f} of the time with false ({ends}, {pairs} pairs)", flush=True)
    apart = taken(FLAGSHIP, "auto")[1] - taken(FLAGSHIP, True)[1]
    print(f"{FLAGSHIP}: its tip is at most {1e3 * np.abs(apart).max():.6f} mm from that with true")


def main() -> None:
    """Print the table; write JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--runs", type=int, nargs="?", const=3, help="pairs of runs, instead of the table")
    given = parser.parse_args()
    if given.runs:
        return compared_runs(given.runs)
    found = measured()
    costs = found["solver"]
    unit = costs["own_factor_ms"]
    print(
        f"{costs['pressing']} points press, {costs['pairs']} pairs are near; a factorisation: {unit:.2f} ms"
    )
    print(f"bandwidth {costs['own_bandwidth']} -> {costs['wide_bandwidth']}")
    for name in ("wide_factor_ms", "wide_solve_ms", "wide_setup_ms", "low_rank_factor_ms"):
        print(f"  {name[:-3]:18s} {costs[name] / unit:6.2f} factorisations")
    print(f"  {'search':18s} {found['search_ms'] / unit:6.2f} factorisations")
    print(
        f"iterations to balance: exact {found['iterations_exact']}, doubled {found['iterations_majoriser']}"
    )
    off = found["without"]
    print(f"without self contact: {off['depth_mm']:.2f} mm, {off['iterations']} iterations")
    for row in found["laws"]:
        law, depth, force = row["stiffness_N_m3"], row["depth_mm"], row["force_N"]
        print(f"  {law:.0e} N/m^3: {depth:.3f} mm, {force:.0f} N, {row['iterations']} iterations")
    if given.json:
        given.json.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
