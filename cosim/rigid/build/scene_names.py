"""Names of bodies, sites and sensors in a compiled scene, by which they are found in it."""

from typing import Final

CELL: Final = "cell"
"""Body that carries the cell; its names are CELL/NAME."""
FLANGE_SITE: Final = "flange"
FORCE_SENSOR: Final = "flange_force"
TORQUE_SENSOR: Final = "flange_torque"
FLANGE_CONTACTS: Final = "flange_contacts"
OBJECT_CONTACTS: Final = "contacts of"
"""What names of sensors begin with that count an object's contacts: with all, then with each flange."""
