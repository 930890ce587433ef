"""The kernels that take longest to compile and that nearly every run of a film calls. A first run compiles
them together, on all processors; what else it calls is compiled when it is first called.
"""

from typing import Any, Final

from cosim.base.compilation import compile_kernels, is_ready
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.soft.beams import ring_kernels
from cosim.soft.beams.beam_rings import BeamRings
from cosim.soft.body.body import SoftBody
from cosim.soft.contact import self_contact_pairs as pairs
from cosim.soft.contact import unit_motion
from cosim.soft.contact.film_lists import fill_quiet, shorten_list
from cosim.soft.contact.self_contact_candidates import fill_list
from cosim.soft.contact.self_contact_search import fill_over
from cosim.soft.elements.hinge import add_hinges
from cosim.soft.elements.membrane import add_membranes
from cosim.soft.elements.pressure import add_pressure
from cosim.soft.linear import envelope_kernels
from cosim.soft.solve.self_contact import describe_pairs
from cosim.stepping import film_contact

FILM: Final[tuple[Any, ...]] = (
    add_membranes, add_hinges, add_pressure, envelope_kernels.list_entries, envelope_kernels.factorise,
    envelope_kernels.substitute,
)  # fmt: skip
IN_MOTION: Final[tuple[Any, ...]] = (envelope_kernels.substitute_singly,)
FRAMES: Final[tuple[Any, ...]] = (ring_kernels.add_beam_rings, ring_kernels.peak_strains)
FILMS_MEET: Final[tuple[Any, ...]] = (
    fill_list, shorten_list, fill_over, fill_quiet, unit_motion.units_stay, unit_motion.allow_motion,
    describe_pairs, pairs.add_pairs, pairs.add_pair_blocks, pairs.end_pairs,
)  # fmt: skip


def compile_first(scenario: Scenario, body: SoftBody) -> None:
    """Compile the long kernels of a run, in parallel, unless they are on disk.

    Args:
        scenario: with a film.
        body: of its soft robot.
    """
    kernels = [*FILM]
    if scenario.mode == "dynamic":
        kernels += IN_MOTION
    if body.of_kind(BeamRings):
        kernels += FRAMES
    if scenario.touches_itself and not is_ready(fill_list) and film_contact.film_pairs(body):
        kernels += FILMS_MEET
    if scenario.robot != NO_ARM:
        from cosim.rigid.distance.signed_distance import points_near  # here: it loads MuJoCo

        kernels.append(points_near)
    compile_kernels(kernels)
