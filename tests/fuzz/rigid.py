"""Mutated URDF, MJCF, arm.toml, cells and meshes: refused by name, or what is built is finite.

A traceback, a crash, a refusal that is not printable or does not name the file, and a number of an MJCF
that is not finite and is accepted are findings.
"""

from __future__ import annotations

import contextlib
import io
from dataclasses import replace
from pathlib import Path
from typing import Any, final

import numpy as np

from cosim.base.kept_parts import KeptParts
from cosim.build.arm_parts import ArmParts
from cosim.build.arms import find_arm
from cosim.build.options import fidelity_body
from cosim.cli.main import main
from cosim.config.loading import load_scenario
from cosim.errors import InstabilityError
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.scene.scene import RigidScene
from tests.fuzz.files import LONGEST_REFUSAL
from tests.fuzz.rigid_files import RigidCase, rigid_case, unchanged
from tests.fuzz.verdict import FINDING, Trial, Verdict, traceback_verdict

_FINE = 0
_REFUSED = 2


@final
class Checked(Trial):
    """Files that `cosim check` reads, and that are built if it accepts them."""

    cpu_limit_s = 10.0

    def begin(self, folder: Path) -> None:
        for case in unchanged():
            try_files(case, folder)

    def tried(self, seed: int, folder: Path) -> Verdict:
        case = rigid_case(seed)
        return replace(try_files(case, folder), case=f"{case.source}: {case.changes}")


def try_files(case: RigidCase, folder: Path) -> Verdict:
    """Return what `cosim check` says of a case, and whether what it accepts is finite once it is built.

    Args:
        case: of `rigid_case`.
        folder: for its files.
    """
    path, out, err = case.write(folder / "files"), io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main(["check", str(path)])
        said = (out.getvalue() + err.getvalue()).strip("\n")
        if code == _REFUSED:
            problem = _wrong_words(said, path)
            return Verdict(FINDING if problem else "refused when loaded", f"{problem}{said[:600]}")
        if code != _FINE or err.getvalue():
            return Verdict(FINDING, f"exit code {code}: {said[:300]}")
        if case.refused:
            return Verdict(FINDING, "a number that is not finite was accepted")
        problem = _not_finite(path)
    except InstabilityError as error:
        return Verdict("unsolved", str(error))
    except Exception as error:  # that is what is looked for
        return traceback_verdict(error)
    return Verdict(FINDING if problem else "completed", problem)


def _wrong_words(said: str, path: Path) -> str:
    """Return what is wrong with the words of a refusal; empty if nothing is."""
    lines = said.split("\n")
    if not all(line.isprintable() for line in lines):
        return "not printable: "
    strange = [line for line in lines if not line.startswith((f"{path}: ", "cosim: error: "))]
    if strange:
        return f"does not name the file: {strange[0]}; "
    longest = max(map(len, lines))
    return f"{longest} characters: " if longest > LONGEST_REFUSAL else ""


def _not_finite(path: Path) -> str:
    """Return which numbers of what is built of accepted files are not finite; empty if all are.

    Raises:
        InstabilityError: the rigid scene cannot take a step.
    """
    numbers: dict[str, Any] = {}
    if path.name == "s.toml":
        scenario = load_scenario(path)
        scene = ArmParts(scenario, KeptParts()).scene
        body = fidelity_body(scenario)
        numbers |= {"nodes": body.positions, "masses": body.node_mass}
    else:
        scene = RigidScene(SceneDescription(find_arm(str(path))))
    numbers |= {"poses": scene.body_poses(), "mass matrix": scene.mass_matrix, "bias": scene.bias_torque}
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 3))
    numbers["distances"] = scene.contact_query().distances(points, 0.5).distance
    numbers["shapes"] = [shape.vertices for shape in scene.shapes]
    for _ in range(2):
        scene.step()
    numbers["poses after a step"] = scene.body_poses()
    wrong = [
        name
        for name, values in numbers.items()
        if not all(
            np.isfinite(part).all() for part in (values if isinstance(values, list | tuple) else [values])
        )
    ]
    return f"not finite: {', '.join(wrong)}" if wrong else ""
