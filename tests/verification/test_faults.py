"""Every case of the suite notices a fault in the model: each fault is put in and must be found."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from cosim.base.kernel_types import Blocks, IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel
from cosim.coupling import film_ticks, half_ticks
from cosim.coupling.schemes import interface
from cosim.coupling.ticks import Ticks
from cosim.reduced.sections.assembly import WRENCH
from cosim.soft.body.loads import Loads
from cosim.soft.elements import cable, mass_terms
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.gas import SealedGas
from cosim.soft.elements.material import Film
from cosim.soft.film import film_terms
from cosim.soft.film.step_arrays import FilmArrays
from cosim.soft.solve import assembly
from cosim.soft.solve.state import StepOptions
from cosim.verification.suite import CASES, run_case, select

Fault = Callable[[pytest.MonkeyPatch], None]


def in_place_of(patch: pytest.MonkeyPatch, module: ModuleType, true: Any, faulty: Any) -> None:
    """Put a faulty kernel in the place of a true one: where terms are summed one by one, and all in one."""
    patch.setattr(module, true.py_func.__name__, faulty)
    called = [faulty if term is true else term for term in film_terms._CALLED]
    patch.setattr(film_terms, "_CALLED", tuple(called))


def with_film(patch: pytest.MonkeyPatch, name: str, factor: float) -> None:
    """Multiply one of the arrays by which kernels know a film."""
    true = assembly.film_arrays

    def faulty(*given: Any) -> FilmArrays:
        film = true(*given)
        return film._replace(**{name: factor * getattr(film, name)})

    patch.setattr(assembly, "film_arrays", faulty)


def stiff_hinges(patch: pytest.MonkeyPatch) -> None:
    """Hinges 2 % too stiff."""
    with_film(patch, "hinge_stiffness", 1.02)


def undivided_bending(patch: pytest.MonkeyPatch) -> None:
    """The 12 is missing in the film's flexural rigidity."""
    true = Film.flexural_rigidity_Nm.fget
    assert true is not None
    patch.setattr(Film, "flexural_rigidity_Nm", property(lambda self: 12.0 * true(self)))


def strong_pressure(patch: pytest.MonkeyPatch) -> None:
    """Gas pushes 5 % too hard."""
    true = Loads.pressures
    patch.setattr(Loads, "pressures", lambda self, n: tuple(1.05 * p for p in true(self, n)))


def stiff_gas(patch: pytest.MonkeyPatch) -> None:
    """A sealed gas is 3 % too stiff."""
    true = SealedGas.numbers.fget
    assert true is not None
    patch.setattr(
        SealedGas, "numbers", property(lambda self: (*true(self)[:2], 1.03 * true(self)[2], true(self)[3]))
    )


def stiff_film(patch: pytest.MonkeyPatch) -> None:
    """Film 5 % too stiff."""
    true = Film.membrane_stiffness.fget
    assert true is not None
    patch.setattr(Film, "membrane_stiffness", property(lambda self: 1.05 * true(self)))


def film_without_wrinkles(patch: pytest.MonkeyPatch) -> None:
    """The tension field is ignored."""
    patch.setattr(Film, "law_code", property(lambda _self: 0))


def heavy_nodes(patch: pytest.MonkeyPatch) -> None:
    """Weight 2 % too large."""
    with_film(patch, "mass", 1.02)


def half_wrap(patch: pytest.MonkeyPatch) -> None:
    """Friction of cables sees half of the wrap angle."""
    true = Cable.tension_ratio
    patch.setattr(Cable, "tension_ratio", lambda self, x: np.sqrt(true(self, x)))


def one_sided_cables(patch: pytest.MonkeyPatch) -> None:
    """Cables pull 0.1 % less at their near ends than at their far ones."""
    true = device_function(cable.add_segments.py_func)

    @kernel
    def unbalanced(
        x: Matrix, segments: IndexTable, tension: Vector, slots: IndexTable, gradient: Matrix, blocks: Blocks
    ) -> float:
        if segments.shape[0] == 0:
            return 0.0
        near = segments[0, 0]
        before = gradient[near, 0], gradient[near, 1], gradient[near, 2]
        energy = true(x, segments, tension, slots, gradient, blocks)
        for r in range(3):
            gradient[near, r] -= 0.001 * (gradient[near, r] - before[r])
        return energy

    in_place_of(patch, cable, cable.add_segments, unbalanced)


def first_order_steps(patch: pytest.MonkeyPatch) -> None:
    """BDF2 forgets its second last state: it is implicit Euler."""
    true = StepOptions.bed
    patch.setattr(StepOptions, "bed", lambda self, step_s, **_given: true(self, step_s, first=True))


def heavy_inertia(patch: pytest.MonkeyPatch) -> None:
    """Inertia 2 % too large."""
    true = device_function(mass_terms.add_inertia.py_func)

    @kernel(allocates=True)
    def heavy(
        x: Matrix, coefficient: Vector, target: Matrix, diagonal: Indices, gradient: Matrix, blocks: Blocks
    ) -> float:
        return true(x, 1.02 * coefficient, target, diagonal, gradient, blocks)

    in_place_of(patch, mass_terms, mass_terms.add_inertia, heavy)


def weak_wrench(patch: pytest.MonkeyPatch) -> None:
    """The arm feels 98 % of the soft side's wrench."""
    true = device_function(half_ticks.hand_over.py_func)

    @kernel
    def weak(acted: Vector, ticks: Ticks, k: int) -> None:
        true(acted, ticks, k)
        for r in range(WRENCH, WRENCH + 6):
            ticks.figures[k + 1, r] *= 0.98

    called = [weak if one is half_ticks.hand_over else one for one in film_ticks._CALLED]
    patch.setattr(film_ticks, "_CALLED", tuple(called))
    patch.setattr(interface, "hand_over", weak)


FOUND_BY: dict[Fault, set[str]] = {
    stiff_hinges: {
        "tip_loaded_cantilever",
        "heavy_cantilever",
        "roll_up",
        "euler_buckling",
        "post_buckling",
        "cantilever_modes",
        "self_buckling",
        "pressed_ring",
        "bowed_strip",
    },
    undivided_bending: {"wrinkle_wavelength"},
    strong_pressure: {
        "pressurised_sphere",
        "pressurised_cylinder",
        "hencky_membrane",
        "squeezed_tube",
        "pouch_motor",
        "paper_mesh",
    },
    stiff_film: {
        "pressurised_sphere",
        "pressurised_cylinder",
        "rubber_balloon",
        "inflated_cantilever",
        "inflated_three_point",
        "woven_cylinder",
    },
    film_without_wrinkles: {
        "square_airbag",
        "mylar_balloon",
        "square_pillow",
        "sheared_panel",
        "stack_tension_field",
        "three_squares",
        "one_square",
        "stiff_square",
        "five_hexagons",
        "ten_squares",
        "rigid_seams",
        "framed_square",
        "tilted_unit",
    },
    heavy_nodes: {"heavy_cantilever", "catenary", "self_buckling", "swinging_chain", "pendulum"},
    stiff_gas: {"sealed_gas", "sealed_piston"},
    half_wrap: {"capstan"},
    one_sided_cables: {"rigid_motion", "free_flight"},
    first_order_steps: {"time_order", "free_flight"},
    heavy_inertia: {"spinning_strip", "shaken_beam"},
    weak_wrench: {"coupled_tick"},
}


@pytest.mark.parametrize("fault", FOUND_BY, ids=lambda fault: fault.__name__)
def test_the_fault_is_found(fault: Fault, monkeypatch: pytest.MonkeyPatch) -> None:
    fault(monkeypatch)
    cases = select(sorted(FOUND_BY[fault]))
    assert [case.name for case in cases if run_case(case).passed] == []


def test_every_case_finds_a_fault() -> None:
    assert {case.name for case in CASES} == set().union(*FOUND_BY.values())
