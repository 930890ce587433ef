"""Steps of a simulation that are drawn at random, with wrong values mixed in."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from decimal import Decimal
from functools import cache
from pathlib import Path
from random import Random
from typing import Any, ClassVar, Final, Self, final

import numpy as np

import cosim
import cosim.gym
from cosim import Command, Pose, SavedState, Simulation
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from tests.fuzz.arrays import arrays_of, state_content, write_to_all

WRONG: Final[tuple[Any, ...]] = (
    "text", "1.0", b"x", None, True, float("nan"), float("inf"), -float("inf"), -1.0, 0.0, 1e308, 10**400,
    1 + 2j, [], [1.0], [1.0, None], [[1.0]], {}, {"a": 1.0}, {1: 2}, {None: None}, (), (1.0,) * 6,
    ("x",) * 6, (float("nan"),) * 6, [None] * 6, 2, 1.5, Decimal("1.0"), object, len, np.array(3.0),
    np.array([1.0, 2.0]), np.full((2, 3), np.nan), np.array(["a"] * 6), np.zeros(6, complex), np.float32(1.0),
    np.bool_(True), range(6), Path("none.npz"), "none.npz", Command(), Pose(), Ellipsis,
    Pose(np.zeros((3, 3))), Pose(translation=np.full(3, np.nan)), Pose(translation=np.full(3, 1e9)),
)  # fmt: skip
"""Values that are mixed in; some of them are right in some places."""
_SMALL: Final = """
schema = 2
title = "Three square units"
robot = "none"
soft_robot = "square_core_cables"
model.published = true
gravity_m_s2 = [0.0, 0.0, 0.0]
clock.tick_s = 0.004
solver.damping_per_s = 20.0
[start]
flange = { position_m = [0.0, 0.0, 0.0], direction = [0.0, 0.0, 1.0] }
pressure_Pa = 20e3
"""
_DEVICES: Final = """
[[winch]]
name = "steppers"
cables = ["corner_0", "corner_1"]
step_angle_rad = 0.03
drum_radius_m = 0.01
step_rate_per_s = 1000.0
stall_torque_Nm = 0.1
[[pump]]
name = "main"
flow_kg_s = 2e-5
band_Pa = 200.0
sensor_delay_s = 0.02
[[phase]]
name = "seal"
duration_s = 0.06
gas = "sealed"
[[phase]]
name = "open"
duration_s = 0.06
gas = "prescribed"
pressure_Pa = 18e3
[[phase]]
name = "again"
duration_s = 2.0
gas = "sealed"
"""
_TOGETHER: Final = ("which all move the flange", "both tension and length", "configuration", "no motion")
"""Refusals of what no key says alone."""
_ARM: Final[dict[str, Any]] = {
    "model.published": True, "fidelity": "rigid", "clock.tick_s": 0.004, "contact.enabled": False,
    "phase": [],
}  # fmt: skip


@final
@dataclass(frozen=True)
class Step:
    """One thing that is asked of a subject.

    Args:
        what: in words.
        do: asks it.
        keys: a refusal names one of these; empty: it is about something else.
    """

    what: str
    do: Callable[[Any], None]
    keys: tuple[str, ...] = ()


class Subject(ABC):
    """Something that steps in time, is saved, restored and reset."""

    @classmethod
    @abstractmethod
    def begun(cls, folder: Path) -> Self:
        """Return one at its start; `folder` is for its files."""

    @abstractmethod
    def drawn(self, random: Random) -> Step:
        """Return what is asked next; done to a twin it asks the same."""

    @abstractmethod
    def moment(self) -> Any:
        """Return how far it is; the same where nothing has been solved since."""

    @abstractmethod
    def content(self) -> Any:
        """Return all that its ticks to come depend on, and what it shows; equal if equal in every bit."""

    @abstractmethod
    def go_on(self) -> None:
        """Go on for a few ticks."""


class SimulationSubject(Subject):
    """A simulation that is stepped by hand."""

    changes: ClassVar[tuple[str, ...]] = (
        "clock.tick_s", "solver.damping_per_s", "gravity_m_s2", "start.pressure_Pa", "contact.stiffness_N_m3",
        "soft_robot", "mode", "phase", "no.such_key", "start.flange.position_m",
    )  # fmt: skip

    def __init__(self, folder: Path) -> None:
        self.simulation = Simulation(self.scenario(), kept=_kept())
        self.simulation.step(1)
        self.folder = folder
        self.saved: list[tuple[SavedState, Any]] = []
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "torn.npz").write_bytes(b"PK\x03\x04torn")

    @classmethod
    def begun(cls, folder: Path) -> Self:
        return cls(folder)

    @classmethod
    @abstractmethod
    def scenario(cls) -> Scenario:
        """Return what is simulated."""

    @abstractmethod
    def right(self, random: Random) -> dict[str, Any]:
        """Return the fields of a command that may be asked for."""

    def moment(self) -> Any:
        here = self.simulation
        return here.snapshot.tick, len(self.saved), here.stage.tick_s, here.scenario.solver.damping_per_s

    def content(self) -> Any:
        here = self.simulation
        shown = [(place, array.shape, array.tobytes()) for place, array in arrays_of(here.measure(), "")]
        return state_content(here.save(), self.folder / "state.npz"), shown, repr(here)

    def go_on(self) -> None:
        if self.simulation.ticks_left >= 2:
            self.simulation.step(2)

    def drawn(self, random: Random) -> Step:
        asks = (
            self._step, self._command, self._command, *[self._wrong_command] * 3, self._wrong_step,
            self._save, self._restore, self._wrong_restore, self._branch, self._reset, self._writing,
        )  # fmt: skip
        return random.choice(asks)(random)

    def _step(self, random: Random) -> Step:
        ticks = random.choice((0, 1, 2, 3, np.int64(2)))
        return Step(f"step({ticks})", lambda of: of.simulation.step(ticks), ("ticks",))

    def _command(self, random: Random) -> Step:
        return self._asked(self.right(random), random.randint(1, 4), ())

    def _wrong_command(self, random: Random) -> Step:
        given, ticks = self.right(random), random.randint(1, 4)
        name = random.choice([entry.name for entry in fields(Command)])
        value = random.choice(WRONG)
        inner = given.get(name)
        if isinstance(inner, dict) and random.random() < 0.6:
            value = {**inner, random.choice([*inner, "nobody"]): value}
        elif isinstance(inner, Sequence) and random.random() < 0.4:
            value = [value if k == 1 else entry for k, entry in enumerate(inner)]
        asked = {**given, name: value}
        return self._asked(asked, ticks, (*asked, *_TOGETHER))

    def _asked(self, given: dict[str, Any], ticks: int, keys: tuple[str, ...]) -> Step:
        def do(of: SimulationSubject) -> None:
            of.simulation.step(Command(**given), ticks=ticks)

        return Step(f"{given} in {ticks}", do, keys)

    def _wrong_step(self, random: Random) -> Step:
        command, ticks = random.choice(WRONG), random.choice((1, 2, random.choice(WRONG)))
        return Step(
            f"step({command!r}, ticks={ticks!r})",
            lambda of: of.simulation.step(command, ticks=ticks),
            ("command", "ticks", "flange"),
        )

    def _save(self, random: Random) -> Step:
        def do(of: SimulationSubject) -> None:
            of.saved.append((of.simulation.save(), of.content()))

        return Step("save", do)

    def _restore(self, random: Random) -> Step:
        which, by_file = random.random(), random.random() < 0.4

        def do(of: SimulationSubject) -> None:
            if not of.saved:
                return
            saved, content = of.saved[int(which * len(of.saved))]
            if by_file:
                saved.write(of.folder / "slot.npz")
            of.simulation.restore(of.folder / "slot.npz" if by_file else saved)
            assert of.content() == content, "what is restored is not what was saved"

        return Step(f"restore {which:.2f}{' of a file' if by_file else ''}", do, ("saved", "phase"))

    def _wrong_restore(self, random: Random) -> Step:
        value = random.choice((*WRONG, "torn.npz", "other"))

        def do(of: SimulationSubject) -> None:
            named: dict[str, Callable[[], Any]] = {
                "other": other_state,
                "torn.npz": lambda: of.folder / "torn.npz",
            }
            of.simulation.restore(named[value]() if isinstance(value, str) and value in named else value)

        return Step(f"restore {value!r}", do)

    def _branch(self, random: Random) -> Step:
        changes = self._changes(random) if random.random() < 0.6 else None

        def do(of: SimulationSubject) -> None:
            branch = of.simulation.branch(changes)
            before = of.content()
            if branch.ticks_left:
                branch.step(1)
            write_to_all(branch.snapshot)
            assert of.content() == before, "a branch changes where it came from"

        return Step(f"branch {changes}", do, () if changes is None else (*_keys(changes), "saved", "start"))

    def _reset(self, random: Random) -> Step:
        changes = self._changes(random) if random.random() < 0.5 else None
        which, start = random.random(), random.choice((None, None, "slot", random.choice(WRONG)))

        def do(of: SimulationSubject) -> None:
            given = start
            if isinstance(start, str) and start == "slot":
                given = of.saved[int(which * len(of.saved))][0] if of.saved else None
            of.simulation.reset(given, changes)

        keys = () if changes is None or start is not None else _keys(changes)
        return Step(f"reset({start!r}, {changes})", do, keys)

    def _changes(self, random: Random) -> Any:
        if random.random() < 0.1:
            return random.choice(WRONG)
        key = random.choice(self.changes)
        right = {"clock.tick_s": 2e-3, "solver.damping_per_s": 5.0, "gravity_m_s2": [0.0, 0.0, -9.81]}
        value = right.get(key) if random.random() < 0.4 else random.choice(WRONG)
        return {key: value}

    def _writing(self, random: Random) -> Step:
        def do(of: SimulationSubject) -> None:
            here = of.simulation
            for shown in (here.snapshot, here.measure(), here.save(), here.stage, here):
                write_to_all(shown)

        return Step("write to all arrays", do)


def _keys(changes: Any) -> tuple[str, ...]:
    """Return what refusals of changes may name: a key's first part, or that they are none."""
    if not isinstance(changes, dict) or not all(isinstance(key, str) for key in changes):
        return ("changes",)
    return tuple(key.partition(".")[0] for key in changes)


@cache
def _kept() -> cosim.KeptParts:
    return cosim.KeptParts()


@cache
def other_state() -> SavedState:
    """Return the state of a simulation of something else."""
    return Simulation("ur5e_hexagon_arm", overrides={**_ARM, "robot": "none"}, kept=_kept()).save()


@cache
def _film(text: str) -> Scenario:
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as folder:
        path = Path(folder) / "small.toml"
        path.write_text(text, encoding="utf-8")
        return load_scenario(path)
