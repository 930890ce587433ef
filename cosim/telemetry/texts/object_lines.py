"""Sentences on objects, from the rows of a summary."""

import math
from collections.abc import Sequence
from typing import Any, Final

_LISTED: Final = 4
"""Objects with a line; the others are counted."""


def object_lines(objects: Sequence[dict[str, Any]]) -> list[str]:
    """Return a line for each object of a summary: motion, tilt, holds, drops and forces.

    Objects that were neither touched nor moved are left out; after the first few they are counted.
    """
    lines = [
        _line(row)
        for row in objects
        if row["max_squeeze_N"] or (row["moved_m"] or 0.0) > 1e-3 or (row["tilted_rad"] or 0.0) > 0.01
    ]
    more = len(lines) - _LISTED
    return lines[:_LISTED] + ([f"{more} more: objects in the summary"] if more > 0 else [])


def _line(row: dict[str, Any]) -> str:
    held = f", held {', '.join(map(_span, row['held']))}" if row["held"] else ", never held" * row["free"]
    if row["dropped_s"]:
        held += f", dropped at {', '.join(f'{time_s:.3g}' for time_s in row['dropped_s'])} s"
    values = (row[key] for key in ("moved_m", "tilted_rad", "max_squeeze_N", "max_contact_force_N"))
    moved, tilted, squeeze, force = (math.nan if value is None else value for value in values)
    return (
        f"'{row['name']}' ({row['mass_kg']:.3g} kg): moved by {1e3 * moved:.3g} mm, tilted by "
        f"{math.degrees(tilted):.2g} degrees{held}; squeezed with up to {squeeze:.3g} N, contact force "
        f"up to {force:.3g} N"
    )


def _span(span: dict[str, float | None]) -> str:
    end = span["until_s"]
    return f"from {span['since_s']:.3g} s to {'the end' if end is None else f'{end:.3g} s'}"
