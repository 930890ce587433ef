"""Coefficients of friction between pairs of bodies, and between bodies and the film. MuJoCo uses the larger
of two coefficients, or that of the geom with priority. For pairs with another coefficient the model gets an
explicit contact pair, whose other parameters are those that MuJoCo would mix.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray

FILM: Final = "film"
_RULES: Final[dict[str, Callable[[Array, Array], Array]]] = {
    "largest": np.maximum,
    "smallest": np.minimum,
    "mean": lambda a, b: 0.5 * (a + b),
    "root": lambda a, b: np.sqrt(a * b),
}
_NO_WEIGHT: Final = 1e-15  # sum of the geoms' solmix below which both have half


@final
@dataclass(frozen=True)
class PairFriction:
    """Rule that combines the coefficients of two surfaces.

    Args:
        rule: "largest", "smallest", "mean" or "root" (of the product).
        film: coefficient of the film; None: that of the touched body.
        pairs: names of two bodies and the coefficient between them, in place of the combined one.
    """

    rule: str = "largest"
    film: float | None = None
    pairs: tuple[tuple[str, str, float], ...] = ()

    def between(self, names: tuple[str, str], mu: tuple[float, float]) -> float:
        """Return the coefficient of a pair.

        Args:
            names: of the two bodies.
            mu: their coefficients.
        """
        return float(self._of(np.array(names)[:, None], np.array(mu)[:, None])[0])

    def on_film(self, names: Sequence[str], mu: Array) -> Array:
        """Return the coefficients (k,) between film and bodies.

        Args:
            names: of the bodies.
            mu: (k,), their coefficients.
        """
        film = mu if self.film is None else np.full(len(mu), self.film)
        both = np.array([names, [FILM] * len(mu)]).reshape(2, -1)
        return self._of(both, np.stack([mu, film]))

    def _of(self, names: Array, mu: Array) -> Array:
        """Return the coefficients (k,) of pairs: names (2, k), coefficients (2, k)."""
        combined = np.array(_RULES[self.rule](*mu))
        for one, other, coefficient in self.pairs:
            first, second = names
            is_pair = ((first == one) & (second == other)) | ((first == other) & (second == one))
            combined[is_pair] = coefficient
        return combined

    def add_contacts(self, spec: mujoco.MjSpec, mounted: Sequence[str], wires: Sequence[str]) -> None:
        """Add an explicit contact pair for geoms between which MuJoCo would use another coefficient.

        The priority of mounted bodies affects the stiffness of their contacts, not friction. A geom to which
        a cell's file gives priority keeps its coefficient.

        Args:
            spec: complete specification.
            mounted: names of bodies on the flange.
            wires: names of the wires, whose bodies are called NAME/1, NAME/2, ...
        """
        geoms = [geom for geom in spec.geoms if geom.contype or geom.conaffinity]
        decides = [geom.friction[0] for geom in geoms if geom.parent.name in mounted]
        largest = max((geom.friction[0] for geom in geoms), default=0.0)
        if not self.pairs and self.rule == "largest" and min(decides, default=largest) >= largest:
            return
        model = spec.compile()
        both = _meeting(model)
        names, mu = np.array(body_names(model, range(model.ngeom), wires)), model.geom_friction[:, 0]
        wanted, of_mujoco = self._of(names[both], mu[both]), _mujoco_friction(model, both)
        priority = np.where(np.isin(names, mounted), 0, model.geom_priority)[both]
        wanted = np.where(priority[0] == priority[1], wanted, of_mujoco)
        for geom in spec.geoms:
            geom.name = geom.name or f"geom {geom.id}"
        called = {geom.id: geom.name for geom in spec.geoms}
        for k in np.flatnonzero(wanted != of_mujoco):
            one, other = (int(geom) for geom in both[:, k])
            pair = spec.add_pair(geomname1=called[one], geomname2=called[other])
            _set_mixed(pair, model, one, other)
            pair.friction[:2] = float(wanted[k])


def body_names(model: mujoco.MjModel, geoms: Sequence[int] | IntArray, wires: Sequence[str]) -> list[str]:
    """Return the name of the body of each geom (k,); for segments of a wire the name of the wire."""
    names = []
    for geom in geoms:
        name = model.body(int(model.geom_bodyid[geom])).name
        whole = name.rpartition("/")[0]
        names.append(whole if whole in wires else name)
    return names


def _meeting(model: mujoco.MjModel) -> IntArray:
    """Return the pairs of geoms (2, k) between which MuJoCo finds contacts."""
    both = np.stack(np.triu_indices(model.ngeom, 1))
    kind, affinity = model.geom_contype[both], model.geom_conaffinity[both]
    meets = ((kind & affinity[::-1]) != 0).any(axis=0)
    body = np.sort(model.geom_bodyid[both], axis=0)
    weld = model.body_weldid[body]
    above = model.body_weldid[model.body_parentid[weld]]
    related = (weld == above[::-1]).any(axis=0) & (weld != 0).all(axis=0)
    excluded = np.isin((body[0] << 16) + body[1], model.exclude_signature)
    return np.asarray(both[:, meets & (weld[0] != weld[1]) & ~related & ~excluded], dtype=np.int64)


def _mujoco_friction(model: mujoco.MjModel, both: IntArray) -> Array:
    """Return the coefficients of sliding (k,) that MuJoCo uses for pairs of geoms (2, k)."""
    priority, mu = model.geom_priority[both], model.geom_friction[both, 0]
    return np.asarray(
        np.where(priority[0] == priority[1], mu.max(axis=0), np.where(priority[0] > priority[1], *mu))
    )


def _set_mixed(pair: mujoco.MjsPair, model: mujoco.MjModel, one: int, other: int) -> None:
    """Set a pair's parameters as MuJoCo mixes those of two geoms: by priority, or weighted by solmix."""
    geoms, priority = [one, other], model.geom_priority[[one, other]]
    pair.margin, pair.gap = model.geom_margin[geoms].sum(), model.geom_gap[geoms].sum()
    if priority[0] != priority[1]:
        geoms = [geoms[int(np.argmax(priority))]]
    weight = model.geom_solmix[geoms]
    weight = weight / weight.sum() if weight.sum() > _NO_WEIGHT else np.full(len(geoms), 1.0 / len(geoms))
    pair.condim = model.geom_condim[geoms].max()
    sliding, turning, rolling = model.geom_friction[geoms].max(axis=0)
    pair.friction = [sliding, sliding, turning, rolling, rolling]
    times = model.geom_solref[geoms]
    pair.solref = weight @ times if (times[:, 0] > 0.0).all() else times.min(axis=0)
    pair.solimp = weight @ model.geom_solimp[geoms]
