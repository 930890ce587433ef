"""Former names forward to the new ones for one release, with a warning."""

from __future__ import annotations

import pytest

from cosim.telemetry import run_info, snapshot
from tests.conftest import made_up_snapshot


def test_run_info_is_forwarded_from_its_former_module() -> None:
    with pytest.warns(DeprecationWarning, match=r"import RunInfo from cosim\.telemetry\.run_info"):
        assert snapshot.RunInfo is run_info.RunInfo
    with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
        _ = snapshot.Nothing


def test_the_former_name_of_stability_warns() -> None:
    with pytest.warns(DeprecationWarning, match="is Snapshot.stability now"):
        assert made_up_snapshot(1, 0.01).footing is None
