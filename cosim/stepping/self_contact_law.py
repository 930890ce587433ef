"""How contact of the soft robot with itself is modelled in a scenario, and how that is told."""

from __future__ import annotations

from dataclasses import replace

from cosim.config.schema.scenario import Scenario
from cosim.coupling.schemes.ledger import LedgerEntry
from cosim.soft.body.body import SoftBody
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.self_contact_faces import FilmFaces
from cosim.soft.contact.self_contact_memory import FilmMemory
from cosim.soft.solve.self_contact import FilmContactLaw


def film_law(scenario: Scenario) -> FilmContactLaw | None:
    """Return the law of contact between films; None where it is not modelled."""
    given = scenario.contact
    if not given.self_contact:
        return None
    return FilmContactLaw(
        ContactLaw(given.stiffness_N_m3, given.smoothing_m, given.stick_m), given.self_friction
    )


def film_report(scenario: Scenario, body: SoftBody) -> str:
    """Return in words which films may touch one another."""
    given = scenario.contact
    if not given.self_contact:
        return "not modelled: switched off"
    if scenario.fidelity == "rigid":
        return "none: the shape is frozen"
    faces = FilmFaces.of(body)
    if not faces.can_meet:
        return "none: the film is one unit, which does not touch itself"
    friction = "no friction" if scenario.mode == "quasistatic" else f"friction {given.self_friction:g}"
    return f"between {faces.units} units, outside of the film, {friction}"


def with_film_contacts(ledger: LedgerEntry, films: FilmMemory | None) -> LedgerEntry:
    """Return the ledger with what the soft robot's films press on one another."""
    if films is None:
        return ledger
    return replace(
        ledger,
        self_contacts=films.count,
        self_contact_force_N=films.normal_force_N,
        self_contact_depth_m=films.depth_m,
    )
