"""Designs solved until goal and limits are as good as those of `cosim design`, without derivatives.

    python benchmarks/design.py [bend sag arm outline] [--most 300] [--verified]

The studies are those of docs/design.md, with three units where there are choices, on the film's own mesh.
Without derivatives: scipy's COBYQA on the same variables, quantities and sizes. A design is as good once its
goal is within 1 % of that of `cosim design` and its limits are missed by less than 1 % of their size.
--verified prints instead what `cosim design` does: with all choices, ranked, verified on the refined mesh.
"""

from __future__ import annotations

import argparse
import re
from contextlib import chdir, suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.optimize import NonlinearConstraint, minimize

from cosim.bench.design import design, design_lines, search
from cosim.bench.design_problem import DesignProblem
from cosim.config.benches import DesignStudyTable, load_design_study

PAGE = Path(__file__).resolve().parents[1] / "docs" / "design.md"
CLOSE = 0.01


class Spent(Exception):  # noqa: N818  # no error: the budget is spent
    """All designs are solved."""


def studies(folder: Path) -> dict[str, DesignStudyTable]:
    """Return the studies of the page, with their choices.

    Args:
        folder: that their files are written to.
    """
    page = re.sub(
        r"^```\{literalinclude\} (\S+\.toml)\n:language: toml\n```$",
        lambda mark: f"```toml\n{(PAGE.parent / mark[1]).read_text()}```",
        PAGE.read_text(),
        flags=re.M,
    )
    found = {}
    for name, text in re.findall(r"^```toml\n# (\w+)\.toml\n(.*?)^```$", page, re.M | re.S):
        path = folder / f"{name}.toml"
        path.write_text(text)
        if "[goal]" not in text:  # the robot of the study that follows
            continue
        found[name] = load_design_study(path)
    return found


def without_choices(study: DesignStudyTable) -> DesignStudyTable:
    """Return a study of its choice "three", if it has choices."""
    chosen = next((choice.set for choice in study.choice if choice.name == "three"), {})
    return replace(study, set={**study.set, **chosen}, choice=())


def print_verified(name: str, study: DesignStudyTable) -> None:
    """Print the designs of a study, the best first."""
    for found in design(study):
        met = "limits are met" if found.feasible else "limits are NOT met"
        print(f"{name} {found.choice}: {met}, {found.evaluations} designs solved", flush=True)
        print("\n".join(f"    {line}" for line in design_lines(found)), flush=True)


def print_compared(name: str, study: DesignStudyTable, most: int) -> None:
    """Print how many designs a study takes with derivatives, and without."""
    exact = DesignProblem(study)
    exact.begin()
    goal = exact.cost(search(exact, exact.start).reached)
    own = needed(exact, goal)
    other = needed(without_derivatives(study, most), goal)
    print(f"| `{name}.toml` | {own} | {other or f'not within {most}'} |", flush=True)


def needed(problem: DesignProblem, goal: float) -> int | None:
    """Return how many designs were solved until one was as good; None where none was."""
    for count, each in enumerate(problem.history, start=1):
        cost, missed = problem.cost(each.reached), problem.missed(each.reached)
        if cost <= goal + CLOSE * abs(goal) and (missed <= CLOSE).all():
            return count
    return None


def without_derivatives(study: DesignStudyTable, most: int) -> DesignProblem:
    """Return the problem with the designs that COBYQA has solved."""
    problem = DesignProblem(study)
    problem.begin()

    def solved(x: np.ndarray) -> np.ndarray:
        x = np.clip(x, 0.0, 1.0)  # it looks beyond bounds on its way
        if len(problem.history) >= most and not problem.is_at(x):
            raise Spent
        return problem.reached(x)

    def limits(x: np.ndarray) -> np.ndarray:
        return np.nan_to_num(problem.off(solved(x)), nan=10.0)

    both = [entry.equal is not None for entry in study.limit]
    bounds = NonlinearConstraint(limits, np.where(both, 0.0, -np.inf), 0.0)
    with suppress(Spent):
        minimize(
            lambda x: problem.cost(solved(x)), problem.start, method="COBYQA",
            bounds=[(0.0, 1.0)] * len(problem.start), constraints=bounds, options={"maxfev": most},
        )  # fmt: skip
    return problem


def main() -> None:
    """Solve the studies that are named, and print what came of each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("studies", nargs="*", help="by name; all unless given")
    parser.add_argument("--most", type=int, default=300, help="designs that COBYQA may solve")
    parser.add_argument("--verified", action="store_true")
    options = parser.parse_args()
    with TemporaryDirectory() as folder, chdir(folder):
        for name, study in studies(Path(folder)).items():
            if options.studies and name not in options.studies:
                continue
            if options.verified:
                print_verified(name, study)
            else:
                print_compared(name, without_choices(study), options.most)


if __name__ == "__main__":
    main()
