"""What acts on a soft body at one instant."""

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
    """Loads that are plain, for kernels.

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
    """What acts on a body at one instant.

    Args:
        pressure_Pa: gauge pressure of the gas in each chamber; empty for none in any.
        cable_tension_N: tension of each cable at its base end; without meaning where its length is commanded.
        gravity: (3,) [m/s^2].
        nodal_force: (n, 3) [N], dead load (it keeps its direction), world axes; None for none.
        gas: sealed in each chamber in place of its pressure, which needs a closed body; None where the
            pressure is given, empty where it is given in all.
        contact: what may be touched; None for nothing.
        cable_length_m: unstretched length of each cable whose length is commanded, None for one whose tension
            is; empty where no length is.
        cable_stiffening: q of each cable in a step, see `cable`; empty: 1 of all.
        self_contact: films that may touch one another; None for none.
        extra: a further potential, such as springs; None for none.

    Raises:
        InputError: a negative tension: cables cannot push; a length that is not above 0.
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
        """Whether it is plain but for what may be touched, films among one another included."""
        return is_plain(self, but=("contact", "self_contact"))

    def touching(self, contact: obstacle_contact.ContactPlanes | None) -> "Loads":
        """Return these loads with what may be touched."""
        return self if contact is self.contact else self._with(contact=contact)

    def with_films(self, films: self_contact_pairs.FilmPairs | None) -> "Loads":
        """Return these loads with films that may touch one another."""
        return self if films is self.self_contact else self._with(self_contact=films)

    def _with(self, **contacts: Any) -> "Loads":
        """Return these loads with other contacts; nothing is checked, or made an array, once more."""
        made = object.__new__(Loads)
        made.__dict__.update(self.__dict__, **contacts)
        return made

    def arrays(self, chambers: int) -> PlainLoads:
        """Return pressures of so many chambers, tensions and gravity, whatever else there is."""
        pressure = np.array(self.pressures(chambers))
        return PlainLoads(pressure, np.array(self.cable_tension_N), self.gravity_vector)

    def pressures(self, chambers: int) -> tuple[float, ...]:
        """Return the given gauge pressure [Pa] of each of so many chambers.

        Raises:
            InputError: there are more or fewer values than chambers.
        """
        return _of_each(self.pressure_Pa, 0.0, chambers, "pressure")

    def gases(self, chambers: int) -> tuple[SealedGas | None, ...]:
        """Return the sealed gas of each of so many chambers, None where the pressure is given.

        Raises:
            InputError: there are more or fewer values than chambers.
        """
        return _of_each(self.gas, None, chambers, "gas")

    def pressures_at(self, volumes_m3: tuple[float, ...]) -> tuple[float, ...]:
        """Return the gauge pressure [Pa] in each chamber, that of sealed gases at these volumes [m^3]."""
        given = self.pressures(len(volumes_m3))
        gases = zip(self.gases(len(volumes_m3)), given, volumes_m3, strict=True)
        return tuple(p if gas is None else gas.gauge_pressure(volume) for gas, p, volume in gases)

    def grown(self, share: float, volumes_m3: tuple[float, ...]) -> "Loads":
        """Return these loads grown by a share; commanded lengths stay, and what is touched.

        Args:
            share: -1 to take them off.
            volumes_m3: of the chambers, at which the gauge pressure of sealed gas grows.
        """
        factor = 1.0 + share
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
        """Return the loads on the way to others at a load factor; exactly those at 1.

        Between two sealed gases the mass changes at the first one's volume; sealing is done at once, and so
        is the change of a cable from commanded tension to commanded length.
        """
        if load_factor >= 1.0:
            return end
        pulls = zip(self.cable_tension_N, end.cable_tension_N, strict=True)
        tension = tuple(float(between(a, b, load_factor)) for a, b in pulls)
        pairs = zip(self.gravity, end.gravity, strict=True)
        gx, gy, gz = (float(between(a, b, load_factor)) for a, b in pairs)
        chambers = max(len(self.pressure_Pa), len(end.pressure_Pa))
        given = zip(self.pressures(chambers), end.pressures(chambers), strict=True)
        pressure = tuple(between(a, b, load_factor) for a, b in given)
        force = force_between(self.nodal_force, end.nodal_force, load_factor)
        gas = _gases(self.gas, end.gas, load_factor)
        lengths = _lengths(self.cable_length_m, end.cable_length_m, load_factor)
        return replace(
            end, pressure_Pa=pressure, cable_tension_N=tension, gravity=(gx, gy, gz), nodal_force=force,
            gas=gas, cable_length_m=lengths,
        )  # fmt: skip


def is_plain(load: object, *, but: tuple[str, ...] = ()) -> bool:
    """Return whether pressures, tensions and gravity are all that acts: all else as if it was not given.

    Args:
        load: `Loads`, or what a command says of them.
        but: names of what may act besides.
    """
    kind: Any = type(load)
    for name, default in _besides(kind):  # a loop: asked of every tick's loads
        value = getattr(load, name)
        as_default = value is default or (isinstance(value, tuple) and value == default)
        if not as_default and name not in but:
            return False
    return True


@cache
def _besides(kind: Any) -> tuple[tuple[str, Any], ...]:
    """Return names and defaults of what loads hold besides pressures, tensions and gravity."""
    return tuple((entry.name, entry.default) for entry in fields(kind) if entry.name not in PLAIN)


def _of_each(values: tuple[Value, ...], missing: Value, count: int, what: str) -> tuple[Value, ...]:
    """Return a value for each of so many chambers: the given ones, or what represents none given."""
    if not values:
        return (missing,) * count
    if len(values) != count:
        raise InputError(f"{what}: {len(values)} values for {count} chambers; give one for each")
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
    """Return the sealed gases between two; where either end has none, what is at the end."""
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
