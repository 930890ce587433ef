"""Contact between films: its law, and texts on it."""

from cosim.config.schema.scenario import Scenario
from cosim.soft.body.body import SoftBody
from cosim.soft.contact import contact_law, self_contact_faces
from cosim.soft.contact.flange_face import FlangeFace
from cosim.soft.solve import self_contact


def film_law(scenario: Scenario) -> self_contact.FilmContactLaw | None:
    """Return the law of contact between films; None if it is not modelled."""
    settings = scenario.contact
    if not scenario.touches_itself:
        return None
    law = contact_law.ContactLaw(settings.stiffness_N_m3, settings.smoothing_m, settings.stick_m)
    return self_contact.FilmContactLaw(law, settings.self_friction, throughout=settings.self_contact is True)


def film_report(scenario: Scenario, body: SoftBody) -> str:
    """Return a text on the films that may touch one another."""
    settings = scenario.contact
    if scenario.fidelity == "rigid":
        return "none: the shape is frozen"
    if not scenario.touches_itself:
        return f"not modelled: {'as in the paper' if settings.self_contact else 'switched off'}"
    pairs = film_pairs(body)
    if not pairs:
        return "none: the film is one face, which does not touch itself"
    if scenario.fidelity == "section":
        apart = "; copies pass through one another" if body.copies else ""
        return f"between neighbouring units, in the energy of the sections, without friction{apart}"
    friction = "no friction" if scenario.mode == "quasistatic" else f"friction {settings.self_friction:g}"
    since = "" if settings.self_contact is True else ", as soon as they press"
    return f"{', '.join(pairs)}, {friction}{since}"


def film_pairs(body: SoftBody) -> list[str]:
    """Return texts on the parts of a body and its flange that its films can touch; empty without any."""
    faces = self_contact_faces.FilmFaces.of(body)
    points = self_contact_faces.FilmPoints.of(faces, body.positions)
    face = FlangeFace.of(body, faces, points, contact_law.ContactLaw())
    kinds = {
        f"between {faces.units} units": faces.can_meet,
        "between the films of a unit": faces.inside_out.can_meet,
        "on the flange's face": len(face.nodes) > 0,
    }
    return [text for text, can_touch in kinds.items() if can_touch]
