"""The suite: every case in the order of the table, and how one is run."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from cosim.errors import InputError, SolverError
from cosim.verification.cases.bowed_strip import BowedStrip
from cosim.verification.cases.capstan import Capstan
from cosim.verification.cases.catenary import Catenary
from cosim.verification.cases.euler_buckling import EulerBuckling, PostBuckling
from cosim.verification.cases.heavy_cantilever import HeavyCantilever
from cosim.verification.cases.inflated_beam import InflatedCantilever, InflatedThreePoint
from cosim.verification.cases.pouch_motor import PouchMotor
from cosim.verification.cases.pressed_ring import PressedRing
from cosim.verification.cases.rigid_motion import RigidMotion
from cosim.verification.cases.roll_up import RollUp
from cosim.verification.cases.sealed_gas import SealedGasSphere
from cosim.verification.cases.sealed_piston import SealedPiston
from cosim.verification.cases.self_buckling import SelfBuckling
from cosim.verification.cases.squeezed_tube import SqueezedTube
from cosim.verification.cases.tip_loaded_cantilever import TipLoadedCantilever
from cosim.verification.dynamic_cases.cantilever_modes import CantileverModes
from cosim.verification.dynamic_cases.coupled_tick import CoupledTick
from cosim.verification.dynamic_cases.free_flight import FreeFlight
from cosim.verification.dynamic_cases.pendulum import Pendulum, SwingingChain
from cosim.verification.dynamic_cases.shaken_beam import ShakenBeam
from cosim.verification.dynamic_cases.spinning_strip import SpinningStrip
from cosim.verification.dynamic_cases.time_order import TimeOrder
from cosim.verification.film_cases.framed_square import FramedSquare
from cosim.verification.film_cases.hencky_membrane import HenckyMembrane
from cosim.verification.film_cases.mylar_balloon import MylarBalloon
from cosim.verification.film_cases.pressurised_shells import PressurisedCylinder, PressurisedSphere
from cosim.verification.film_cases.rigid_seams import RigidSeams
from cosim.verification.film_cases.sheared_panel import ShearedPanel
from cosim.verification.film_cases.square_cushions import SquareAirbag, SquarePillow
from cosim.verification.film_cases.stack_films import PaperMesh, StackTensionField
from cosim.verification.film_cases.tilted_unit import TiltedUnit
from cosim.verification.film_cases.wrinkle_wavelength import WrinkleWavelength
from cosim.verification.film_cases.wrinkling_stacks import (
    FiveHexagons,
    OneSquare,
    StiffSquare,
    TenSquares,
    ThreeSquares,
)
from cosim.verification.support.case import Case, Figure

CASES: tuple[Case, ...] = (
    TipLoadedCantilever(),
    HeavyCantilever(),
    RollUp(),
    EulerBuckling(),
    PostBuckling(),
    SelfBuckling(),
    PressedRing(),
    Catenary(),
    Capstan(),
    BowedStrip(),
    PressurisedSphere(),
    PressurisedCylinder(),
    HenckyMembrane(),
    SealedGasSphere(),
    SealedPiston(),
    SqueezedTube(),
    PouchMotor(),
    InflatedCantilever(),
    InflatedThreePoint(),
    SquareAirbag(),
    MylarBalloon(),
    SquarePillow(),
    ShearedPanel(),
    WrinkleWavelength(),
    PaperMesh(),
    StackTensionField(),
    ThreeSquares(),
    OneSquare(),
    StiffSquare(),
    FiveHexagons(),
    TenSquares(),
    RigidSeams(),
    FramedSquare(),
    TiltedUnit(),
    RigidMotion(),
    CantileverModes(),
    SwingingChain(),
    Pendulum(),
    SpinningStrip(),
    ShakenBeam(),
    TimeOrder(),
    CoupledTick(),
    FreeFlight(),
)


@final
@dataclass(frozen=True)
class CaseResult:
    """What one case found.

    Args:
        case: which one.
        figures: its numbers; empty when it could not be solved.
        seconds: wall-clock time.
        failure: why it could not be solved; empty if it could.
    """

    case: Case
    figures: tuple[Figure, ...]
    seconds: float
    failure: str = ""

    @property
    def passed(self) -> bool:
        """Whether it was solved and every figure is within its tolerance."""
        return not self.failure and bool(self.figures) and all(figure.passed for figure in self.figures)


def select(names: Sequence[str], cases: Sequence[Case] = CASES) -> tuple[Case, ...]:
    """Return the named cases in the order asked for; all of them if none is named.

    Args:
        names: names of cases.
        cases: to choose from.

    Raises:
        InputError: there is no such case.
    """
    known = {case.name: case for case in cases}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError(f"no verification case {unknown[0]!r}; there are: {', '.join(known)}")
    return tuple(known[name] for name in names) if names else tuple(cases)


def run_case(case: Case) -> CaseResult:
    """Run one case; a case that cannot be solved has failed, and says why."""
    started = time.perf_counter()
    try:
        figures, failure = case.run(), ""
    except SolverError as error:
        figures, failure = (), str(error)
    return CaseResult(case, figures, time.perf_counter() - started, failure)
