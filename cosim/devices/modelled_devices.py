"""Names of the devices of a scenario, and text on how they are modelled."""

from cosim.config.schema.devices import WinchTable
from cosim.config.schema.scenario import Scenario
from cosim.devices import sensor
from cosim.devices.device_report import DeviceNames


def device_names(scenario: Scenario) -> DeviceNames | None:
    """Return the names of a scenario's devices; None without any."""
    lengths = any(phase.commands_lengths for phase in scenario.phases) or any(
        entry.kind == "python" or entry.commands == "cable_shortening_m" for entry in scenario.controllers
    )
    lengths = lengths or bool(scenario.winches)
    if not (lengths or scenario.pumps or scenario.controllers):
        return None
    controllers = tuple(
        (entry.name, "" if entry.kind == "python" else entry.measures) for entry in scenario.controllers
    )
    pumps = tuple(entry.name for entry in scenario.pumps)
    return DeviceNames(pumps, controllers, lengths, bool(scenario.winches))


def device_report(scenario: Scenario) -> dict[str, str]:
    """Return text on the devices and sensors of a scenario, by heading; empty without any."""
    lines = {"Pumps": _pumps(scenario), "Cables": _cables(scenario), "Controllers": _controllers(scenario)}
    lines["Sensors"] = sensor.sensor_report(scenario)
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
    return "; ".join(
        f"winch {winch.name} on {', '.join(winch.cables)}{_one_motor(winch)}, "
        f"{1e6 * winch.step_m:.3g} um a step, "
        f"at most {1e3 * winch.speed_m_s:.3g} mm/s, stalls at {winch.stall_force_N:.3g} N"
        for winch in scenario.winches
    )


def _one_motor(winch: WinchTable) -> str:
    return " by one motor" if winch.one_motor else ""


def _controllers(scenario: Scenario) -> str:
    texts = []
    for entry in scenario.controllers:
        rate = f"every {1e3 * entry.period_s:g} ms"
        if entry.kind == "python":
            texts.append(f"{entry.name}, in Python, {rate}")
        else:
            moves = f"{entry.commands} of {', '.join(entry.cables)}" if entry.cables else entry.commands
            texts.append(f"{entry.name}, {entry.kind}, {entry.measures} by {moves}, {rate}")
    return "; ".join(texts)
