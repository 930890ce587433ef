"""A policy in ONNX acts as its file describes the network; the file is put together here, byte by byte."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from cosim.errors import InputError
from cosim.gym.policy import policy_of

WEIGHTS = np.random.default_rng(3).normal(size=(3, 2)).astype(np.float32)
FLOAT, DOUBLE = 1, 11


def size_of(value: int) -> bytes:
    """Return a whole number as protobuf has it: seven bits a byte, the lowest first."""
    found = b""
    while value > 127:
        found, value = found + bytes([value & 127 | 128]), value >> 7
    return found + bytes([value])


def number(field: int, value: int) -> bytes:
    """Return a whole number as a field of a message."""
    return bytes([field << 3]) + size_of(value)


def part(field: int, *contents: bytes | str) -> bytes:
    """Return bytes, a text, or a message within a message, as a field."""
    joined = b"".join(one.encode() if isinstance(one, str) else one for one in contents)
    return bytes([field << 3 | 2]) + size_of(len(joined)) + joined


def node(kind: str, output: str, *inputs: str) -> bytes:
    return part(1, *(part(1, name) for name in inputs), part(2, output), part(4, kind))


def row(field: int, name: str, size: int, kind: int) -> bytes:
    """Return an input or output of (1, size) numbers."""
    shape = part(2, part(1, number(1, 1)), part(1, number(1, size)))
    return part(field, part(1, name), part(2, part(1, number(1, kind), shape)))


def written(path: Path, *, kind: int = FLOAT, achieved: str = "achieved_goal") -> str:
    """Write the network a = tanh((desired - achieved) W)."""
    raw = WEIGHTS.astype(np.float32 if kind == FLOAT else np.float64).tobytes()
    initial = part(5, number(1, 3), number(1, 2), number(2, kind), part(8, "W"), part(9, raw))
    graph = part(
        7, node("Sub", "away", "desired_goal", achieved), node("MatMul", "sum", "away", "W"),
        node("Tanh", "action", "sum"), part(2, "policy"), initial, row(11, "desired_goal", 3, kind),
        row(11, achieved, 3, kind), row(12, "action", 2, kind),
    )  # fmt: skip
    path.write_bytes(number(1, 8) + graph + part(8, number(2, 13)))
    return str(path)


@pytest.mark.parametrize("kind", [FLOAT, DOUBLE])
def test_the_action_is_that_of_the_network(tmp_path: Path, kind: int) -> None:
    pytest.importorskip("onnxruntime")
    policy = policy_of(written(tmp_path / "policy.onnx", kind=kind))
    random = np.random.default_rng(1)
    for _ in range(5):
        seen = {"observation": random.normal(size=8)}
        seen |= {name: random.normal(size=3) for name in ("achieved_goal", "desired_goal")}
        action = policy(seen)
        assert action.shape == (2,)
        wanted = np.tanh((seen["desired_goal"] - seen["achieved_goal"]) @ WEIGHTS)
        np.testing.assert_allclose(action, wanted, atol=1e-5)


def test_what_is_no_policy_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("onnxruntime")
    (tmp_path / "broken.onnx").write_bytes(b"no network")
    with pytest.raises(InputError, match=r"broken.onnx': cannot be read as ONNX"):
        policy_of(str(tmp_path / "broken.onnx"))
    with pytest.raises(
        InputError, match="its inputs are desired_goal, here; an environment has observation, achieved"
    ):
        policy_of(written(tmp_path / "other.onnx", achieved="here"))
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(InputError, match=r"this needs onnxruntime: pip install 'cosim\[onnx\]'"):
        policy_of(str(tmp_path / "other.onnx"))
