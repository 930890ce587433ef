"""Names in files and results: the chamber of a body with one chamber, and the terms of the energy balance. A
schema or a file describes its fields with the text of their docstrings, which `texts_of` reads.
"""

import inspect
import re
from typing import Final

ONLY_CHAMBER: Final = "chamber"
"""Name of the chamber of a body that has only one."""
WORKS: Final = (
    "gas_J", "cables_J", "flange_J", "eyelets_J", "gravity_J", "contacts_J", "self_contacts_J", "damping_J",
    "air_drag_J", "material_damping_J", "bodies_J", "contact_loss_J", "eyelets_made_J",
)  # fmt: skip
PUT_IN: Final = ("gas_J", "cables_J", "flange_J", "gravity_J", "bodies_J", "self_contacts_J")
LOST: Final = (
    "contact_loss_J", "eyelets_J", "damping_J", "air_drag_J", "material_damping_J", "numerical_J",
)  # fmt: skip
MADE: Final = ("eyelets_made_J",)
"""Energy that a one-way coupling of eyelets creates: a part of `eyelets_J`, which is not counted again."""
BETWEEN: Final = ("contacts_J",)
"""Energy from bodies to the film; the contact loss is the difference between what they give and this."""
TERMS: Final = (*WORKS, "elastic_J", "kinetic_J", "numerical_J", "rest_J")
"""Terms of the energy balance, in the order of its columns. The elastic energy, and so the rest, are known at
some ticks only."""


def texts_of(kind: type) -> tuple[str, dict[str, str]]:
    """Return a class's docstring without its arguments, and the text of each argument.

    Args:
        kind: a documented class.
    """
    text, _, arguments = (inspect.getdoc(kind) or "").partition("\nArgs:\n")
    arguments, _, after = arguments.partition("\n\n")
    found = {}
    for entry in re.split(r"\n(?=    \S)", arguments):
        names, _, meaning = entry.partition(":")
        words = " ".join(meaning.split())
        found.update({name.strip(): words for name in names.split(",")})
    return " ".join(f"{text} {after}".split()), found
