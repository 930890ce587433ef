"""What sequences of live commands are tried on: simulations stepped by hand, and environments."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, partial
from pathlib import Path
from random import Random
from typing import Any, Final, Self, final

import gymnasium
import numpy as np

from cosim import Pose, SavedState
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from tests.fuzz.arrays import arrays_of, state_content, write_to_all
from tests.fuzz.live_steps import (
    _ARM,
    _DEVICES,
    _SMALL,
    WRONG,
    SimulationSubject,
    Step,
    Subject,
    _film,
    _kept,
)


@final
class FilmSubject(SimulationSubject):
    """A small film without an arm and without devices."""

    @classmethod
    def scenario(cls) -> Scenario:
        return _film(_SMALL)

    def right(self, random: Random) -> dict[str, Any]:
        given: dict[str, Any] = {}
        if random.random() < 0.7:
            given["pressure_Pa"] = {"chamber": random.uniform(5e3, 25e3)}
        if random.random() < 0.5:
            given["cable_tension_N"] = {"corner_0": random.uniform(0.0, 0.5)}
        if random.random() < 0.3:
            given["cable_length_m"] = {"corner_1": random.uniform(0.026, 0.032)}
        return given


@final
class DeviceSubject(SimulationSubject):
    """The same with a pump and winches, in phases that seal its gas and open it."""

    @classmethod
    def scenario(cls) -> Scenario:
        return _film(_SMALL + _DEVICES)

    def right(self, random: Random) -> dict[str, Any]:
        given: dict[str, Any] = {}
        if random.random() < 0.4:
            given["gas_kg"] = {"chamber": random.uniform(1e-6, 1e-5)}
        if random.random() < 0.4:
            given["pump_pressure_Pa"] = {"main": random.uniform(15e3, 25e3)}
        if random.random() < 0.3:
            given["pressure_Pa"] = {"chamber": random.uniform(15e3, 25e3)}
        if random.random() < 0.5:
            given["cable_length_m"] = {"corner_0": random.uniform(0.026, 0.032)}
        return given


@final
class ArmSubject(SimulationSubject):
    """An arm with a soft robot that keeps its shape."""

    @classmethod
    @cache
    def scenario(cls) -> Scenario:
        return load_scenario("ur5e_hexagon_arm", _ARM)

    def right(self, random: Random) -> dict[str, Any]:
        given: dict[str, Any] = {"pressure_Pa": {"chamber": random.uniform(5e3, 40e3)}}
        if random.random() < 0.5:
            given["cable_tension_N"] = {"right": random.uniform(0.0, 2.0)}
        match random.randrange(4):
            case 0:
                given["flange_twist"] = [random.uniform(-0.1, 0.1) for _ in range(6)]
            case 1:
                given["joint_position"] = [random.uniform(-2.0, 2.0) for _ in range(6)]
            case 2:
                x, y, z = (random.uniform(-0.6, 0.6) for _ in range(3))
                given["flange"] = Pose(translation=np.array([x, y, z]))
        return given


@final
class EnvironmentSubject(Subject):
    """An environment for learning, with a soft robot that keeps its shape."""

    def __init__(self, folder: Path) -> None:

        self.environment: Any = gymnasium.make("cosim/TipFollow-v0", fidelity="rigid", kept=_kept()).unwrapped
        self.last: Any = self.environment.reset(seed=0)
        self.folder, self.saved, self.done = folder, list[SavedState](), 0
        folder.mkdir(parents=True, exist_ok=True)

    @classmethod
    def begun(cls, folder: Path) -> Self:
        return cls(folder)

    def moment(self) -> Any:
        return self.done

    def content(self) -> Any:
        shown = [(place, array.tobytes()) for place, array in arrays_of(self.last, "")]
        return state_content(self.environment.save(), self.folder / "state.npz"), shown

    def go_on(self) -> None:
        """Go on for a step, and for one of an episode whose goal is drawn: chance has gone on alike."""
        for _ in range(2):
            self.last = self.environment.step(np.full(6, 0.3, np.float32)), self.environment.reset()

    def drawn(self, random: Random) -> Step:
        asks = (self._act, self._act, self._wrong_act, self._wrong_act, self._reset, self._reset, self._save)
        return random.choice(asks)(random)

    def _act(self, random: Random) -> Step:
        action = np.array([random.uniform(-1.0, 1.0) for _ in range(6)], np.float32)
        return Step("act", partial(self._do, action))

    def _wrong_act(self, random: Random) -> Step:
        action: Any = random.choice(WRONG)
        if random.random() < 0.3:
            action = [action if k == 3 else 0.1 for k in range(random.choice((5, 6, 6, 7)))]
        return Step(f"act {action!r}", partial(self._do, action), ("action",))

    @staticmethod
    def _do(action: Any, of: EnvironmentSubject) -> None:
        of.last = of.environment.step(action)
        of.done += 1

    def _save(self, random: Random) -> Step:
        def do(of: EnvironmentSubject) -> None:
            of.saved.append(of.environment.save())
            write_to_all((of.saved, of.environment.measured, of.last))
            of.last, of.done = None, of.done + 1

        return Step("save and write to all arrays", do)

    def _reset(self, random: Random) -> Step:
        seed = random.choice((None, None, 3, 7, random.choice(WRONG)))
        options: Any = {}
        if random.random() < 0.4:
            options["goal"] = random.choice(([0.3, 0.1, 0.5, 0.03, 0.2, 1.0], random.choice(WRONG)))
        if random.random() < 0.4:
            key = random.choice(("clock.tick_s", "start.pressure_Pa", "no.such_key"))
            options["changes"] = {key: random.choice((3e-3, 4e-3, 5e-3, 25e3, random.choice(WRONG)))}
        if random.random() < 0.2:
            options[random.choice(("begin", "start", "changes"))] = random.choice(WRONG)
        if random.random() < 0.1:
            options = random.choice(WRONG)
        which, from_saved = random.random(), random.random() < 0.3

        def do(of: EnvironmentSubject) -> None:
            given = options
            if from_saved and of.saved and isinstance(options, dict) and "start" not in options:
                given = {**options, "start": of.saved[int(which * len(of.saved))]}
            of.last = of.environment.reset(seed=seed, options=given)
            of.done += 1

        return Step(f"reset(seed={seed!r}, options={options!r}, {from_saved})", do)


SUBJECTS: Final[Mapping[str, type[Subject]]] = {
    "film": FilmSubject, "devices": DeviceSubject, "arm": ArmSubject, "environment": EnvironmentSubject,
}  # fmt: skip
"""By name."""
