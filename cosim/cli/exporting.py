"""The command `cosim export`: writes the results of a run for other programs: CSV, VTK, a plot, a ROS 2 bag,
USD.
"""

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Final

from cosim.app.ended_run import load_run
from cosim.app.output_directory import OutputDirectory
from cosim.app.run_files import SCENARIO
from cosim.base import kept_parts, writing
from cosim.cli.screen import printable
from cosim.config import loading
from cosim.config.schema.scenario import NO_ARM
from cosim.errors import InputError
from cosim.results import csv_table, ros_bag, usd, vtk
from cosim.results.plots import figure_kind
from cosim.results.result import RunResult

CSV: Final = "arrays.csv"
PLOT: Final = "curves.png"


def export_command(
    directory: Path, out: Path | None, wanted: Collection[str], times_s: Sequence[float] = ()
) -> None:
    """Write files of a run for other programs, and print their paths.

    Args:
        directory: of the run.
        out: directory of the files; None for that of the run.
        wanted: names in `EXPORTS`.
        times_s: times of the film [s]; empty for all frames.

    Raises:
        InputError: there is no such run or time, or `wanted` is empty.
        OutputError: a file cannot be written.
    """
    if not wanted:
        raise InputError(f"export: say what to write: --{', --'.join(EXPORTS)}, or several of them")
    if times_s and "vtk" not in wanted:
        raise InputError("--at: chooses times of the film; give --vtk as well")
    if "plot" in wanted:
        figure_kind()
    if "bag" in wanted:
        ros_bag.check_bags()
    if "usd" in wanted:
        usd.check_usd()
    result = load_run(directory)
    with OutputDirectory(directory if out is None else out) as target:
        target.make()
        for kind in EXPORTS:
            if kind in wanted:
                path, more = EXPORTS[kind](result, target, times_s)
                print(printable(f"{path}{more}"))


def _export_csv(result: RunResult, target: OutputDirectory, _: Sequence[float]) -> tuple[Path, str]:
    target.claim(CSV)
    csv_table.write_csv(result, target.path / CSV)
    return target.path / CSV, ""


def _export_plot(result: RunResult, target: OutputDirectory, _: Sequence[float]) -> tuple[Path, str]:
    target.claim(PLOT)
    with writing.writing(target.path / PLOT):
        result.plot().savefig(target.path / PLOT, dpi=110)
    return target.path / PLOT, ""


def _export_film(result: RunResult, target: OutputDirectory, times_s: Sequence[float]) -> tuple[Path, str]:
    written = vtk.write_film(result, target.path, times_s, target.claim)
    return target.path / vtk.COLLECTION, f", {len(written) - 1} times; open it in ParaView"


def _export_bag(result: RunResult, target: OutputDirectory, _: Sequence[float]) -> tuple[Path, str]:
    target.claim(ros_bag.BAG)
    messages = ros_bag.write_bag(result, target.path / ros_bag.BAG)
    return target.path / ros_bag.BAG, f", {messages} messages; ros2 bag play, or open its .mcap in Foxglove"


def _export_usd(result: RunResult, target: OutputDirectory, _: Sequence[float]) -> tuple[Path, str]:
    from cosim.build.arm_parts import ArmParts  # here: it brings both engines

    target.claim(usd.USD)
    assert result.directory is not None, "it was loaded from there"
    scenario = loading.load_scenario(result.directory / SCENARIO)
    shapes = () if scenario.robot == NO_ARM else ArmParts(scenario, kept_parts.KeptParts()).scene.shapes
    times = usd.write_usd(result, shapes, target.path / usd.USD)
    return target.path / usd.USD, f", {times} times; open it in usdview, Blender or Omniverse"


EXPORTS: Final = {
    "csv": _export_csv, "vtk": _export_film, "plot": _export_plot, "bag": _export_bag, "usd": _export_usd,
}  # fmt: skip
"""The writer of each option of `cosim export`."""
