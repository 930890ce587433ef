"""A field more in an element or a load changes all that depends on it, or is refused: no list by hand."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import pytest

from cosim.base.frames import Array, IntArray
from cosim.base.state_checks import check_state
from cosim.base.state_file import load, save
from cosim.build.section_models import content_hash
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.errors import InputError
from cosim.soft.body import loads as loads_file
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.contact_points import ContactSurface
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.contact.self_contact_pairs import FilmPairs
from cosim.soft.elements.element import NODES, STILL, DirectElement, Element, Instant, Sums
from cosim.soft.elements.gas import SealedGas
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.step_scheme import StepOptions
from tests.soft.bodies import HANGING, hexagon_arm, no_load, shapes
from tests.soft.contacts import half_space
from tests.soft.wind import Windy

PAIR = np.array([[0, 40]])
STEPS = 3


@dataclass(frozen=True)
class StepCount(DirectElement):
    """It remembers how often a step has ended."""

    label: ClassVar[str] = "step counts"
    nodes: Annotated[IntArray, NODES]

    def first_memory(self, positions: Array) -> Array:
        return np.zeros(1)

    def advanced(self, positions: Array, tracked: Array) -> Array:
        return tracked + 1.0

    def add(
        self, positions: Array, slots: IntArray, gradient: Array, blocks: Array, at: Instant = STILL
    ) -> float:
        return 0.0


@dataclass(frozen=True)
class WeightedStepCount(StepCount):
    """The same with a field more, which it remembers as well."""

    weight: float = 1.0

    def first_memory(self, positions: Array) -> Array:
        return np.array([0.0, self.weight])


def stepped(element: Element) -> FilmRobot:
    arm = FilmRobot(hexagon_arm(2).with_elements(element), HANGING, NewtonOptions(), StepOptions())
    for _ in range(STEPS):
        arm.advance(HANGING, no_load(arm.body), 1e-3)
    return arm


def again(state: Any, folder: Path) -> Any:
    file = folder / "state.npz"
    save(file, state)
    return load(file)


def test_what_an_element_remembers_more_is_saved_and_a_state_without_it_refused(tmp_path: Path) -> None:
    plain, more = (stepped(element) for element in (StepCount(PAIR), WeightedStepCount(PAIR, 5.0)))
    assert again(plain.full_state, tmp_path).soft.memory[-1:].tolist() == [STEPS]
    assert again(more.full_state, tmp_path).soft.memory[-2:].tolist() == [STEPS, 5.0 + STEPS]
    for found, present in ((plain, more), (more, plain)):
        with pytest.raises(InputError, match=r"state\.soft\.memory has shape"):
            check_state(found.full_state, present.full_state)


def test_what_loads_have_more_is_saved_and_a_file_without_it_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = stepped(StepCount(PAIR))
    state = arm.full_state
    windy: Any = Windy(
        **{entry.name: getattr(state.loads, entry.name) for entry in fields(Loads)}, wind_m_s=3.0
    )
    assert again(replace(state, loads=windy), tmp_path).loads == windy
    again(state, tmp_path)
    monkeypatch.setattr(loads_file, "Loads", Windy)
    with pytest.raises(InputError, match=r"Loads is of another version: 'other fields: wind_m_s'"):
        load(tmp_path / "state.npz")


def test_a_section_model_is_kept_under_another_name() -> None:
    body = hexagon_arm(2)
    elements = (StepCount(PAIR), WeightedStepCount(PAIR), WeightedStepCount(PAIR, 2.0))
    names = {content_hash(body, 5e4), *(content_hash(body.with_elements(entry), 5e4) for entry in elements)}
    assert len(names) == 4


class Push:
    """Pushes the last node."""

    def add(self, positions: Array, sums: Sums, hessian: bool) -> float:
        sums.gradient[-1] += 1.0
        return 0.0


def touching() -> FilmPairs:
    """Return a node and a triangle of a film beside it, under a law by which they press on each other."""
    x, nodes, law = shapes(2)["random"], np.array([[0, 0, 0, 30, 31, 32]]), ContactLaw(smoothing_m=1.0)
    none = np.zeros(1, np.int64)
    return FilmPairs.slack(none, none, nodes, np.eye(3)[:1], np.array([1e3]), law, x)


def beside() -> ContactPlanes:
    """Return a plane that a body is behind."""
    surface = ContactSurface.of(hexagon_arm(2), FilmPotential(hexagon_arm(2)).pattern)
    return half_space(surface, np.array([0.0, 0.0, -1.0]), 0.0, ContactLaw())


ACTING: dict[str, Any] = {
    "pressure_Pa": (1e4,),
    "cable_tension_N": (1.0, 0.0),
    "gravity": (0.0, 0.0, 1.0),
    "nodal_force": np.ones((hexagon_arm(2).nodes, 3)),
    "gas": (SealedGas(2e5, 1e-4),),
    "contact": beside(),
    "cable_length_m": (0.01, None),
    "self_contact": touching(),
    "extra": Push(),
    "cable_stiffening": (2.0, 1.0),
}
BESIDE: dict[str, dict[str, Any]] = {"cable_stiffening": {"cable_length_m": (0.01, None)}}
"""What acts only on what another field gives."""


@pytest.mark.parametrize("name", [entry.name for entry in fields(Loads)])
def test_whatever_loads_hold_acts(name: str) -> None:
    body, x = hexagon_arm(2), shapes(2)["random"]

    def gradient(loads: Loads) -> Array:
        system = FilmPotential(body)
        system.evaluate(x, loads, system.losses_at(x, loads), body.first_memory(), hessian=False)
        return system.gradient.copy()

    still = replace(no_load(body, gravity=(0.0, 0.0, 0.0)), **BESIDE.get(name, {}))
    assert np.abs(gradient(replace(still, **{name: ACTING[name]})) - gradient(still)).max() > 1e-4
