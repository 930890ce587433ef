"""Steps several arms in one scene, each with its soft robot, by ticks of one clock."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final, final

from cosim.errors import SolverError
from cosim.soft.contact.overlap_check import ArmsOverlapCheck
from cosim.stepping.dynamic import DynamicSimulation
from cosim.telemetry.tick_batch import TickBatch

_BATCH: Final = 64
"""Ticks of an arm in a batch."""


@final
@dataclass(frozen=True)
class ArmBatch:
    """Some ticks of an arm.

    Args:
        arm: its name.
        batch: the ticks.
    """

    arm: str
    batch: TickBatch


@final
class ArmsRun:
    """Steps the runs of several arms in lockstep.

    Args:
        runs: by the arm's name; all have the same number of ticks.
        step: takes the rigid step of a tick, after all arms have begun it.
    """

    def __init__(self, runs: Mapping[str, DynamicSimulation], step: Callable[[], None]) -> None:
        self.runs = dict(runs)
        self._step = step
        self._searches = {
            names: ArmsOverlapCheck(*(self.runs[name].soft.body for name in names))
            for names in combinations(self.runs, 2)
        }

    def batches(self) -> Iterator[ArmBatch]:
        """Yield the state at rest of each arm, then its ticks in batches, each of one phase.

        Raises:
            SolverError: the physics could not be solved; the ticks before it have been yielded.
        """
        gathered: dict[str, list[TickBatch]] = {name: [] for name in self.runs}
        try:
            for name in self.runs:
                self._take(name, gathered)
            yield from self._joined(gathered, least=1)
            for _ in range(next(iter(self.runs.values())).stage.ticks):
                for run in self.runs.values():
                    run.begin_tick()
                self._step()
                for name in self.runs:
                    self._take(name, gathered)
                self._add_overlaps(gathered)
                yield from self._joined(gathered, least=_BATCH)
        except (Exception, KeyboardInterrupt):
            yield from self._joined(gathered, least=1)
            raise

    def _take(self, name: str, gathered: dict[str, list[TickBatch]]) -> None:
        try:
            gathered[name] += self.runs[name].batches(1, 1)
        except SolverError as error:
            raise error.at(f"arm '{name}'") from error.__cause__

    def _add_overlaps(self, gathered: dict[str, list[TickBatch]]) -> None:
        """Add overlaps between films of different arms to the last tick, if it checks overlaps."""
        for (one, other), search in self._searches.items():
            if not (self.runs[one].checked_overlap() or self.runs[other].checked_overlap()):
                continue
            overlap = search.overlap(self.runs[one].film_now(), self.runs[other].film_now())
            if overlap is None:
                continue
            for name, its in ((one, other), (other, one)):
                last = gathered[name][-1]
                overlaps = (*last.overlaps.get(0, ()), replace(overlap, arm=its))
                gathered[name][-1] = replace(last, overlaps={**last.overlaps, 0: overlaps})

    def _joined(self, gathered: dict[str, list[TickBatch]], least: int) -> Iterator[ArmBatch]:
        """Yield the gathered ticks of each arm that has enough of them or is at the end of a phase."""
        for name, batches in gathered.items():
            if batches and (len(batches) >= least or self.runs[name].at_edge):
                gathered[name] = []
                yield ArmBatch(name, TickBatch.joined(batches))
