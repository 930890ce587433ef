"""What ticks have left, whoever has taken them: as columns, with the shapes of the film."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose, Wrench
from cosim.coupling.schemes.ledger import LedgerEntry, Scheme, TickPieces
from cosim.coupling.soft_sides.soft_side import SoftReply, SoftSide
from cosim.coupling.ticks import Ticks
from cosim.reduced.sections.assembly import CENTER, INERTIA, WRENCH


@final
@dataclass
class TicksTaken:
    """How far both sides have come in one call, and what its ticks have left.

    Args:
        ticks: what they leave; rows beyond the last one hold nothing.
        pressure_Pa: (n, chambers), gauge.
        stability_ratio: (n,), see `LedgerEntry`, as for all that follow down to `interface_residual`.
        algorithmic_mass: (n,).
        trials: (n,).
        interface_residual: (n,).
        scheme: of the exchange.
        parts: shapes of the film, each as `SoftSide.shape_now` returns it, some ticks together.
        pieces: of ticks that were taken in pieces, by their rows.
        done: how many ticks have been taken.
        error: what the next one has failed with, half done; None for nothing.
    """

    ticks: Ticks
    pressure_Pa: Array
    stability_ratio: Array
    algorithmic_mass: Mask
    trials: IntArray
    interface_residual: Array
    scheme: Scheme = "staggered"
    parts: list[Sequence[Any]] = field(default_factory=list)
    pieces: dict[int, TickPieces] = field(default_factory=dict)
    done: int = 0
    error: BaseException | None = None

    @classmethod
    def room(cls, n: int, joints: int, bodies: int, chambers: int) -> "TicksTaken":
        """Return room for n ticks."""
        return cls(
            Ticks.room(n, joints, bodies), np.zeros((n, chambers)), np.zeros(n), np.zeros(n, dtype=bool),
            np.ones(n, np.int64), np.zeros(n),
        )  # fmt: skip

    @property
    def shapes(self) -> Sequence[Any]:
        """(done,), of the film."""
        return self.parts[0] if len(self.parts) == 1 else list(chain.from_iterable(self.parts))

    @property
    def wrench(self) -> Array:
        """(done, 6), of the soft side on the flange, at its origin, world axes."""
        return self.ticks.figures[1 : self.done + 1, WRENCH:CENTER]

    def mass(self) -> tuple[Array, Array]:
        """Return the soft side's centre of mass (done, 3) [m] and its inertia (done, 3, 3), world axes."""
        figures = self.ticks.figures[1 : self.done + 1]
        return figures[:, CENTER:INERTIA], figures[:, INERTIA:].reshape(-1, 3, 3)

    def begin(self, soft: SoftSide, wrench: Wrench, flange: Pose) -> None:
        """Fill what is there before the first tick."""
        mass, figures = soft.mass_properties(), self.ticks.figures[0]
        figures[WRENCH:CENTER] = *wrench.force, *wrench.torque
        figures[CENTER:INERTIA], figures[INERTIA:] = mass.center, mass.inertia.ravel()
        self.ticks.origin[0], self.ticks.axes[0] = flange.translation, flange.rotation

    def take(self, reply: SoftReply, soft: SoftSide) -> None:
        """Fill the row of the tick in progress with what a soft side has answered."""
        k, ticks, mass, films = self.done, self.ticks, soft.mass_properties(), soft.touching
        figures, wrench = ticks.figures[k + 1], reply.wrench
        figures[WRENCH:CENTER] = *wrench.force, *wrench.torque
        figures[CENTER:INERTIA], figures[INERTIA:] = mass.center, mass.inertia.ravel()
        ticks.residual[k], ticks.iterations[k] = reply.residual_N, reply.iterations
        ticks.work[k, 1:] = reply.films_work_J, reply.eyelets_J
        self.pressure_Pa[k] = soft.pressures_Pa
        if films is not None:
            ticks.self_contact[k] = films.count, films.normal_force_N, films.depth_m
        self.parts.append([soft.shape_now()])
        self.done += 1

    def last_entry(self) -> LedgerEntry:
        """Return what was exchanged in the last tick."""
        columns = {name: column.item(self.done - 1) for name, column in self.ledger().items()}
        figures = self.wrench[-1]
        return LedgerEntry(Wrench(figures[:3].copy(), figures[3:].copy()), **columns)

    def ledger(self) -> dict[str, Any]:
        """Return the columns (done,) of `LedgerEntry`, without the wrench."""
        n, ticks = self.done, self.ticks
        return {
            "rigid_power_W": ticks.power[:n, 0],
            "soft_power_W": ticks.power[:n, 1],
            "power_size_W": ticks.power[:n, 2],
            "residual_N": ticks.residual[:n],
            "newton_iterations": ticks.iterations[:n],
            "momentum_error": ticks.momentum_error[:n],
            "contacts": ticks.contacts[:n],
            "contact_force_N": ticks.contact[:n, 0],
            "contact_depth_m": ticks.contact[:n, 1],
            "contact_ratio": ticks.contact[:n, 2],
            "stability_ratio": self.stability_ratio[:n],
            "algorithmic_mass": self.algorithmic_mass[:n],
            "self_contacts": ticks.self_contact[:n, 0].astype(np.int64),
            "self_contact_force_N": ticks.self_contact[:n, 1],
            "self_contact_depth_m": ticks.self_contact[:n, 2],
            "contact_work_J": ticks.work[:n, 0],
            "self_contact_work_J": ticks.work[:n, 1],
            "eyelets_J": ticks.work[:n, 2],
            "scheme": np.full(n, self.scheme),
            "trials": self.trials[:n],
            "interface_residual": self.interface_residual[:n],
            "slides": np.zeros(n, np.int64),
        }
