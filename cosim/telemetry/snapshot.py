"""Forwards `RunInfo` to its new module, for one release."""

import warnings
from typing import Any

from cosim.telemetry import run_info


def __getattr__(name: str) -> Any:
    """Return `RunInfo`, which moved to `cosim.telemetry.run_info`, with a warning."""
    if name != "RunInfo":
        raise AttributeError(f"module {__name__} has no attribute {name!r}")
    warnings.warn(
        f"import {name} from {run_info.__name__}; {__name__} will not exist in the next release",
        DeprecationWarning,
        stacklevel=2,
    )
    return run_info.RunInfo
