"""The parser of the command line: commands, their options and help texts."""

import argparse
from pathlib import Path
from typing import Any

from cosim._version import __version__


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    made = argparse.ArgumentParser(
        prog="cosim",
        description="Cosimulation of rigid cobots with soft, cable-driven pneumatic end effectors.",
    )
    made.add_argument("--version", action="version", version=f"cosim {__version__}")
    commands = made.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_run(commands)
    listed = commands.add_parser(
        "list", help="list the scenarios and the questions they answer, the arms, or the soft robots"
    )
    kinds = ("scenarios", "arms", "soft_robots")
    listed.add_argument("kind", nargs="?", choices=kinds, default="scenarios")
    _add_view(commands)
    _add_files(commands)
    _add_pattern(commands)
    _add_errors(commands)
    _add_export(commands)
    _add_export_path(commands)
    _add_export_fmu(commands)
    _add_compare(commands)
    _add_twin(commands)
    _add_warm_up(commands)
    cached = commands.add_parser("cache", help="list the caches on disk: kernels, plans, section models")
    cached.add_argument("--clear", action="store_true", help="delete it; it is made again when it is needed")
    verify = commands.add_parser(
        "verify", help="check the soft model and the coupled tick against known answers"
    )
    verify.add_argument("cases", metavar="CASE", nargs="*", help="names of cases (default: all of them)")
    _add_trade(commands)
    _add_sweep(commands)
    _add_identify(commands)
    _add_design(commands)
    _add_replay(commands)
    for name in ("run", "warm-up", "check", "schema", "trade", "sweep"):
        known = "register custom kinds: a module, or a .py file; may be repeated"
        _add_list(commands.choices[name], "--import", "modules", "MODULE", known, action="append")
    return made


def _add_warm_up(commands: Any) -> None:
    warm_up = commands.add_parser("warm-up", help="compile what runs need, before the first one")
    warm_up.add_argument(
        "scenarios",
        metavar="SCENARIO",
        nargs="*",
        default=["ur5e_hexagon_arm"],
        help="names or paths (default: ur5e_hexagon_arm)",
    )


def _add_list(command: Any, option: str, into: str, metavar: str, meaning: str, **how: Any) -> None:
    """Add an option with a list of values, or one that can be repeated; the default is an empty list."""
    command.add_argument(option, dest=into, metavar=metavar, default=[], help=meaning, **how)


def _add_view(commands: Any) -> None:
    view = commands.add_parser("view", help="open the recording of a run")
    video = commands.add_parser("video", help="make a video of a recording; needs no display")
    for command in (view, video):
        command.add_argument("directory", metavar="DIR", type=Path, help="directory of a run, or a .rrd file")
    view.add_argument("--web", action="store_true", help="in a browser on this machine, until Ctrl-C")
    video.add_argument("out", metavar="OUT", type=Path, help="the video, such as run.mp4")
    video.add_argument("--view", metavar="NAME", help="only one view, such as Scene (default: all of them)")
    video.add_argument("--size", metavar="WxH", default="1600x900", help="of a frame (default: 1600x900)")
    video.add_argument("--fps", type=float, default=25.0, help="frames per second (default: 25)")
    video.add_argument(
        "--speed", type=float, default=1.0, help="simulated seconds per second of the video (default: 1)"
    )


def _add_identify(commands: Any) -> None:
    bench = commands.add_parser("identify", help="find a robot's values from measured curves")
    bench.add_argument("bench", metavar="BENCH", type=Path, help="path of a .toml file")
    bench.add_argument(
        "--out", metavar="DIR", type=Path, help="where to (default: runs/ and the file's name)"
    )
    bench.add_argument("--check", action="store_true", help="only print which values the data determine")
    bench.add_argument("--force", action="store_true", help="fit whatever the check says")


def _add_design(commands: Any) -> None:
    design = commands.add_parser("design", help="find a robot's values that make a quantity least in limits")
    design.add_argument("study", metavar="STUDY", type=Path, help="path of a .toml file")
    design.add_argument(
        "--out", metavar="DIR", type=Path, help="where to (default: runs/ and the file's name)"
    )
    design.add_argument("--unverified", action="store_true", help="without the refined mesh")
    design.add_argument(
        "--workers", metavar="N", type=int,
        help="processes for several choices and starts (default: one for each processor)",
    )  # fmt: skip


def _add_replay(commands: Any) -> None:
    replay = commands.add_parser("replay", help="run a policy on a finer model, and say what that changes")
    replay.add_argument(
        "policy", metavar="POLICY", help="module:function, an .onnx file, or .npz with weights and bias"
    )
    replay.add_argument(
        "--fidelity", required=True, choices=("section", "lumped", "refined"), help="the finer model"
    )
    replay.add_argument(
        "--against",
        default="section",
        choices=("rigid", "section", "lumped"),
        help="the model that the policy was made on (default: section)",
    )
    replay.add_argument(
        "--env", metavar="ID", default="cosim/TipReach-v0", help="of the environment (cosim/TipReach-v0)"
    )
    replay.add_argument("--episodes", metavar="N", type=int, default=10, help="on each model (default: 10)")
    replay.add_argument("--seed", type=int, default=0, help="of the goals (default: 0)")


def _add_errors(commands: Any) -> None:
    errors = commands.add_parser("errors", help="work out how far the figures of a finished run may be off")
    errors.add_argument("directory", metavar="DIR", type=Path, help="directory of a run")


def _add_export(commands: Any) -> None:
    export = commands.add_parser("export", help="write the record of a run for other programs")
    export.add_argument("directory", metavar="DIR", type=Path, help="directory of a run")
    export.add_argument("--csv", action="store_true", help="all curves as one table, arrays.csv")
    export.add_argument("--vtk", action="store_true", help="the deformed film, film.pvd and its .vtp files")
    export.add_argument("--plot", action="store_true", help="the usual curves, curves.png")
    export.add_argument("--bag", action="store_true", help="a ROS 2 bag of MCAP, for Foxglove too: bag/")
    export.add_argument("--usd", action="store_true", help="scene and film in time as USD, scene.usdc")
    times = "times of the film (default: all frames of the recording)"
    _add_list(export, "--at", "times_s", "SECONDS", times, type=float, nargs="+")
    export.add_argument("--out", metavar="DIR", type=Path, help="where to (default: the run's directory)")


def _add_export_path(commands: Any) -> None:
    path = commands.add_parser("export-path", help="write a motion for a robot's controller")
    source = "to plan: its name or .toml file; or the directory of a run"
    path.add_argument("scenario", metavar="SCENARIO|DIR", help=source)
    files = ".csv: a table; .script: URScript of servoj; .yaml: a JointTrajectory of ROS 2"
    path.add_argument("files", metavar="FILE", type=Path, nargs="+", help=files)
    default = "default: the only one with a tip path; of a run the whole of it"
    path.add_argument("--phase", metavar="NAME", help=f"which phase ({default})")
    path.add_argument("--whole", action="store_true", help="all phases of the scenario")
    path.add_argument(
        "--rate", metavar="HZ", type=float, default=500.0, help="rows per second (default: 500)"
    )
    _add_changes(path)


def _add_export_fmu(commands: Any) -> None:
    fmu = commands.add_parser("export-fmu", help="write a scenario as a co-simulation FMU (FMI 2)")
    fmu.add_argument("scenario", metavar="SCENARIO", help="name (see 'cosim list') or path of a .toml file")
    fmu.add_argument("out", metavar="OUT", type=Path, help="the file, such as arm.fmu")
    _add_changes(fmu)


def _add_compare(commands: Any) -> None:
    compare = commands.add_parser(
        "compare", help="replay the commands to a robot, and compare its measured motion"
    )
    compare.add_argument(
        "scenario", metavar="SCENARIO", help="name (see 'cosim list') or path of a .toml file"
    )
    compare.add_argument(
        "file", metavar="FILE", type=Path, help=".csv as export-path writes it, with measured columns"
    )
    compare.add_argument("--plot", metavar="FILE", type=Path, help="draw both: a .png file")
    _add_changes(compare)


def _add_twin(commands: Any) -> None:
    twin = commands.add_parser("twin", help="follow a robot while it moves, and show predictions")
    twin.add_argument("scenario", metavar="SCENARIO", help="name (see 'cosim list') or path of a .toml file")
    streams = (
        "rtde:HOST[:PORT], joints of a UR; or lines of JSON: tcp:HOST:PORT, file:PATH (a serial line too), "
        "- (standard input)"
    )
    twin.add_argument("streams", metavar="STREAM", nargs="+", help=streams)
    twin.add_argument("--out", metavar="FILE", type=Path, help="record it: a .rrd file")
    twin.add_argument("--live", action="store_true", help="show it in a viewer")
    twin.add_argument("--web", action="store_true", help="the same in a browser on this machine")
    _add_changes(twin)


def _add_changes(command: Any, meaning: str = "change a value of the scenario first") -> None:
    _add_list(command, "--set", "assignments", "KEY=VALUE", f"{meaning}; may be repeated", action="append")


def _add_files(commands: Any) -> None:
    new = commands.add_parser("new", help="write a starting scenario, and its schema for editors")
    new.add_argument(
        "name", metavar="NAME", nargs="?", help="of the scenario; it is written to NAME.toml, here"
    )
    new.add_argument(
        "--pattern",
        metavar="FILE",
        type=Path,
        help="a drawing (.dxf, .svg): write a soft robot cut from it as well",
    )
    _add_drawing(new)
    check = commands.add_parser(
        "check", help="check files without running anything: scenarios, robots, arms, studies"
    )
    check.add_argument(
        "files", metavar="FILE", nargs="+", help="path of a file, also of identify and design; or a scenario"
    )
    upgrade = commands.add_parser("upgrade", help="rewrite files of the schema number before, in place")
    upgrade.add_argument("files", metavar="FILE", nargs="+", help="path of a .toml file")
    schema = commands.add_parser("schema", help="print the JSON Schema of scenario, robot or arm files")
    schema.add_argument("kind", nargs="?", choices=("scenario", "robot", "arm"), default="scenario")


def _add_drawing(command: Any) -> None:
    command.add_argument("--unit", choices=("mm", "cm", "m", "in"), help="of a drawing that states none")
    command.add_argument("--sealed", action="store_true", help="all edges of the sheets are welded")


def _add_pattern(commands: Any) -> None:
    pattern = commands.add_parser("pattern", help="look at cut patterns of soft robots, and write them")
    actions = pattern.add_subparsers(dest="action", required=True, metavar="ACTION")
    check = actions.add_parser("check", help="describe a drawing as cosim reads it, or list its errors")
    check.add_argument("file", metavar="FILE", help="a drawing (.dxf, .svg), or a soft robot's name or file")
    check.add_argument("--png", metavar="PNG", type=Path, help="draw it as well")
    _add_drawing(check)
    export = actions.add_parser(
        "export", help="write the flat cut pattern of a soft robot, with true lengths"
    )
    export.add_argument("robot", metavar="ROBOT", help="a soft robot's name or file")
    export.add_argument("out", metavar="OUT", type=Path, help="the file, such as finger.dxf")


def _add_run(commands: Any) -> None:
    run = commands.add_parser("run", help="run a scenario")
    run.add_argument(
        "scenario", metavar="SCENARIO", nargs="?", help="name (see 'cosim list') or path of a .toml file"
    )
    _add_changes(run, "change a value, such as mode=quasistatic or phase.inflate.pressure_Pa=20e3")
    run.add_argument("--out", metavar="DIR", type=Path, help="directory of the results (default: runs/...)")
    run.add_argument("--resume", metavar="DIR", type=Path, help="resume the interrupted run in DIR")
    run.add_argument(
        "--checkpoint-every",
        metavar="SECONDS",
        type=float,
        help="wall time between two checkpoints that a run can be resumed from (default: 30)",
    )
    run.add_argument("--live", action="store_true", help="show the run in a viewer while it lasts")
    run.add_argument(
        "--web", action="store_true", help="the same in a browser on this machine, until Ctrl-C after the run"
    )
    run.add_argument("--no-recording", action="store_true", help="write no recording.rrd")
    run.add_argument("--quiet", action="store_true", help="show errors, and one line at the end")
    run.add_argument(
        "--error",
        action=argparse.BooleanOptionalAction,
        help="work out how far the figures may be off: at every phase end, or nowhere; by default where it "
        "costs little of the run",
    )


def _add_sweep(commands: Any) -> None:
    sweep = commands.add_parser("sweep", help="run the designs of a study and gather them in one table")
    sweep.add_argument("study", metavar="STUDY", type=Path, help="path of a .toml file")
    sweep.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="directory of the results (default: runs/STUDY); designs that are done there are not run again",
    )
    sweep.add_argument(
        "--engine",
        default="processes",
        help="'processes' of this machine (default), or the address of a Dask scheduler: tcp://HOST:PORT",
    )
    sweep.add_argument(
        "--workers", metavar="N", type=int, help="processes of this machine (default: one for each processor)"
    )
    drawn = "draw columns of the table: the first along x, the others along y"
    _add_list(sweep, "--plot", "columns", "COLUMN", drawn, nargs="+")
    sweep.add_argument("--quiet", action="store_true", help="show errors only")


def _add_trade(commands: Any) -> None:
    trade = commands.add_parser("trade", help="measure a scenario's speed against its accuracy")
    trade.add_argument("scenario", metavar="SCENARIO", help="name (see 'cosim list') or path of a .toml file")
    trade.add_argument("--out", metavar="DIR", type=Path, help="directory of the results (default: runs/...)")
    _add_changes(trade)
    requirement = trade.add_mutually_exclusive_group()
    requirement.add_argument(
        "--budget", metavar="FACTOR", help="pick the most accurate candidate that fast: 1.0x"
    )
    requirement.add_argument(
        "--tolerance", metavar="LENGTH", help="pick the fastest candidate as near as this: 1mm"
    )
    trade.add_argument(
        "--force-tolerance", metavar="FORCE", help="and as near in the flange force's mean over 40 ms: 0.1N"
    )
    trade.add_argument(
        "--against",
        choices=("finest", "refined"),
        default="finest",
        help="reference of the errors: its mesh at the finest tick, or a wrinkling film, refined",
    )
    trade.add_argument("--quick", action="store_true", help="fewer candidates, none with a refined mesh")
    trade.add_argument(
        "--slowest",
        metavar="FACTOR",
        default="0.05x",
        help="stop candidates slower than this (default: 0.05x)",
    )
    trade.add_argument("--scale-time", type=float, default=1.0, help="factor on the phases' durations")
