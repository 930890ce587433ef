"""Names of what the energy balance of a run adds up, in the order of its columns; no kernels are loaded."""

from typing import Final

WORKS: Final = (
    "gas_J", "cables_J", "flange_J", "eyelets_J", "gravity_J", "contacts_J", "self_contacts_J", "damping_J",
    "air_drag_J", "material_damping_J",
)  # fmt: skip
PUT_IN: Final = ("gas_J", "cables_J", "flange_J", "gravity_J", "contacts_J", "self_contacts_J")
LOST: Final = ("eyelets_J", "damping_J", "air_drag_J", "material_damping_J", "numerical_J")
TERMS: Final = (*WORKS, "elastic_J", "kinetic_J", "numerical_J", "rest_J")
"""Of the balance; elastic energy, and with it the rest, are known at some ticks only."""
