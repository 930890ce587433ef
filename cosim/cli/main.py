"""The command line: runs the command of its arguments and returns an exit code. Exit codes: 0 done, 1 the
physics could not be solved or verified, 2 wrong input, 3 results could not be written, 128 + n stopped by
signal n (141: the reader of standard output has closed it).
"""

import argparse
import atexit
import gc
import os
import sys
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from cosim.cli.arguments import parser
from cosim.cli.late_collection import LateCollection
from cosim.cli.screen import mute, open_missing_streams, printable, tell
from cosim.cli.sweep_line import SweepLine, counts_text
from cosim.errors import InputError, OutputError, SolverError

if TYPE_CHECKING:
    from cosim.cli.viewing import LiveView


EXIT_DONE, EXIT_UNSOLVED, EXIT_INPUT, EXIT_UNWRITTEN, EXIT_INTERRUPTED, EXIT_UNREAD = 0, 1, 2, 3, 130, 141
PLOT: Final = "sweep.png"
_REASONS: Final = 3
"""Number of different errors of a sweep that are printed; the table has all."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    started = time.perf_counter()
    # before numpy is imported: threads only slow down the small dense algebra of a run
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    # Rerun would print errors that cosim prints itself, such as of a full disk
    os.environ.setdefault("RUST_LOG", "off")
    # pydantic would read the entry points of all installed packages
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # memory is released with the process: to look for garbage in all of it once more takes 0.3 s
    atexit.register(gc.freeze)
    open_missing_streams()
    options = parser().parse_args(arguments)
    if not vars(options).get("modules"):  # a user's module may open windows
        # MuJoCo would load a library for windows, which starts another Python
        os.environ.setdefault("MUJOCO_GL", "off")
    try:
        return _flushed(_command(options, started))
    except InputError as error:
        for line in str(error).split("\n"):
            tell(f"cosim: error: {line}")
        return EXIT_INPUT
    except SolverError as error:
        tell(f"cosim: not solved: {error}")
        return EXIT_UNSOLVED
    except BrokenPipeError:  # the reader of standard output has closed it
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
    """Flush standard output, and return the exit code.

    Raises:
        OSError: standard output cannot be written.
    """
    sys.stdout.flush()
    return code


def _command(options: argparse.Namespace, started: float) -> int:
    """Run a command. Modules are imported here, so that --help and list load no numpy and no kernels."""
    _import_kinds(vars(options).get("modules", ()))
    match options.command:
        case "run":
            with LateCollection() as collection:
                return _run(options, started, collection)
        case "verify":
            from cosim.cli.verify import verify_command

            return verify_command(options.cases)
        case "trade":
            from cosim.cli.trade import trade_command

            return trade_command(options, SweepLine(sys.stderr))
        case name if name in _PLAIN:
            return _PLAIN[name](options)
        case "list":
            return _list(options.kind)
        case "view" | "video":
            from cosim.cli.viewing import video_command, view_command

            if options.command == "video":
                return video_command(options)
            return view_command(options.directory, web=options.web)
        case _:
            return _files(options)


def _import_kinds(modules: Sequence[str]) -> None:
    if modules:
        from cosim.config.plugins import register_module  # here, because it loads pydantic

        for name in modules:
            register_module(name)


def _run(options: argparse.Namespace, started: float, collection: LateCollection) -> int:
    from cosim.cli.running import RunOptions, resume_command, run_command  # --help and list need no engine

    every_s = options.checkpoint_every
    if every_s is not None and not every_s > 0.0:
        raise InputError(
            f"--checkpoint-every {every_s}: must be above 0; inf writes none but at an early end"
        )
    if options.resume is None and options.scenario is None:
        raise InputError("run: no SCENARIO given; see 'cosim list', or resume a run: --resume DIR")
    given = options.scenario is not None or options.assignments or options.out is not None
    if options.resume is not None and given:
        raise InputError(
            f"--resume {options.resume}: resumes the scenario of that directory, there; "
            "give no SCENARIO, no --set and no --out"
        )
    with _live_view(options, recording=not options.no_recording) as live:
        how = RunOptions(
            not options.no_recording, options.quiet, every_s, started, live, (collection,), options.error
        )
        if options.resume is not None:
            code = resume_command(options.resume, how)
        else:
            code = run_command(options.scenario, options.assignments, options.out, how)
        if code == EXIT_DONE and live is not None:
            live.serve_on()
        return code


def _twin(options: argparse.Namespace) -> int:
    from cosim.app.simulation import Simulation  # here, because they load numpy
    from cosim.cli.twin import twin_command

    with _live_view(options, recording=True) as live:
        simulation = Simulation(options.scenario, overrides={**_overrides(options), "phase": []})
        return twin_command(simulation, options.streams, simulation.scenario.recording, options.out, live)


def _live_view(options: argparse.Namespace, *, recording: bool) -> "AbstractContextManager[LiveView | None]":
    if not (options.live or options.web):
        return nullcontext()
    from cosim.cli.viewing import live_view  # here, because it loads the viewer

    return live_view(web=options.web, recording=recording)


def _sweep(options: argparse.Namespace) -> int:
    """Run a study and return the exit code: 1 if none of its designs is completed."""
    from cosim.base.writing import writing
    from cosim.sweeps.plot import plot_sweep
    from cosim.sweeps.sweeping import sweep  # here, because it loads numpy
    from cosim.sweeps.table import TABLE

    given = {key: vars(options)[key] for key in ("out", "engine", "workers", "modules")}
    try:
        outcome = sweep(options.study, tell=None if options.quiet else SweepLine(sys.stderr), **given)
    except KeyboardInterrupt:
        tell("cosim: interrupted; the rows so far are kept: the same command continues")
        raise
    if not options.quiet:
        tell(
            f"{outcome.count} designs: {counts_text(outcome.statuses)}; {outcome.computed} computed, "
            f"{outcome.reused} known before"
        )
        for reason, count in list(outcome.reasons.items())[:_REASONS]:
            tell(f"{count} times: {reason}")
        tell(f"table: {outcome.directory / TABLE}")
    if options.columns:
        path = outcome.directory / PLOT
        with writing(path):
            plot_sweep(outcome.directory, *options.columns).savefig(path, dpi=110)
        tell(f"plot:  {path}")
    return EXIT_DONE if outcome.statuses.get("completed") else EXIT_UNSOLVED


def _replay(options: argparse.Namespace) -> int:
    from cosim.gym.policy import policy_of  # here, because they load Gymnasium and the kernels
    from cosim.gym.replay import replay

    if options.episodes < 1:
        raise InputError(f"--episodes {options.episodes}: must be at least 1")
    coarse, fine, count = options.against, options.fidelity, options.episodes
    found = replay(policy_of(options.policy), options.env, coarse, fine, count, options.seed)
    for line in found.lines():
        print(printable(line))
    return EXIT_DONE


def _errors(options: argparse.Namespace) -> int:
    from cosim.app import ended_run, error_bars  # here, because they load numpy
    from cosim.cli.screen import logged_to
    from cosim.telemetry.texts.bar_lines import bar_lines

    run = ended_run.load_run(options.directory)
    with logged_to(tell):
        found = error_bars.error_bars(run)
    for line in bar_lines(found, run.stage.phase_names):
        print(printable(line))
    return EXIT_DONE


def _export(options: argparse.Namespace) -> int:
    from cosim.cli.exporting import EXPORTS, export_command  # here, because it loads numpy

    wanted = [kind for kind in EXPORTS if vars(options)[kind]]
    export_command(options.directory, options.out, wanted, options.times_s)
    return EXIT_DONE


def _export_path(options: argparse.Namespace) -> int:
    from cosim.app.joint_paths import plan_path, run_path  # here, because they load numpy
    from cosim.app.payload import payload_torque
    from cosim.results.joint_table import check_name

    for file in options.files:
        check_name(file)
    source, overrides = options.scenario, _overrides(options)
    if Path(source).is_dir():
        if overrides:
            raise InputError(f"--set changes a scenario; {source} is a run that has been")
        table = run_path(source, phase=options.phase, rate_Hz=options.rate)
    else:
        wanted = {"phase": options.phase, "whole": options.whole}
        table = plan_path(source, **wanted, rate_Hz=options.rate, overrides=overrides)
    for file in options.files:
        table.write(file)
        print(printable(f"{file}, {len(table.time_s)} rows at {options.rate:g} Hz"))
    if table.payload is not None:
        for line in repr(payload_torque(source)).split("\n"):
            print(printable(f"payload: {line}"))
    return EXIT_DONE


def _export_fmu(options: argparse.Namespace) -> int:
    from cosim.base.resources import extra_module

    extra_module("pythonfmu", "fmi")
    from cosim.app.fmu import write_fmu  # here, because it loads that

    write_fmu(options.scenario, options.out, _overrides(options))
    print(printable(f"{options.out}, runs in Python processes with cosim[fmi]"))
    return EXIT_DONE


def _identify(options: argparse.Namespace) -> int:
    from cosim.bench import fitting, page  # here, because they load numpy and pydantic
    from cosim.config.benches import load_bench

    bench, series = load_bench(options.bench)
    result = fitting.identify(bench, series, only_check=options.check, force=options.force, tell=tell)
    if options.check:
        for line in (*result.oddities, *result.check.lines()):
            print(printable(line))
        return EXIT_DONE if result.check.good and not result.oddities else EXIT_INPUT
    for line in (*page.value_lines(result), *page.series_lines(result)):
        print(printable(line))
    out = options.out or Path("runs") / options.bench.stem
    for path in page.write_results(result, out, options.bench.name):
        tell(str(path))
    return EXIT_DONE


def _design(options: argparse.Namespace) -> int:
    from cosim.bench import page  # here, because they load numpy and pydantic
    from cosim.bench.design import design, design_lines
    from cosim.config.benches import load_design_study

    study = load_design_study(options.study)
    verify, searches = not options.unverified, study.starts * max(1, len(study.choice))
    if searches == 1:
        results = design(study, verify=verify, tell=tell)
    else:
        from cosim.sweeps.engines import Engine  # here: one search needs no workers

        with Engine(workers=options.workers).pool() as pool:
            results = design(study, verify=verify, each=pool.executor.map, tell=tell)
    for found in results:
        if found.choice:
            print(printable(f"{found.choice}:"))
        for line in design_lines(found):
            print(printable(line))
    out = options.out or Path("runs") / options.study.stem
    for path in page.write_designs(results, out, options.study.name):
        tell(str(path))
    return EXIT_DONE if results[0].feasible else EXIT_UNSOLVED


def _overrides(options: argparse.Namespace) -> dict[str, Any]:
    from cosim.config.toml.reading import parse_assignment  # here, because it loads pydantic

    return dict(map(parse_assignment, options.assignments))


def _compare(options: argparse.Namespace) -> int:
    from cosim.app.replay import drawn, replay  # here, because they load numpy
    from cosim.base.writing import writing
    from cosim.results.joint_table import JointTable
    from cosim.results.plots import figure_kind

    if options.plot is not None:
        figure_kind()
    rows = JointTable.read(options.file)
    found = replay(options.scenario, rows, overrides=_overrides(options))
    for line in repr(found).split("\n"):
        print(printable(line))
    if options.plot is not None:
        with writing(options.plot):
            drawn(found, rows).savefig(options.plot, dpi=110)
        print(printable(str(options.plot)))
    return EXIT_DONE


def _pattern(options: argparse.Namespace) -> int:
    from cosim.cli import pattern  # here, because it loads numpy and pydantic

    if options.action == "check":
        pattern.check_pattern_command(options.file, options.unit, options.sealed, options.png)
    else:
        pattern.export_pattern_command(options.robot, options.out)
    return EXIT_DONE


def _files(options: argparse.Namespace) -> int:
    from cosim.cli import checking, files  # here, because they load pydantic

    if options.command == "new" and options.pattern is not None:
        from cosim.cli.pattern import new_pattern_command  # here, because it loads the mesher

        new_pattern_command(options.name, options.pattern, options.unit, options.sealed)
        return EXIT_DONE
    if options.command == "new":
        if options.name is None:
            raise InputError("new: no NAME given")
        files.new_command(options.name)
        return EXIT_DONE
    if options.command == "schema":
        print(files.schema_text(options.kind), end="")
        return EXIT_DONE
    command = checking.check_command if options.command == "check" else checking.upgrade_command
    return EXIT_DONE if command(options.files) else EXIT_INPUT


def _list(kind: str) -> int:
    if kind == "arms":
        from cosim.cli.files import arm_lines  # here, because it loads pydantic

        for line in arm_lines():
            print(printable(line))
        return EXIT_DONE
    from cosim.base.resources import first_comment, list_scenarios, list_soft_robots, scenario_path
    from cosim.base.resources import soft_robot_path as robot_path

    robots = kind == "soft_robots"
    names, path_of = (list_soft_robots(), robot_path) if robots else (list_scenarios(), scenario_path)
    width = max(map(len, names), default=0)
    for name in names:
        print(printable(f"{name:<{width}}  {first_comment(path_of(name))}"))
    return EXIT_DONE


def _warm_up(options: argparse.Namespace) -> int:
    from cosim.cli.running import warm_up_command  # here, because it loads the engine

    return warm_up_command(options.scenarios)


def _cache(options: argparse.Namespace) -> int:
    from cosim.base import caches

    if options.clear:
        caches.clear()
    print("\n".join(caches.lines()))
    return EXIT_DONE


_PLAIN: Final = {
    "errors": _errors,
    "export": _export,
    "export-fmu": _export_fmu,
    "sweep": _sweep,
    "identify": _identify,
    "design": _design,
    "replay": _replay,
    "pattern": _pattern,
    "export-path": _export_path,
    "compare": _compare,
    "twin": _twin,
    "warm-up": _warm_up,
    "cache": _cache,
}
"""Functions of the commands that need no further arguments."""
