"""Caches parts of simulations in memory, under names of everything that they were made from."""

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
    """Holds the parts that were made or taken last, a few of each kind.

    Nobody changes a part that is in here. Its name holds everything that making it depends on, so a part that
    is taken is bit-identical to the one that would be made. Not for several threads at once.

    Args:
        on_disk: whether plans are kept for other processes as well.
    """

    def __init__(self, *, on_disk: bool = False) -> None:
        self.on_disk = on_disk
        self._kinds: dict[str, dict[str, tuple[Any, dict[str, str]]]] = {}  # with the files that were read

    def made(self, kind: str, name: str, make: Callable[[], Kind], most: int = _MOST) -> Kind:
        """Return the part of a name, which is made if it is not there.

        Args:
            kind: of part.
            name: of its ingredients, see `name_of`.
            make: makes it; where it raises, nothing is kept.
            most: how many of the kind are kept, those that were made or taken last.
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

    def forget(self, kind: str, name: str) -> None:
        """Let a part go whose ingredients have changed.

        Args:
            kind: of the part.
            name: of the part, see `name_of`; it need not be there.
        """
        self._kinds[kind].pop(name, None)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to make it in another process: with nothing in it."""
        return partial(KeptParts, on_disk=self.on_disk), ()


def name_of(*contents: Any) -> str:
    """Return a name of contents, see `content_name`; one that nothing else has where they cannot be named.

    Args:
        contents: of a part; a name among them represents the contents of another part.
    """
    if any(isinstance(part, str) and part.startswith(_NAMELESS) for part in contents):
        return nameless()
    try:
        return content_name(*contents)
    except TypeError:
        return nameless()


def is_nameless(name: str) -> bool:
    """Return whether a name is of contents that are not known."""
    return name.startswith(_NAMELESS)


def nameless() -> str:
    """Return a name that nothing else has, for what is made of contents that are not known."""
    return _NAMELESS + uuid4().hex


def stamps(files: Iterable[Path]) -> tuple[tuple[str, int, int], ...]:
    """Return name, size and time of the last change of files: other contents have other stamps."""
    found = []
    for path in files:
        try:
            status = path.stat()
        except OSError:
            found.append((str(path), -1, -1))
        else:
            found.append((str(path), status.st_size, status.st_mtime_ns))
    return tuple(found)
