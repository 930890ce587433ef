"""Gives refusals of the sides, which know no keys, the path of the key that they are about."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from cosim.errors import InputError, ScenarioError


@contextmanager
def blamed_on(path: str) -> Iterator[None]:
    """Turn every refusal within into one that names a key; those that name one already stay.

    Args:
        path: of the key.

    Raises:
        ScenarioError: instead of any other InputError.
    """
    try:
        yield
    except ScenarioError:
        raise
    except InputError as error:
        raise ScenarioError(path, str(error)) from error
