"""What a scene does not need calls no compiled function: counts of calls, not times."""

from __future__ import annotations

from functools import cache

import pytest

from benchmarks.leaf_calls import (
    EVALUATION,
    PARTS,
    SITUATIONS,
    by_part,
    calls_a_tick,
    scenario_text,
    simulation,
)

BROAD: set[str] = {
    "coupling.contact.contact_kernels.predict_poses",
    "soft.contact.contact_points._span",
    "rigid.distance.shapes.fill_near_box",
}
"""Poses of the shapes, bounds of the film, and shapes near these: each once a tick."""


@cache
def calls(situation: str) -> dict[str, float]:
    return calls_a_tick(simulation(SITUATIONS[situation]), ticks=20)


def parts(situation: str) -> dict[str, float]:
    return by_part(calls(situation))


def of_part(situation: str, part: str) -> dict[str, float]:
    return {name: times for name, times in calls(situation).items() if by_part({name: 1.0})[part]}


def test_a_bare_film_calls_nothing_of_other_parts() -> None:
    bare = parts("bare film")
    assert (bare["cables"], bare["objects"], bare["film pairs"]) == (0.0, 0.0, 0.0)
    assert bare["film"] > 8.0
    assert 1.0 <= bare["arm"] <= 4.0


def test_an_evaluation_calls_each_leaf_of_the_film_once() -> None:
    bare = calls("bare film")
    evaluations = bare[EVALUATION]
    for leaf in ("hinge.add_hinges", "pressure.add_pressure", "mass_terms.add_inertia"):
        assert bare[f"soft.elements.{leaf}"] == pytest.approx(evaluations)
    assert bare["soft.elements.membrane.add_membranes"] == pytest.approx(2.0 * evaluations), "film and necks"
    assert bare["soft.elements.pressure.add_cap"] == pytest.approx(2.0 * evaluations), "one for each end"


def test_cables_are_one_leaf_of_an_evaluation() -> None:
    found = calls("two cables")
    assert of_part("two cables", "cables") == {"soft.elements.cable.add_segments": found[EVALUATION]}
    assert parts("two cables")["objects"] == parts("two cables")["film pairs"] == 0.0


def test_a_block_beyond_reach_calls_nothing() -> None:
    assert calls("block beyond reach") == calls("bare film")


@pytest.mark.parametrize("situation", ["block far", "block 3 mm away"])
def test_a_block_that_is_not_near_costs_the_broad_search_alone(situation: str) -> None:
    assert of_part(situation, "objects") == dict.fromkeys(BROAD, 1.0)
    rest = {name: times for name, times in calls(situation).items() if name not in BROAD}
    assert rest == calls("bare film"), "its film steps as without the block"


def test_a_movable_block_far_away_searches_no_contacts() -> None:
    found = of_part("block far, movable", "objects")
    assert set(found) > BROAD
    assert set(found) - BROAD == {
        f"coupling.contact.contact_kernels.{name}" for name in ("fastest_body", "extrapolate_loads")
    }
    assert max(found.values()) == 1.0


def test_only_a_block_that_touches_has_a_memory_of_contacts() -> None:
    near, touching = of_part("block 0.5 mm away", "objects"), of_part("block touches", "objects")
    memory = "coupling.contact.contact_kernels.restore_memory"
    assert "rigid.distance.signed_distance.points_near" in near
    assert memory not in near
    assert touching[memory] == 1.0
    added = "soft.contact.obstacle_contact.add_contacts"
    assert touching[added] == pytest.approx(calls("block touches")[EVALUATION])


def test_films_near_one_another_call_leaves_of_pairs_alone() -> None:
    found = parts("film pairs near")
    assert found["film pairs"] > 5.0
    assert found["cables"] == found["objects"] == 0.0
    pairs = of_part("film pairs near", "film pairs")
    assert {
        name: times for name, times in calls("film pairs near").items() if name not in pairs
    }.keys() == calls("bare film").keys()


def test_every_leaf_belongs_to_one_part() -> None:
    found = {f"{begins}leaf": part for part, beginnings in PARTS.items() for begins in beginnings}
    for name, part in found.items():
        assert by_part({name: 1.0}) == dict.fromkeys(PARTS, 0.0) | {part: 1.0}
    assert "self_contact = false" in scenario_text({})
