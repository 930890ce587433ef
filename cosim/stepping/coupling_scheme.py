"""From the scenario's `[coupling]` to the scheme of exchange."""

from __future__ import annotations

from cosim.config.schema import coupling as coupling_schema
from cosim.coupling.schemes.automatic import AutomaticCoupling
from cosim.coupling.schemes.fixed_point_search import IterationOptions
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.schemes.iterated import IteratedCoupling
from cosim.coupling.schemes.scheme import Coupling
from cosim.coupling.schemes.staggered import StaggeredCoupling


def make_coupling(settings: coupling_schema.CouplingTable, interface: Interface) -> Coupling:
    """Return the scheme that a scenario asks for."""
    options = IterationOptions(settings.tolerance, settings.iterations_max)
    if settings.scheme == "iterated":
        return IteratedCoupling(interface, options)
    if settings.scheme == "auto":
        return AutomaticCoupling(interface, options)
    return StaggeredCoupling(interface)


def exchange_report(settings: coupling_schema.CouplingTable) -> str:
    """Return in words how both sides exchange their loads."""
    if settings.scheme == "staggered":
        return "staggered, both ways at every tick"
    agreed = f"every tick repeated until the loads agree to {settings.tolerance:g}"
    if settings.scheme == "iterated":
        return f"iterated: {agreed}"
    return f"automatic: staggered; where that would need algorithmic mass, {agreed}"
