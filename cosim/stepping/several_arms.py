"""Several arms in one scene, each with its soft robot: their runs advance by ticks of the same clock."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from typing import Final, final

from cosim.errors import SolverError
from cosim.soft.contact.overlap_check import ArmsOverlapCheck
from cosim.stepping.dynamic import DynamicSimulation
from cosim.telemetry.tick_batch import TickBatch

_SHOWN: Final = 64
"""Ticks that are shown together."""


@final
class ArmsRun:
    """Steps the runs of several arms in lockstep.

    Args:
        runs: by the arm's name; all have as many ticks.
        step: takes the rigid step of a tick, once all arms have begun theirs.
    """

    def __init__(self, runs: Mapping[str, DynamicSimulation], step: Callable[[], None]) -> None:
        self.runs = dict(runs)
        self._step = step
        self._looks = {
            names: ArmsOverlapCheck(*(self.runs[name].soft.body for name in names))
            for names in combinations(self.runs, 2)
        }

    def batches(self) -> Iterator[tuple[str, TickBatch]]:
        """Yield the state at rest of each arm, then the ticks of each, some of one phase at a time.

        Raises:
            SolverError: the physics could not be solved; the ticks before it have been yielded.
        """
        gathered: dict[str, list[TickBatch]] = {name: [] for name in self.runs}
        try:
            for name in self.runs:
                self._take(name, gathered)
            yield from self._shown(gathered, least=1)
            for _ in range(next(iter(self.runs.values())).stage.ticks):
                for run in self.runs.values():
                    run.begin_tick()
                self._step()
                for name in self.runs:
                    self._take(name, gathered)
                self._look(gathered)
                yield from self._shown(gathered, least=_SHOWN)
        except (Exception, KeyboardInterrupt):
            yield from self._shown(gathered, least=1)
            raise

    def _take(self, name: str, gathered: dict[str, list[TickBatch]]) -> None:
        try:
            gathered[name] += self.runs[name].batches(1, 1)
        except SolverError as error:
            raise error.at(f"arm '{name}'") from error.__cause__

    def _look(self, gathered: dict[str, list[TickBatch]]) -> None:
        """Add to the last tick where films of different arms are in one another, if it is looked for."""
        for (one, other), look in self._looks.items():
            if not (self.runs[one].looked() or self.runs[other].looked()):
                continue
            found = look.overlap(self.runs[one].film_now(), self.runs[other].film_now())
            if found is None:
                continue
            for name, its in ((one, other), (other, one)):
                last = gathered[name][-1]
                overlaps = (*last.overlaps.get(0, ()), replace(found, arm=its))
                gathered[name][-1] = replace(last, overlaps={**last.overlaps, 0: overlaps})

    def _shown(self, gathered: dict[str, list[TickBatch]], least: int) -> Iterator[tuple[str, TickBatch]]:
        """Yield what has been gathered of arms, where it is enough or ends a phase."""
        for name, batches in gathered.items():
            if batches and (len(batches) >= least or self.runs[name].at_edge):
                gathered[name] = []
                yield name, TickBatch.joined(batches)
