"""What program computed something: two programs that differ here need not agree bit for bit."""

from __future__ import annotations

import platform
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from cosim._version import __version__

_ENGINES = ("numpy", "scipy", "numba", "mujoco", "pin")


@cache
def code_identity() -> dict[str, str]:
    """Return versions of cosim, its engines, Python and processor family, and a hash of cosim's source."""
    digest = sha256()
    folder = Path(__file__).resolve().parents[2]
    for path in sorted(folder.rglob("*.py")):
        digest.update(str(path.relative_to(folder)).encode())
        digest.update(path.read_bytes())
    return {
        "cosim": __version__,
        "source": digest.hexdigest()[:16],
        **{name: _version(name) for name in _ENGINES},
        "python": platform.python_version(),
        "processor": platform.machine(),
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"
