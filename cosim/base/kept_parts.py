"""Caches the built parts of simulations in memory: films, plans, section models. The name of a part is a hash
of all values that it is built from, so a simulation of equal values gets the part that was built before.
"""

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar, cast, final
from uuid import uuid4

from cosim.base.files import files_read, note_read
from cosim.base.identity import content_name

Kind = TypeVar("Kind")

_MOST: Final = 8  # of each kind
_NAMELESS: Final = "nameless "


@final
class KeptParts:
    """A cache of built parts, with the few of each kind that were used last.

    A part in the cache must not be changed. Its name depends on every value that it is built from, so a part
    from the cache is bit-identical to a new one. Use it from one thread at a time.

    Args:
        on_disk: whether `lasting` parts are also written to the cache on disk, for other processes.
    """

    def __init__(self, *, on_disk: bool = False) -> None:
        self.on_disk = on_disk
        self._kinds: dict[str, dict[str, tuple[Any, dict[str, str]]]] = {}  # with the files that were read

    def made(self, kind: str, name: str, make: Callable[[], Kind], most: int = _MOST) -> Kind:
        """Return the part of a name; it is built if the cache does not have it.

        Args:
            kind: of part.
            name: of the values that it is built from, see `name_of`.
            make: builds the part; if it raises, nothing is added to the cache.
            most: how many parts of the kind remain in the cache, those that were used last.
        """
        parts = self._kinds.setdefault(kind, {})
        if name in parts:
            part, files = parts.pop(name)
            note_read(files)
        else:
            with files_read() as files:
                part = make()
        parts[name] = part, files
        if len(parts) > most:
            del parts[next(iter(parts))]
        return cast(Kind, part)

    def lasting(self, kind: str, name: str, part: type[Kind], make: Callable[[], Kind]) -> Kind:
        """Return the part of a name, which is also on disk for other processes, unless its name is random.

        It is valid for the same program on the same kind of processor.

        Args:
            kind: of part.
            name: of the values that it is built from, and of the files that these were read from.
            part: class of the part, a record that a file can hold.
            make: builds the part.
        """
        if not self.on_disk or name.startswith(_NAMELESS):
            return self.made(kind, name, make)
        # imported here because it takes long to load
        from cosim.base import caches, kernel_cache, state_file
        from cosim.base.identity import code_identity

        file = content_name(kind, name, code_identity(), kernel_cache.processor())
        return self.made(kind, name, partial(state_file.load_or_make, caches.PLANS, file, part, make))

    def forget(self, kind: str, name: str) -> None:
        """Remove a part from the cache, after a value that it was built from has changed.

        Args:
            kind: of the part.
            name: of the part, see `name_of`; it need not be in the cache.
        """
        self._kinds.get(kind, {}).pop(name, None)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as an empty cache with the same settings."""
        return partial(KeptParts, on_disk=self.on_disk), ()


def name_of(*contents: Any) -> str:
    """Return a name of the values that a part is built from, see `content_name`.

    If one of them has no known content, such as an object of a user's class, the name is a random one, so
    that the part is never found again.

    Args:
        contents: values; the name of another part represents the values of that part.
    """
    if any(isinstance(part, str) and part.startswith(_NAMELESS) for part in contents):
        return nameless()
    try:
        return content_name(*contents)
    except TypeError:
        return nameless()


def nameless() -> str:
    """Return a random name, for a part that is built from values of unknown content."""
    return _NAMELESS + uuid4().hex


def stamps(files: Iterable[Path]) -> tuple[tuple[str, int, int], ...]:
    """Return name, size [bytes] and time of the last change [ns] of each file; -1 for a missing file."""
    entries = []
    for path in files:
        try:
            status = path.stat()
        except OSError:
            entries.append((str(path), -1, -1))
        else:
            entries.append((str(path), status.st_size, status.st_mtime_ns))
    return tuple(entries)
