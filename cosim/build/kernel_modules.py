"""Which kernels every run needs, and which a scenario needs beside them, for compilation ahead of it."""

import sys
from collections.abc import Callable
from types import ModuleType

from cosim.config.schema.scenario import NO_ARM, AnySoftRobot, Scenario
from cosim.config.schema.soft_robot import SoftRobotTable


def _has_beams(robot: AnySoftRobot) -> bool:
    if not isinstance(robot, SoftRobotTable):
        return "cosim.soft.beams.beam_rings" in sys.modules  # which who gives a body with beams has imported
    return robot.stiffener.kind == "beam" or any(_has_beams(part.robot) for part in robot.attachments)


def _has_sliding_cables(robot: AnySoftRobot) -> bool:
    if not isinstance(robot, SoftRobotTable):
        return False
    own = any(cable.losses == "directed" for cable in robot.cables)
    return own or any(_has_sliding_cables(part.robot) for part in robot.attachments)


def _has_losses(robot: AnySoftRobot) -> bool:
    if not isinstance(robot, SoftRobotTable):
        return False  # of a body that is given, when first needed
    return robot.film.loss_factor > 0.0 or any(_has_losses(part.robot) for part in robot.attachments)


def _has_frames(robot: AnySoftRobot) -> bool:
    if not isinstance(robot, SoftRobotTable):
        return False  # of a body that is given, when first needed
    return robot.stiffener.kind == "stiff" or robot.copies is not None or len(robot.attachments) > 0


def common_modules() -> tuple[ModuleType, ...]:
    """Return the modules with kernels of every run: those of most elements, and of what sums them."""
    from cosim.soft.body import places
    from cosim.soft.contact import contact_law
    from cosim.soft.elements import element, eyelets, frame_ring, mass_terms, pressure
    from cosim.soft.linear import envelope_kernels, pattern, secant_pairs, vectors
    from cosim.soft.solve import state, step_begin

    elements = dict.fromkeys(sys.modules[kind.__module__] for kind in element.kinds_known())
    return (
        places, contact_law, envelope_kernels, state, mass_terms,
        pattern, pressure, secant_pairs, step_begin, vectors,
        *(module for module in elements if module not in (eyelets, frame_ring)),
    )  # fmt: skip


def compile_kernels(
    announce: Callable[[str], None] = lambda _text: None, more: tuple[ModuleType, ...] = ()
) -> None:
    """Compile the kernels of every run, or load them from numba's cache on disk.

    Args:
        announce: told in one sentence, before the wait, when they have to be compiled.
        more: modules with further kernels.
    """
    from cosim.base.compilation import compile_modules  # here, so that wrong input needs no engine

    compile_modules(announce, (*common_modules(), *more))


def kernel_modules(scenario: Scenario) -> tuple[ModuleType, ...]:
    """Return the modules with kernels that some scenarios do without; those of others are not imported."""
    modules: tuple[ModuleType, ...] = ()
    film = scenario.fidelity in ("lumped", "refined")
    if film:
        if scenario.mode == "dynamic":
            from cosim.telemetry import energy

            modules += (energy,)
        if not scenario.touches_itself:
            from cosim.soft.contact import film_look, self_contact_candidates, self_contact_search

            modules += (film_look, self_contact_candidates, self_contact_search)
    if scenario.touches_itself and film:  # a section model is built without a run, and kept
        from cosim.soft.contact import (
            film_lists,
            flange_face,
            rigid_motion,
            self_contact_candidates,
            self_contact_pairs,
            self_contact_search,
        )
        from cosim.soft.solve import self_contact

        modules += (
            self_contact_candidates,
            self_contact_search,
            self_contact_pairs,
            self_contact,
            film_lists,
        )
        modules += (flange_face, rigid_motion)
        if scenario.fidelity == "refined" or _is_wide(scenario.soft_robot):
            from cosim.soft.linear import fronts  # pairs of films may make matrices wide

            modules += (fronts,)
    if _has_beams(scenario.soft_robot):
        from cosim.soft.beams import ring_kernels

        modules += (ring_kernels,)
    if _has_frames(scenario.soft_robot):
        from cosim.soft.elements import frame_ring

        modules += (frame_ring,)
    if _has_sliding_cables(scenario.soft_robot):
        from cosim.soft.elements import eyelets

        modules += (eyelets,)
    if film and _has_losses(scenario.soft_robot):
        from cosim.soft.film import rate_kernels

        modules += (rate_kernels,)
    if not scenario.model.closed:
        from cosim.soft.elements import open_caps

        modules += (open_caps,)
    if scenario.fidelity == "section":
        from cosim.reduced.sections import assembly, section_energy
        from cosim.reduced.solve import chain_loads, chain_step
        from cosim.soft.solve import step_begin

        modules += (assembly, section_energy, chain_loads, chain_step, step_begin)
    return modules if scenario.robot == NO_ARM else modules + exchange_modules(scenario)


def exchange_modules(scenario: Scenario) -> tuple[ModuleType, ...]:
    """Return the modules with kernels of the exchange with a scene, contact with it left out."""
    from cosim.rigid.distance import shapes  # here: it brings MuJoCo

    if scenario.mode != "dynamic":
        return (shapes,)
    from cosim.coupling import payload
    from cosim.rigid.scene import load_leaves

    return (shapes, load_leaves, payload)


def _is_wide(robot: AnySoftRobot) -> bool:
    """Return whether films that touch tie parts together that are far apart in the order of elimination."""
    return isinstance(robot, SoftRobotTable) and (robot.copies is not None or len(robot.attachments) > 0)


def contact_modules() -> tuple[ModuleType, ...]:
    """Return the modules with kernels of contact with a scene; whether there is any, the plan says."""
    from cosim.coupling.contact import contact_kernels, near_search
    from cosim.rigid.distance import film_distance, shapes, signed_distance
    from cosim.rigid.scene import body_motion
    from cosim.soft.contact import obstacle_contact

    near = contact_kernels, near_search, obstacle_contact, body_motion
    return (*near, shapes, film_distance, signed_distance)


def compile_contact(tell: Callable[[str], None], scenario: Scenario) -> None:
    """Compile the kernels of contact with a scene, and tell so beforehand where they are not kept.

    Where there is nothing to touch but the arm that holds the film, only those that look for it: the others
    are compiled by the first search that finds something near.
    """
    from cosim.base.compilation import compile_modules  # here, so that wrong input needs no engine
    from cosim.coupling.contact.contact_kernels import assume, fastest_body, place_shapes
    from cosim.rigid.distance import shapes
    from cosim.rigid.scene import body_motion

    more = scenario.objects or scenario.wires or scenario.scene is not None
    compile_modules(
        tell, contact_modules() if more else (place_shapes, fastest_body, assume, body_motion, shapes)
    )
