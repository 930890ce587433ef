"""Raises an `OutputError` that names the file for files that cannot be written. It is apart from
`cosim.base.whole_files`, which the cache of kernels uses, to keep chains of imports short.
"""

from collections.abc import Iterator
from contextlib import contextmanager

from cosim.errors import OutputError


@contextmanager
def writing(path: object) -> Iterator[None]:
    """Convert an OSError of the block to an OutputError that names the file.

    Raises:
        OutputError: the block raised an OSError.
    """
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
