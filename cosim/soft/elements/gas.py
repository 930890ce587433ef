"""Gas whose amount is given instead of its pressure: sealed chambers, leaks, chambers joined by an orifice.

Sealed, p V^gamma stays (p absolute). With the atmosphere p_a outside, the gas has the potential
    U(V) = p_a (V - V_0) + p_0 V_0 ((V_0 / V)^(gamma - 1) - 1) / (gamma - 1),
for gamma = 1: p_a (V - V_0) - p_0 V_0 ln(V / V_0). So dU/dV = -(p - p_a) and d2U/dV2 = gamma p / V > 0:
in the Hessian of a body the latter is the dense rank-one term (gamma p / V) grad V grad V^T.
gamma is 1 for slow (isothermal) and 1.4 for fast (adiabatic) changes of air.
Mass that flows out leaves with the state of the gas; mass that flows in arrives with the temperature of the
gas it joins. Flow is exchanged between steps, at the volumes of the moment and in closed form, so no step is
too long.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, final

from cosim.errors import InputError

STANDARD_ATMOSPHERE_Pa: Final = 101325.0
AIR_CONSTANT_J_kg_K: Final = 287.05


def absolute_pressure(pressure: float, volume_0: float, exponent: float, volume: float) -> float:
    """Return p [Pa] at a volume [m^3]; infinite where undefined; also compiled in kernels.

    Args:
        pressure: [Pa], at volume_0.
        volume_0: [m^3].
        exponent: gamma.
        volume: [m^3].
    """
    if not volume > 0.0:
        return math.inf
    return pressure * math.pow(volume_0 / volume, exponent)


def gas_potential(pressure: float, volume_0: float, exponent: float, ambient: float, volume: float) -> float:
    """Return U [J] at a volume [m^3], zero at volume_0; infinite where undefined; also compiled in kernels.

    Args:
        pressure: [Pa], at volume_0.
        volume_0: [m^3].
        exponent: gamma.
        ambient: p_a [Pa].
        volume: [m^3].
    """
    if not volume > 0.0:
        return math.inf
    growth, excess = math.log(volume / volume_0), exponent - 1.0
    # (e^(-excess growth) - 1) / excess, and its limit -growth
    work = math.expm1(-excess * growth) / excess if excess else -growth
    return ambient * (volume - volume_0) + pressure * volume_0 * work


@final
@dataclass(frozen=True)
class SealedGas:
    """An amount of ideal gas in a closed chamber, by one of its states.

    Args:
        pressure_Pa: absolute pressure at that volume.
        volume_m3: volume.
        exponent: gamma, 1 (isothermal) to 1.4 (adiabatic air) or above.
        ambient_Pa: absolute pressure outside.
        temperature_K: at that volume.
        gas_constant_J_kg_K: of the gas.

    Raises:
        InputError: a value that is not positive, or gamma below 1.
    """

    pressure_Pa: float
    volume_m3: float
    exponent: float = 1.4
    ambient_Pa: float = STANDARD_ATMOSPHERE_Pa
    temperature_K: float = 293.15
    gas_constant_J_kg_K: float = AIR_CONSTANT_J_kg_K

    def __post_init__(self) -> None:
        for name in ("pressure_Pa", "volume_m3", "temperature_K", "gas_constant_J_kg_K"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise InputError(f"{name} of a sealed gas is {getattr(self, name)}; it must be positive")
        if not 1.0 <= self.exponent < math.inf:
            raise InputError(f"exponent of a sealed gas is {self.exponent}; it must be at least 1")
        if not 0.0 <= self.ambient_Pa < math.inf:
            raise InputError(f"ambient_Pa is {self.ambient_Pa}; it must not be negative")

    @property
    def mass_kg(self) -> float:
        """Mass of the gas, p V / (R T)."""
        return self.pressure_Pa * self.volume_m3 / (self.gas_constant_J_kg_K * self.temperature_K)

    @property
    def numbers(self) -> tuple[float, float, float, float]:
        """Absolute pressure [Pa], volume [m^3], exponent and ambient pressure [Pa]."""
        return self.pressure_Pa, self.volume_m3, self.exponent, self.ambient_Pa

    def absolute_pressure(self, volume_m3: float) -> float:
        """Return p [Pa] at a volume [m^3]; infinite where undefined."""
        return absolute_pressure(self.pressure_Pa, self.volume_m3, self.exponent, volume_m3)

    def gauge_pressure(self, volume_m3: float) -> float:
        """Return the gauge pressure p - p_a [Pa] at a volume [m^3]."""
        return self.absolute_pressure(volume_m3) - self.ambient_Pa

    def potential(self, volume_m3: float) -> float:
        """Return U [J] at a volume [m^3], zero at the given state; infinite where there is no volume."""
        return gas_potential(*self.numbers, volume_m3)

    def at(self, volume_m3: float) -> SealedGas:
        """Return the same gas with its state at another volume [m^3].

        Raises:
            InputError: the volume is not positive.
        """
        pressure = self.absolute_pressure(volume_m3)
        heated = self.temperature_K * pressure * volume_m3 / (self.pressure_Pa * self.volume_m3)
        return replace(self, pressure_Pa=pressure, volume_m3=volume_m3, temperature_K=heated)

    def with_mass(self, mass_kg: float) -> SealedGas:
        """Return the gas with another mass [kg] at the same volume and temperature.

        Raises:
            InputError: the mass is not positive.
        """
        return replace(self, pressure_Pa=self.pressure_Pa * mass_kg / self.mass_kg)

    def towards(self, end: SealedGas, fraction: float) -> SealedGas:
        """Return a gas between this one and another, by pressure and temperature at this volume."""
        end_here = end.at(self.volume_m3)
        return replace(
            end_here,
            pressure_Pa=(1.0 - fraction) * self.pressure_Pa + fraction * end_here.pressure_Pa,
            temperature_K=(1.0 - fraction) * self.temperature_K + fraction * end_here.temperature_K,
        )


def leak(gas: SealedGas, volume_m3: float, conductance_kg_s_Pa: float, step_s: float) -> SealedGas:
    """Return the gas after it has leaked for a while, dm/dt = -c (p - p_a).

    At constant volume and temperature p - p_a decays as exp(-c R T t / V), exactly for any step.

    Args:
        gas: before.
        volume_m3: of the chamber.
        conductance_kg_s_Pa: c, at least 0.
        step_s: time.
    """
    gas_now = gas.at(volume_m3)
    rise = gas_now.pressure_Pa / gas_now.mass_kg  # dp/dm = R T / V
    fraction = -math.expm1(-conductance_kg_s_Pa * rise * step_s)
    return gas_now.with_mass(gas_now.mass_kg - fraction * (gas_now.pressure_Pa - gas_now.ambient_Pa) / rise)


def exchange(
    gases: tuple[SealedGas, SealedGas],
    volumes_m3: tuple[float, float],
    conductance_kg_s_Pa: float,
    step_s: float,
) -> tuple[SealedGas, SealedGas]:
    """Return two gases after mass has flowed through an orifice: dm_2/dt = c (p_1 - p_2) = -dm_1/dt.

    At constant volumes and temperatures p_1 - p_2 decays as exp(-c (R T_1 / V_1 + R T_2 / V_2) t).

    Args:
        gases: before.
        volumes_m3: of their chambers.
        conductance_kg_s_Pa: c, at least 0.
        step_s: time.
    """
    first, second = (gas.at(volume) for gas, volume in zip(gases, volumes_m3, strict=True))
    rise = first.pressure_Pa / first.mass_kg + second.pressure_Pa / second.mass_kg
    fraction = -math.expm1(-conductance_kg_s_Pa * rise * step_s)
    moved = fraction * (first.pressure_Pa - second.pressure_Pa) / rise
    return first.with_mass(first.mass_kg - moved), second.with_mass(second.mass_kg + moved)
