"""Forged checkpoints: a run goes on from files that were damaged or made up.

Each file is the state of a short run with one thing changed: bits of the file or of an array, an array of
another size, kind or order, numbers that are not finite, parts missing, added or exchanged, other versions,
packed or torn archives. A crash, a traceback and a wait above a minute are findings; that it is refused
in one line, fails by name, or is gone on with, are none.
"""

from __future__ import annotations

import contextlib
import io
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, Final, final

import numpy as np

import cosim
from cosim.cli.main import main
from tests.fuzz.forgeries import forge
from tests.fuzz.verdict import FINDING, Trial, Verdict

MOVING: Final[dict[str, tuple[str, dict[str, Any]]]] = {
    "lumped": ("ur5e_hexagon_arm", {"clock.tick_s": 0.01}),
    "touching": ("gripper_lifts_roll", {}),
    "section": ("ur5e_hexagon_arm", {"fidelity": "section"}),
}
"""Runs in time: scenario and changes."""
_TICKS: Final = 3
_OUTCOMES: Final = {0: "goes on", 1: "fails by name", 2: "refused"}
_INTERRUPTED: Final = """
import sys
from cosim.cli.main import main
from cosim.cli.interruption import Interruption
from cosim.stepping import stepped_run

stepped_run._SHOWN_S = 0.0  # each increment is shown, and the reason asked for, by itself
asked = []
Interruption.reason = lambda self: asked.append(0) or ("SIGINT" if len(asked) > 4 else None)
sys.exit(main(sys.argv[1:]))
"""


def interrupted_statics(folder: Path) -> Path:
    """Return the folder of a quasistatic run that was interrupted after a few increments."""
    out = folder / "statics"
    words = ["run", "three_unit_inflation", "--set", "phase.1.increments=8", "--out", str(out)]
    command = [sys.executable, "-c", _INTERRUPTED, *words, "--no-recording", "--quiet"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 130, done.stderr
    return out


@final
class Statics(Trial):
    """Checkpoints of a quasistatic run, with which `cosim run --resume` goes on."""

    def begin(self, folder: Path) -> None:
        self._run = interrupted_statics(folder)
        resumed(Path(shutil.copytree(self._run, folder / "sound")))

    def tried(self, seed: int, folder: Path) -> Verdict:
        place = Path(shutil.copytree(self._run, folder / "run"))
        kind, data = forge(self._run / "checkpoint.npz", np.random.default_rng(seed))
        (place / "checkpoint.npz").write_bytes(data)
        code, said = resumed(place)
        outcome = FINDING if "Traceback" in said or code not in _OUTCOMES else _OUTCOMES[code]
        return Verdict(outcome, said, kind)


@final
class Moving(Trial):
    """Saved states of a run in time, with which a simulation goes on."""

    def __init__(self, name: str) -> None:
        self._scenario, self._changes = MOVING[name]

    def begin(self, folder: Path) -> None:
        self._kept, self._state = cosim.KeptParts(), folder / "state.npz"
        simulation = self._simulation(None)
        simulation.step(_TICKS)
        simulation.save().write(self._state)

    def tried(self, seed: int, folder: Path) -> Verdict:
        kind, data = forge(self._state, np.random.default_rng(seed))
        path = folder / "state.npz"
        path.write_bytes(data)
        try:
            self._simulation(path).step(_TICKS)
        except cosim.InputError as error:
            return Verdict(FINDING if "\n" in str(error) else "refused", str(error), kind)
        except cosim.CosimError as error:
            return Verdict("fails by name", str(error), kind)
        return Verdict("goes on", "", kind)

    def _simulation(self, start: Path | None) -> cosim.Simulation:
        return cosim.Simulation(self._scenario, overrides=self._changes, start=start, kept=self._kept)


def resumed(place: Path) -> tuple[int, str]:
    """Return the exit code of a run that goes on in a folder, and what it says."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = main(["run", "--resume", str(place), "--no-recording", "--quiet"])
    return code, said.getvalue()
