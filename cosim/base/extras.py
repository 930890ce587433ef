"""Libraries that come with an optional extra of the package, loaded where they are used."""

from __future__ import annotations

import importlib
from typing import Any

from cosim.errors import InputError


def extra_module(name: str, extra: str) -> Any:
    """Return a module of a library that is part of an extra.

    Args:
        name: of the module.
        extra: that installs it, such as "pattern".

    Raises:
        InputError: it is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        library = name.partition(".")[0]
        raise InputError(f"this needs {library}: pip install 'cosim[{extra}]'") from None
