"""Says which devices a scenario models."""

from __future__ import annotations

from cosim.config.rules.device_rules import uses_lengths
from cosim.config.schema.scenario import Scenario
from cosim.devices.device_build import build_winch
from cosim.devices.device_report import DeviceNames


def device_names(scenario: Scenario) -> DeviceNames | None:
    """Return what of devices there is to show; None where nothing is."""
    lengths = any(map(uses_lengths, scenario.phases)) or any(
        entry.kind == "python" or entry.commands == "cable_shortening_m" for entry in scenario.controllers
    )
    if not (lengths or scenario.pumps or scenario.controllers):
        return None
    controllers = tuple(
        (entry.name, "" if entry.kind == "python" else entry.measures) for entry in scenario.controllers
    )
    pumps = tuple(entry.name for entry in scenario.pumps)
    return DeviceNames(pumps, controllers, lengths, lengths and bool(scenario.winches))


def device_report(scenario: Scenario) -> dict[str, str]:
    """Return in words what is modelled of pumps, winches and controllers, by heading; empty without any."""
    lines = {"Pumps": _pumps(scenario), "Cables": _cables(scenario), "Controllers": _controllers(scenario)}
    return {heading: text for heading, text in lines.items() if text}


def _pumps(scenario: Scenario) -> str:
    return "; ".join(
        f"{entry.name}, {1e6 * entry.flow_kg_s:g} mg/s, band {1e-3 * entry.band_Pa:g} kPa, sensor "
        f"{1e3 * entry.sensor_delay_s:g} ms late"
        for entry in scenario.pumps
    )


def _cables(scenario: Scenario) -> str:
    names = device_names(scenario)
    if names is None or not names.lengths:
        return ""
    if not scenario.winches:
        return "lengths commanded in places, without a winch: at once"
    winches = ((entry, build_winch(entry)) for entry in scenario.winches)
    return "; ".join(
        f"winch {entry.name} on {', '.join(entry.cables)}, {1e6 * winch.step_m:.3g} um a step, at most "
        f"{1e3 * winch.speed_m_s:.3g} mm/s, stalls at {winch.stall_force_N:.3g} N"
        for entry, winch in winches
    )


def _controllers(scenario: Scenario) -> str:
    texts = []
    for entry in scenario.controllers:
        rate = f"every {1e3 * entry.period_s:g} ms"
        if entry.kind == "python":
            texts.append(f"{entry.name}, in Python, {rate}")
        else:
            moves = f"{entry.commands} of {', '.join(entry.cables)}"
            texts.append(f"{entry.name}, {entry.kind}, {entry.measures} by {moves}, {rate}")
    return "; ".join(texts)
