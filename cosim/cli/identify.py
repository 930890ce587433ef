"""`cosim identify`: a robot's values from measured curves."""

from __future__ import annotations

import argparse
from pathlib import Path

from cosim.bench.fitting import identify
from cosim.bench.page import fitted_scenario, series_lines, value_lines, write_results
from cosim.cli.screen import printable, tell
from cosim.config.benches import load_bench


def identify_command(options: argparse.Namespace) -> int:
    """Check a bench, fit it, write what was found; return the exit code: 2 where the data cannot tell."""
    bench, series = load_bench(options.bench)
    result = identify(bench, series, only_check=options.check, force=options.force, tell=tell)
    if options.check:
        for line in (*result.oddities, *result.check.lines()):
            print(printable(line))
        return 0 if result.check.good and not result.oddities else 2
    for line in (*value_lines(result), *series_lines(result)):
        print(printable(line))
    out = options.out or Path("runs") / options.bench.stem
    for path in write_results(result, fitted_scenario(result), out, options.bench.name):
        tell(str(path))
    return 0
