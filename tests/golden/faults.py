"""Shows which golden run sees which fault: python -m tests.golden.faults [WORD ...], all or those of a word.

Each fault alone is put into a copy of cosim, or into the overrides of a run. A line is printed for each: the
run, how many of its figures are off, and the farthest; a broken sign may also end the run.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

from tests.golden import comparison, runs

ROOT: Final = Path(__file__).resolve().parents[2]
LONGEST_S: Final = 1200
VALUES: Final[dict[str, tuple[str, dict[str, Any]]]] = {
    "1 % film stiffness": ("flagship_published", {"soft_robot.film.young_modulus_Pa": 1.313e9}),
    "1 % pressure": ("pattern", {"phase.inflate.pressure_Pa": 20.2e3}),
    "1 % tension": ("figure_9", {"phase.lift.cable_tension_N": [20.2, 20.2]}),
    "1 % gravity": ("figure_9", {"gravity_m_s2": [0.0, 0.0, -9.9081]}),
    "1 % friction": ("table_edge", {"object.table.friction": 0.505}),
    "1 % contact stiffness": ("table_edge", {"contact.stiffness_N_m3": 3.03e8}),
    "1 % damping": ("table_edge", {"solver.damping_per_s": 5.05}),
}
"""1 % more of a value: the run that is to see it, and its overrides."""
SIGNS: Final[dict[str, tuple[str, str, str, str]]] = {
    "plain film": ("pattern", "elements/membrane", "[i, r] -= one + two", "[i, r] += one + two"),
    "wrinkles": ("pattern", "elements/membrane", "(first, -plate - r2", "(first, -plate + r2"),
    "tension field": ("slopes", "elements/tension_field", "n[r] += relaxed * z", "n[r] -= relaxed * z"),
    "fabric": ("slopes", "elements/membrane", "n[i] += grown", "n[i] -= grown"),
    "edge strain": ("figure_9", "elements/edge_strain", "strain1 += columns", "strain1 -= columns"),
    "rubber": ("identified", "elements/membrane", "* c22, shear", "* c22, -shear"),
    "loss factor": ("attached", "film/rate_kernels", "LANES + lane] = n[r]", "LANES + lane] = -n[r]"),
    "hinge": ("pattern", "elements/hinge", "angle - free[lane], k", "angle + free[lane], k"),
    "cable": ("slopes", "elements/cable", "gradient[a, r] -= across", "gradient[a, r] += across"),
    "eyelet": ("attached", "elements/eyelets", "pull[s] -= lost", "pull[s] += lost"),
    "stiff frame": ("attached", "elements/frame_ring", "stretch = length - ", "stretch = length + "),
    "beam": ("slopes", "beams/ring_kernels", "[node, r] -= force", "[node, r] += force"),
    "frame stop": ("deploys", "elements/frame_stops", "onset(springs[e, 0] - d", "onset(springs[e, 0] + d"),
    "pressure": ("slopes", "elements/pressure", "[ia, r] -= sixth", "[ia, r] += sixth"),
    "cap": ("slopes", "elements/pressure", "[ring[i], r] -= factor", "[ring[i], r] += factor"),
    "open cap": ("figure_9", "elements/pressure", "gradient[b, r] += force", "gradient[b, r] -= force"),
    "gas": ("sealed", "elements/gas", "volume_0 / volume, exponent", "volume_0 / volume, -exponent"),
    "weight": ("pattern", "elements/mass_terms", "gradient[i, r] -= weight", "gradient[i, r] += weight"),
    "inertia": ("attached", "elements/mass_terms", "x[i, r] - target", "x[i, r] + target"),
    "damping": ("attached", "solve/step_scheme", "self.damping_per_s + self", "-self.damping_per_s + self"),
    "contact": ("table_edge", "contact/contact_law", "own[r] = -pressing", "own[r] = pressing"),
    "friction": ("table_edge", "contact/contact_law", "own[r] += limit", "own[r] -= limit"),
    "self-contact": ("curls", "contact/self_contact_pairs", "rub[r] - push *", "rub[r] + push *"),
    "self-friction": ("curls", "contact/self_contact_pairs", "w[a] * rub[r] - push", "-w[a] * rub[r] - push"),
    "section": ("flagship_section", "sections/section_energy", "f_b - u2 * f_q", "f_b + u2 * f_q"),
}  # fmt: skip
"""A sign of an element: the run that is to see it, the file, its text, and the broken one."""


def deviations(name: str, changes: runs.Changes = runs.UNCHANGED) -> str:
    """Return in a line how far the figures of a run are off."""
    with tempfile.TemporaryDirectory() as made:
        try:
            found = runs.figures_of(name, Path(made), changes)
        except Exception as error:
            return f"the run ends: {type(error).__name__}"
    off = sorted(comparison.read(name).differences(found), reverse=True)
    return f"{len(off)} figures, {off[0][0]:.3g} times the tolerance: {off[0][1]}" if off else "NOT SEEN"


def with_sign(fault: str, folder: Path) -> str:
    """Return in a line what a run says to a broken sign.

    Args:
        fault: its name.
        folder: of the copies, with the kernels that they share.
    """
    name, file, text, broken = SIGNS[fault]
    copy = folder / fault.replace(" ", "_")
    shutil.copytree(ROOT / "cosim", copy / "cosim", ignore=shutil.ignore_patterns("__pycache__"))
    for other in ("tests", "robots", "scenarios"):
        (copy / other).symlink_to(ROOT / other)
    (path,) = (copy / "cosim").glob(f"*/{file}.py")
    source = path.read_text(encoding="utf-8")
    assert source.count(text) == 1, f"{file} has {source.count(text)} times: {text}"
    path.write_text(source.replace(text, broken), encoding="utf-8")
    command = f"from tests.golden.faults import deviations; print(deviations('{name}'))"
    (copy / "cosim/__pycache__").mkdir()
    (copy / "cosim/__pycache__/kernels").symlink_to(folder / "kernels")
    given = os.environ | {"OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [sys.executable, "-c", command],
            cwd=copy,
            env=given,
            capture_output=True,
            text=True,
            timeout=LONGEST_S,
        )
    except subprocess.TimeoutExpired:
        return f"the run does not end within {LONGEST_S} s"
    return done.stdout.strip().splitlines()[-1] if done.returncode == 0 else f"ends by {done.returncode}"


def main(words: set[str]) -> None:
    """Print a line for each fault that has one of the words, or for all."""
    for fault, (name, changes) in VALUES.items():
        if not words or words & set(fault.split()):
            print(f"{fault} | {name} | {deviations(name, changes)}", flush=True)
    with tempfile.TemporaryDirectory() as made, ThreadPoolExecutor(2) as pool:
        shutil.copytree(ROOT / "cosim/__pycache__/kernels", Path(made) / "kernels")
        chosen = [fault for fault in SIGNS if not words or words & {"sign", *fault.split()}]
        for fault, line in zip(chosen, pool.map(with_sign, chosen, [Path(made)] * len(chosen)), strict=True):
            print(f"sign of {fault} | {SIGNS[fault][0]} | {line}", flush=True)


if __name__ == "__main__":
    main(set(sys.argv[1:]))
