"""What `import cosim` offers, as autodoc's directives; the errors are on a page of their own."""

from __future__ import annotations

import inspect
from collections.abc import Iterable

import cosim
from cosim import errors


def public_names() -> str:
    """Return directives for every public name that is not an error; functions first."""
    found = {name: getattr(cosim, name) for name in cosim.__all__ if not name.startswith("_")}
    listed = sorted(
        (inspect.isclass(what), name) for name, what in found.items() if not hasattr(errors, name)
    )
    kinds = {True: "autoclass", False: "autofunction"}
    return _directives((kinds[is_class], f"cosim.{name}") for is_class, name in listed)


def public_errors() -> str:
    """Return directives for every error, in the order of its module."""
    names = (name for name, what in vars(errors).items() if inspect.isclass(what) and name in cosim.__all__)
    return _directives(("autoexception", f"cosim.{name}") for name in names)


def _directives(listed: Iterable[tuple[str, str]]) -> str:
    members = {"autofunction": ""}
    lines = [f".. {what}:: {name}\n{members.get(what, '   :members:')}\n" for what, name in listed]
    return "\n".join(["```{eval-rst}", *lines, "```"])
