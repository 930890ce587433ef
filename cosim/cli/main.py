"""The command line: `cosim run`, `cosim list`, `cosim view`, `cosim new`, `cosim check`, `cosim upgrade`,
`cosim schema`, `cosim verify`, `cosim trade`.

Exit codes: 0 done, 1 the physics could not be solved or verified, 2 wrong input, 3 results could not be
written, 128 + n stopped by signal n (141: nobody read standard output any more).
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cosim._version import __version__
from cosim.cli.screen import mute, open_missing_streams, printable, tell
from cosim.errors import InputError, OutputError, SolverError

EXIT_DONE, EXIT_UNSOLVED, EXIT_INPUT, EXIT_UNWRITTEN, EXIT_INTERRUPTED, EXIT_UNREAD = 0, 1, 2, 3, 130, 141


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    started = time.perf_counter()
    # before numpy is imported: threads only slow the small dense algebra of a run down
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    open_missing_streams()
    options = _parser().parse_args(arguments)
    try:
        return _flushed(_command(options, started))
    except InputError as error:
        for line in str(error).split("\n"):
            tell(f"cosim: error: {line}")
        return EXIT_INPUT
    except SolverError as error:
        tell(f"cosim: not solved: {error}")
        return EXIT_UNSOLVED
    except BrokenPipeError:  # whoever read standard output has seen enough
        mute(sys.stdout)
        return EXIT_UNREAD
    except (OutputError, OSError) as error:
        mute(sys.stdout)
        tell(f"cosim: error: {error}")
        return EXIT_UNWRITTEN
    except KeyboardInterrupt:
        tell("cosim: interrupted")
        return EXIT_INTERRUPTED


def _flushed(code: int) -> int:
    """Return an exit code once all that was printed is out.

    Raises:
        OSError: it cannot be written.
    """
    sys.stdout.flush()
    return code


def _command(options: argparse.Namespace, started: float) -> int:
    _import_kinds(vars(options).get("modules", ()))
    if options.command == "run":
        return _run(options, started)
    if options.command == "verify":
        return _verify(options)
    if options.command == "trade":
        return _trade(options)
    if options.command in ("new", "check", "upgrade", "schema"):
        return _files(options)
    return _list(options.kind) if options.command == "list" else _view(options.directory)


def _import_kinds(modules: Sequence[str]) -> None:
    if modules:
        from cosim.config.kinds import register_module  # here, because it loads pydantic

        for name in modules:
            register_module(name)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="cosim",
        description="Cosimulation of rigid cobots with soft, cable-driven pneumatic end effectors.",
    )
    parser.add_argument("--version", action="version", version=f"cosim {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_run(commands)
    listed = commands.add_parser("list", help="list the scenarios and the questions they answer, or the arms")
    listed.add_argument("kind", nargs="?", choices=("scenarios", "arms"), default="scenarios")
    view = commands.add_parser("view", help="open the recording of a run")
    view.add_argument("directory", metavar="DIR", type=Path, help="directory of a run, or a .rrd file")
    _add_files(commands)
    verify = commands.add_parser("verify", help="check the soft model against known answers")
    verify.add_argument("cases", metavar="CASE", nargs="*", help="names of cases (default: all of them)")
    verify.add_argument("--json", metavar="FILE", type=Path, help="write the results to a file as well")
    verify.add_argument("--list", action="store_true", help="list the cases and the sources of their answers")
    _add_trade(commands)
    for name in ("run", "check", "schema", "trade"):
        commands.choices[name].add_argument(
            "--import",
            dest="modules",
            metavar="MODULE",
            action="append",
            default=[],
            help="make kinds of your own known: a module, or a .py file; may be repeated",
        )
    return parser


def _add_files(commands: Any) -> None:
    new = commands.add_parser("new", help="write a starting scenario, and its schema for editors")
    new.add_argument("name", metavar="NAME", help="of the scenario; it is written to NAME.toml, here")
    check = commands.add_parser("check", help="check scenario, robot and arm files without running anything")
    check.add_argument("files", metavar="FILE", nargs="+", help="path of a file, or name of a scenario")
    upgrade = commands.add_parser("upgrade", help="rewrite files of the schema number before, in place")
    upgrade.add_argument("files", metavar="FILE", nargs="+", help="path of a .toml file")
    schema = commands.add_parser("schema", help="print the JSON Schema of scenario, robot or arm files")
    schema.add_argument("kind", nargs="?", choices=("scenario", "robot", "arm"), default="scenario")


def _add_run(commands: Any) -> None:
    run = commands.add_parser("run", help="run a scenario")
    run.add_argument(
        "scenario", metavar="SCENARIO", nargs="?", help="name (see 'cosim list') or path of a .toml file"
    )
    run.add_argument(
        "--set",
        dest="assignments",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="change a value, such as mode=quasistatic or phase.inflate.pressure_Pa=20e3; may be repeated",
    )
    run.add_argument("--out", metavar="DIR", type=Path, help="directory of the results (default: runs/...)")
    run.add_argument("--resume", metavar="DIR", type=Path, help="go on with the interrupted run in DIR")
    run.add_argument(
        "--checkpoint-every",
        metavar="SECONDS",
        type=float,
        default=30.0,
        help="wall time between two checkpoints that a run can be resumed from (default: 30)",
    )
    run.add_argument("--no-recording", action="store_true", help="write no recording.rrd")
    run.add_argument("--quiet", action="store_true", help="show errors only")


def _add_trade(commands: Any) -> None:
    trade = commands.add_parser("trade", help="measure a scenario's speed against its accuracy")
    trade.add_argument("scenario", metavar="SCENARIO", help="name (see 'cosim list') or path of a .toml file")
    trade.add_argument("--out", metavar="DIR", type=Path, help="directory of the results (default: runs/...)")
    trade.add_argument(
        "--set",
        dest="assignments",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="change a value of the scenario first; may be repeated",
    )
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
        help="what a choice is measured against: its mesh at the finest tick, or a wrinkling film, refined",
    )
    trade.add_argument("--quick", action="store_true", help="fewer candidates, none with a refined mesh")
    trade.add_argument(
        "--slowest",
        metavar="FACTOR",
        default="0.05x",
        help="stop candidates slower than this (default: 0.05x)",
    )
    trade.add_argument("--scale-time", type=float, default=1.0, help="factor on the phases' durations")


def _run(options: argparse.Namespace, started: float) -> int:
    from cosim.cli.running import RunOptions, resume_command, run_command  # --help and list need no engine

    every_s = options.checkpoint_every
    if not every_s > 0.0:
        raise InputError(
            f"--checkpoint-every {every_s}: must be above 0; inf writes none but at an early end"
        )
    how = RunOptions(not options.no_recording, options.quiet, every_s, started)
    if options.resume is None:
        if options.scenario is None:
            raise InputError("run: no SCENARIO given; see 'cosim list', or go on with a run: --resume DIR")
        return run_command(options.scenario, options.assignments, options.out, how)
    if options.scenario is not None or options.assignments or options.out is not None:
        raise InputError(
            f"--resume {options.resume}: goes on with the scenario of that directory, there; "
            "give no SCENARIO, no --set and no --out"
        )
    return resume_command(options.resume, how)


def _verify(options: argparse.Namespace) -> int:
    from cosim.cli.verify import list_command, verify_command  # here, because it loads the kernels

    return list_command() if options.list else verify_command(options.cases, options.json)


def _trade(options: argparse.Namespace) -> int:
    from cosim.app.run_files import default_directory
    from cosim.cli.trade import trade_command  # here, because it loads the kernels

    return trade_command(
        options.scenario,
        options.out or default_directory(f"trade_{Path(options.scenario).stem}"),
        budget=options.budget,
        tolerance=options.tolerance,
        force_tolerance=options.force_tolerance,
        assignments=options.assignments,
        truth=options.against,
        quick=options.quick,
        time_scale=options.scale_time,
        slowest=options.slowest,
    )


def _files(options: argparse.Namespace) -> int:
    from cosim.cli import files  # here, because it loads pydantic

    if options.command == "new":
        files.new_command(options.name)
        return EXIT_DONE
    if options.command == "schema":
        print(files.schema_text(options.kind), end="")
        return EXIT_DONE
    command = files.check_command if options.command == "check" else files.upgrade_command
    return EXIT_DONE if command(options.files) else EXIT_INPUT


def _list(kind: str) -> int:
    if kind == "arms":
        from cosim.cli.files import arm_lines  # here, because it loads pydantic

        for line in arm_lines():
            print(printable(line))
        return EXIT_DONE
    from cosim.base.resources import list_scenarios, question, scenario_path

    names = list_scenarios()
    width = max(map(len, names), default=0)
    for name in names:
        print(printable(f"{name:<{width}}  {question(scenario_path(name))}"))
    return EXIT_DONE


def _view(directory: Path) -> int:
    from cosim.app.run_files import RECORDING, recordings

    found = recordings(directory) if directory.is_dir() else [directory]
    if not found or not found[0].is_file():
        missing = directory / RECORDING if directory.is_dir() else directory
        raise InputError(f"no recording at {missing}; make one: cosim run SCENARIO --out {directory}")
    return subprocess.call([sys.executable, "-m", "rerun", *map(str, found)])
