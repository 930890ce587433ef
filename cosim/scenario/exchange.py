"""From the scenario's `[coupling]` to the scheme of exchange."""

from __future__ import annotations

from cosim.coupling.automatic import AutomaticCoupling
from cosim.coupling.coupling import Coupling
from cosim.coupling.interface import Interface
from cosim.coupling.interface_search import IterationOptions
from cosim.coupling.iterated import IteratedCoupling
from cosim.coupling.staggered import StaggeredCoupling
from cosim.scenario import coupling_schema


def make_coupling(settings: coupling_schema.Coupling, interface: Interface) -> Coupling:
    """Return the scheme that a scenario asks for."""
    options = IterationOptions(settings.tolerance, settings.iterations_max)
    if settings.scheme == "iterated":
        return IteratedCoupling(interface, options)
    if settings.scheme == "auto":
        return AutomaticCoupling(interface, options)
    return StaggeredCoupling(interface)


def exchange_report(settings: coupling_schema.Coupling) -> str:
    """Return in words how both sides exchange their loads."""
    if settings.scheme == "staggered":
        return "staggered, both ways at every tick"
    agreed = f"every tick repeated until the loads agree to {settings.tolerance:g}"
    if settings.scheme == "iterated":
        return f"iterated: {agreed}"
    return f"automatic: staggered; where that would need algorithmic mass, {agreed}"
