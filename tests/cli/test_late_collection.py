"""Garbage is looked for again from the first ticks on, and as before at the end."""

from __future__ import annotations

import gc

import pytest

from cosim.cli.late_collection import LateCollection
from cosim.errors import InputError


def test_it_begins_with_the_first_ticks() -> None:
    assert gc.isenabled()
    with LateCollection() as late:
        late.open(None)
        assert not gc.isenabled()
        before = gc.get_freeze_count()
        late.observe(None)
        assert gc.isenabled()
        assert gc.get_freeze_count() > before  # what was made before is not looked at again
        late.close()
    assert not gc.get_freeze_count()
    with pytest.raises(InputError), LateCollection():
        raise InputError("before the first ticks")
    assert gc.isenabled()


def test_where_nobody_collects_nobody_begins_to() -> None:
    gc.disable()
    try:
        with LateCollection() as late:
            late.observe(None)
        assert not gc.isenabled()
    finally:
        gc.enable()
