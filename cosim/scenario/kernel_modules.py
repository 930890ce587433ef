"""Which kernels a scenario needs beside those of every run, for compilation ahead of it."""

from __future__ import annotations

from types import ModuleType

from cosim.scenario.schema import NO_ARM, Scenario


def kernel_modules(scenario: Scenario) -> tuple[ModuleType, ...]:
    """Return the modules with kernels that some scenarios do without; those of others are not imported."""
    modules: tuple[ModuleType, ...] = ()
    if scenario.contact.self_contact:
        from cosim.soft import film_contact, film_points, film_search

        modules = (film_contact, film_points, film_search)
    if scenario.fidelity == "section":
        from cosim.soft.section import (
            assembly,
            chain_contact,
            chain_figures,
            chain_shapes,
            energy,
            implicit_step,
            pressure_spline,
        )

        modules += (
            assembly, chain_contact, chain_figures, chain_shapes, energy, implicit_step, pressure_spline,
        )  # fmt: skip
    if scenario.robot != NO_ARM:
        from cosim.rigid.compilation import KERNEL_MODULES  # here: it brings MuJoCo

        modules += KERNEL_MODULES
        if scenario.fidelity == "section" and scenario.mode == "dynamic":
            from cosim.coupling import lockstep_kernel

            modules += (lockstep_kernel,)
    return modules
