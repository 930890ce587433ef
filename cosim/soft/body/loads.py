"""Loads on a soft body at one instant."""

from dataclasses import dataclass, fields, replace
from functools import cache, cached_property
from typing import Annotated, Any, Final, NamedTuple, TypeVar, final

import numpy as np

from cosim.base.frames import Array
from cosim.base.kernel_types import Vector
from cosim.errors import InputError
from cosim.soft.contact import obstacle_contact, self_contact_pairs
from cosim.soft.elements.element import NodalPotential
from cosim.soft.elements.gas import SealedGas

Value = TypeVar("Value")
Amount = TypeVar("Amount", float, Array)

PLAIN: Final = {"pressure_Pa", "cable_tension_N", "gravity"}


class PlainLoads(NamedTuple):
    """Plain loads (pressures, tensions and gravity alone) for kernels.

    Args:
        pressure: (chambers,) [Pa].
        tension: (cables,) [N], at their base ends.
        gravity: (3,) [m/s^2].
    """

    pressure: Vector
    tension: Vector
    gravity: Vector


@final
@dataclass(frozen=True)
class Loads:
    """Loads on a body at one instant.

    Args:
        pressure_Pa: gauge pressure of the gas in each chamber; empty for zero in all.
        cable_tension_N: tension of each cable at its base end; ignored if its length is commanded.
        gravity: (3,) [m/s^2].
        nodal_force: (n, 3) [N], dead load (it keeps its direction), world axes; None for none.
        gas: sealed in each chamber, which needs a closed body; None for a commanded pressure, empty if no gas
            is sealed.
        contact: possible contacts with obstacles; None for none.
        cable_length_m: unstretched length of each cable with commanded length, None for one with commanded
            tension; empty if no length is commanded.
        cable_stiffening: q of each cable in a step, see `cable`; empty for 1.
        self_contact: possible pairs of films in contact; None for none.
        extra: a further potential, such as springs; None for none.

    Raises:
        InputError: a negative tension (cables cannot push), or a length that is not above 0.
    """

    pressure_Pa: tuple[float, ...] = ()
    cable_tension_N: Annotated[tuple[float, ...], ("cables",)] = ()
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    nodal_force: Annotated[Array, ("nodes", 3)] | None = None
    gas: tuple[SealedGas | None, ...] = ()
    contact: obstacle_contact.ContactPlanes | None = None
    cable_length_m: tuple[float | None, ...] = ()
    cable_stiffening: tuple[float, ...] = ()
    self_contact: self_contact_pairs.FilmPairs | None = None
    extra: NodalPotential | None = None

    def __post_init__(self) -> None:
        if self.cable_tension_N and not all(tension >= 0.0 for tension in self.cable_tension_N):
            raise InputError(
                f"cable tensions are {self.cable_tension_N} N; a cable cannot push, give 0 or more"
            )
        lengths = self.cable_length_m
        if lengths and not all(length is None or length > 0.0 for length in lengths):
            raise InputError(f"cable lengths are {self.cable_length_m} m; they must be above 0")

    @cached_property
    def gravity_vector(self) -> Array:
        """Gravity (3,) [m/s^2]."""
        return np.array(self.gravity)

    @property
    def plain(self) -> bool:
        """Whether it `is_plain`."""
        return self.contact is None and self.self_contact is None and self.plain_but_contact

    @cached_property
    def plain_but_contact(self) -> bool:
        """Whether it is plain except contacts and self-contact."""
        return is_plain(self, but=("contact", "self_contact"))

    def touching(self, contact: obstacle_contact.ContactPlanes | None) -> "Loads":
        """Return these loads with possible contacts."""
        return self if contact is self.contact else self._with(contact=contact)

    def with_films(self, films: self_contact_pairs.FilmPairs | None) -> "Loads":
        """Return these loads with possible pairs of films in contact."""
        return self if films is self.self_contact else self._with(self_contact=films)

    def _with(self, **contacts: Any) -> "Loads":
        """Return these loads with other contacts, without repeating checks and conversions."""
        loads = object.__new__(Loads)
        loads.__dict__.update(self.__dict__, **contacts)
        return loads

    def arrays(self, chambers: int) -> PlainLoads:
        """Return pressures of the chambers, tensions and gravity, without other loads."""
        pressure = np.array(self.pressures(chambers))
        return PlainLoads(pressure, np.array(self.cable_tension_N), self.gravity_vector)

    def pressures(self, chambers: int) -> tuple[float, ...]:
        """Return the commanded gauge pressure [Pa] of each chamber.

        Raises:
            InputError: there are more or fewer values than chambers.
        """
        return _of_each(self.pressure_Pa, 0.0, chambers, "pressure")

    def gases(self, chambers: int) -> tuple[SealedGas | None, ...]:
        """Return the sealed gas of each chamber, None for a commanded pressure.

        Raises:
            InputError: there are more or fewer values than chambers.
        """
        return _of_each(self.gas, None, chambers, "gas")

    def pressures_at(self, volumes_m3: tuple[float, ...]) -> tuple[float, ...]:
        """Return the gauge pressure [Pa] in each chamber, that of sealed gases at these volumes [m^3]."""
        commanded = self.pressures(len(volumes_m3))
        gases = zip(self.gases(len(volumes_m3)), commanded, volumes_m3, strict=True)
        return tuple(p if gas is None else gas.gauge_pressure(volume) for gas, p, volume in gases)

    def grown(self, growth: float, volumes_m3: tuple[float, ...]) -> "Loads":
        """Return these loads times 1 + growth; commanded lengths and contacts do not change.

        Args:
            growth: relative; -1 removes the loads.
            volumes_m3: of the chambers, at which the gauge pressure of sealed gas grows.
        """
        factor = 1.0 + growth
        gases = zip(self.gas, self.pressures_at(volumes_m3), volumes_m3, strict=True) if self.gas else ()
        gx, gy, gz = (factor * component for component in self.gravity)
        return replace(
            self,
            pressure_Pa=tuple(factor * p for p in self.pressure_Pa),
            cable_tension_N=tuple(factor * tension for tension in self.cable_tension_N),
            gravity=(gx, gy, gz),
            nodal_force=None if self.nodal_force is None else factor * self.nodal_force,
            gas=tuple(
                None if gas is None else replace(gas.at(volume), pressure_Pa=gas.ambient_Pa + factor * p)
                for gas, p, volume in gases
            ),
        )

    def interpolated(self, end: "Loads", load_factor: float) -> "Loads":
        """Return the loads between these and others at a load factor; exactly the others at 1.

        Between two sealed gases the mass changes at the first one's volume. Sealing a gas, and the change of
        a cable from commanded tension to commanded length, happen at once.
        """
        if load_factor >= 1.0:
            return end
        pulls = zip(self.cable_tension_N, end.cable_tension_N, strict=True)
        tension = tuple(float(between(a, b, load_factor)) for a, b in pulls)
        pairs = zip(self.gravity, end.gravity, strict=True)
        gx, gy, gz = (float(between(a, b, load_factor)) for a, b in pairs)
        chambers = max(len(self.pressure_Pa), len(end.pressure_Pa))
        pressures = zip(self.pressures(chambers), end.pressures(chambers), strict=True)
        pressure = tuple(between(a, b, load_factor) for a, b in pressures)
        force = force_between(self.nodal_force, end.nodal_force, load_factor)
        gas = _gases(self.gas, end.gas, load_factor)
        lengths = _lengths(self.cable_length_m, end.cable_length_m, load_factor)
        return replace(
            end, pressure_Pa=pressure, cable_tension_N=tension, gravity=(gx, gy, gz), nodal_force=force,
            gas=gas, cable_length_m=lengths,
        )  # fmt: skip


def is_plain(load: object, *, but: tuple[str, ...] = ()) -> bool:
    """Return whether only pressures, tensions and gravity act; all other fields have their defaults.

    Args:
        load: `Loads`, or the loads of a command.
        but: names of fields that may act in addition.
    """
    kind: Any = type(load)
    for name, default in _other_fields(kind):  # a loop for speed: called in every tick
        value = getattr(load, name)
        as_default = value is default or (isinstance(value, tuple) and value == default)
        if not as_default and name not in but:
            return False
    return True


@cache
def _other_fields(kind: Any) -> tuple[tuple[str, Any], ...]:
    """Return names and defaults of the fields other than pressures, tensions and gravity."""
    return tuple((entry.name, entry.default) for entry in fields(kind) if entry.name not in PLAIN)


def _of_each(values: tuple[Value, ...], missing: Value, count: int, name: str) -> tuple[Value, ...]:
    """Return a value for each of `count` chambers: `values`, or `missing` for each if `values` is empty."""
    if not values:
        return (missing,) * count
    if len(values) != count:
        raise InputError(f"{name}: {len(values)} values for {count} chambers; give one for each")
    return values


def between(begin: Amount, end: Amount, load_factor: float) -> Amount:
    """Return a value or array at a load factor, 0 to 1; exactly the first where both are equal."""
    return begin + load_factor * (end - begin)


def force_between(begin: Array | None, end: Array | None, load_factor: float) -> Array | None:
    """Return nodal forces (n, 3) [N] at a load factor, 0 to 1; None means zero."""
    if begin is None:
        return None if end is None else load_factor * end
    if end is None:
        return (1.0 - load_factor) * begin
    return between(begin, end, load_factor)


def _gases(
    begin: tuple[SealedGas | None, ...], end: tuple[SealedGas | None, ...], load_factor: float
) -> tuple[SealedGas | None, ...]:
    """Return the sealed gases between two; if either end has none, those at the end."""
    if not begin or not end:
        return end
    return tuple(
        b if a is None or b is None else a.towards(b, load_factor) for a, b in zip(begin, end, strict=True)
    )


def _lengths(
    begin: tuple[float | None, ...], end: tuple[float | None, ...], load_factor: float
) -> tuple[float | None, ...]:
    """Return the commanded lengths between two, of the cables that have one at the end."""
    if len(begin) != len(end):
        return end
    return tuple(
        b if a is None or b is None else between(a, b, load_factor) for a, b in zip(begin, end, strict=True)
    )
