"""Schema of a study: one scenario, and what is varied in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, final

from annotated_types import Interval

from cosim.config.toml.constraints import Count, Text


@final
@dataclass(frozen=True)
class RangeTable:
    """A range that samples are taken from.

    Args:
        low: its lower end.
        high: its upper end, above it.
        scale: whether samples are even in the value or in its logarithm.
        integer: whether whole numbers are taken, both ends included.
    """

    low: float
    high: float
    scale: Literal["linear", "log"] = "linear"
    integer: bool = False


@final
@dataclass(frozen=True)
class SamplesTable:
    """Samples that fill a box evenly (scipy.stats.qmc).

    Args:
        count: of samples.
        range: by key path: [low, high], or a table of low, high, scale ("linear" or "log") and integer.
        method: of sampling; Sobol's is balanced where the count is a power of 2.
        seed: the same one gives the same samples.
    """

    count: Count
    range: Mapping[str, Any]
    method: Literal["latin_hypercube", "sobol", "halton"] = "latin_hypercube"
    seed: Annotated[int, Interval(ge=0)] = 0


@final
@dataclass(frozen=True)
class StudyTable:
    """A study: every entry of `design`, with every combination of `grid`, with every one of `samples`.

    Args:
        scenario: name of one that comes with cosim, or path of a .toml file, seen from the study's file.
        set: values by key path, in all designs.
        grid: lists of values by key path; every combination is a design.
        design: tables of values by key path, one for each design.
        samples: of ranges of values.
        figures: columns of the table beside the varied keys, such as "sag_m", at the end of the run, or
            "phases.inflate.volume_m3"; omitted: all of the run and of its end.
        measure: function that returns more columns of a run: "module:function" or "file.py:function".
        keep_runs: whether the directory of every run is kept, with its arrays.
    """

    scenario: Text
    set: Mapping[str, Any] = field(default_factory=dict)
    grid: Mapping[str, Any] = field(default_factory=dict)
    design: tuple[Mapping[str, Any], ...] = ()
    samples: SamplesTable | None = None
    figures: tuple[str, ...] = ()
    measure: Text | None = None
    keep_runs: bool = False
