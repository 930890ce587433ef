"""The deformed film as VTK files: triangles of the film and cables as lines, one PolyData file per time; a
`.pvd` file lists them, which ParaView and PyVista open as an animation.
"""

import base64
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from cosim.base import whole_files, writing
from cosim.base.frames import Array, IntArray
from cosim.errors import InputError
from cosim.results.result import RunResult

COLLECTION: Final = "film.pvd"
_HEAD: Final = '<?xml version="1.0"?>\n<VTKFile type="{}" version="1.0" byte_order="LittleEndian"{}>\n'
_TYPES: Final = {"f": "Float64", "i": "Int64"}


def write_film(
    result: RunResult, folder: Path, times_s: Sequence[float] = (), claim: Callable[[str], object] = str
) -> list[Path]:
    """Write the film at some times and the list of its files; return the paths, that of the list first.

    Points have their displacement [m] since the first frame.

    Args:
        result: of a run.
        folder: for the files.
        times_s: the nearest frame to each is written; empty: all frames.
        claim: called with the name of each file before it is written.

    Raises:
        InputError: there is no film, no frame, or no such time.
        OutputError: a file cannot be written.
    """
    frames = _frames(result, times_s)
    names = [f"film-{number:04d}.vtp" for number in range(len(frames))]
    texts = [_poly_data(result, frame) for frame in frames]
    times = result.frame_time_s[frames].tolist()
    rows = [
        f'    <DataSet timestep="{time_s!r}" part="0" file={quoteattr(name)}/>\n'
        for time_s, name in zip(times, names, strict=True)
    ]
    head = _HEAD.format("Collection", "")
    listed = f"{head}  <Collection>\n{''.join(rows)}  </Collection>\n</VTKFile>\n"
    for name, text in zip((*names, COLLECTION), (*texts, listed), strict=True):
        claim(name)
        with writing.writing(folder / name):
            whole_files.write_whole(folder / name, text)
    return [folder / COLLECTION, *(folder / name for name in names)]


def _frames(result: RunResult, times_s: Sequence[float]) -> IntArray:
    """Return the indices of the frames to write.

    Raises:
        InputError: see `write_film`.
    """
    if not len(result.frame_time_s) or not len(result.stage.soft_triangles):
        raise InputError(f"{result.stage.scenario}: there is no frame of a film to write")
    if not len(times_s):
        return np.arange(len(result.frame_time_s))
    first, last = result.time_s[[0, -1]].tolist()
    for time_s in times_s:
        if not first <= time_s <= last:
            raise InputError(f"--at {time_s:g}: the run has the times {first:g} to {last:g} s")
    gaps = np.abs(result.frame_time_s[None] - np.array(times_s)[:, None])
    return np.unique(np.argmin(gaps, axis=1))


def _poly_data(result: RunResult, frame: int) -> str:
    nodes, cables = result.node_position[frame], result.stage.cables
    lines = list(_cells("Lines", np.concatenate([*cables, np.zeros(0, int)]), list(map(len, cables))))
    triangles = result.stage.soft_triangles
    polys = list(_cells("Polys", triangles.ravel(), [3] * len(triangles)))
    moved = nodes - result.node_position[0]
    pieces = [
        f'    <Piece NumberOfPoints="{len(nodes)}" NumberOfVerts="0" NumberOfLines="{len(cables)}" '
        f'NumberOfStrips="0" NumberOfPolys="{len(triangles)}">\n',
        "      <PointData>\n", _data("displacement_m", moved), "      </PointData>\n",
        "      <Points>\n", _data("position_m", nodes), "      </Points>\n", *lines, *polys, "    </Piece>\n",
    ]  # fmt: skip
    head = _HEAD.format("PolyData", ' header_type="UInt64"')
    return head + "  <PolyData>\n" + "".join(pieces) + "  </PolyData>\n</VTKFile>\n"


def _cells(kind: str, nodes: IntArray, sizes: Sequence[int]) -> Iterator[str]:
    yield f"      <{kind}>\n"
    yield _data("connectivity", nodes.astype(np.int64))
    yield _data("offsets", np.cumsum(np.array(sizes, np.int64)))
    yield f"      </{kind}>\n"


def _data(name: str, values: Array | IntArray | NDArray[Any]) -> str:
    """Return an array in VTK's format: its length in bytes, then its numbers, both in base 64."""
    data = np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<")).tobytes()
    attributes: Mapping[str, object] = {
        "type": _TYPES[values.dtype.kind],
        "Name": name,
        "NumberOfComponents": values.shape[1] if values.ndim > 1 else 1,
        "format": "binary",
    }
    text = " ".join(f"{key}={quoteattr(str(value))}" for key, value in attributes.items())
    content = base64.b64encode(len(data).to_bytes(8, "little") + data).decode()
    return f"        <DataArray {text}>{content}</DataArray>\n"
