"""Names of parts without one of their own, and what docstrings say of fields.

Names that files and results give to parts without their own name.

What docstrings say of a class's fields: schemas and files repeat it, so that every text stands once.
"""

import inspect
import re
from typing import Final

ONLY_CHAMBER: Final = "chamber"
"""Name of the chamber of a body that has only one."""


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
