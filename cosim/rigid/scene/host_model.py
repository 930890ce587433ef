"""Where a soft robot is to hang in somebody's MuJoCo model, and whether that will do."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias, final

import mujoco
import numpy as np

from cosim.base.frames import IntArray
from cosim.errors import InputError
from cosim.rigid.build.mjcf_files import check_finite, read_mjcf_file, set_up_engine
from cosim.rigid.scene.arm import BODY, SITE, Mounting
from cosim.rigid.scene.host_scene import HostScene

HostSource: TypeAlias = "mujoco.MjSpec | mujoco.MjModel | str | Path"
Model: TypeAlias = mujoco.MjModel
Data: TypeAlias = mujoco.MjData
_MOUNT: Final = "cosim_mount"
_MOST_NAMES: Final = 40
_RK4: Final = mujoco.mjtIntegrator.mjINT_RK4
_WHOLE: Final = 1e-6
"""Share of a step by which a tick may differ from whole steps."""


@final
@dataclass(frozen=True)
class HostModel:
    """Somebody's model, as it is when a soft robot is attached.

    Args:
        spec: from which it is compiled; None: it has been.
        at: name of the site or body.
        far: name of the one that the soft robot's tip is glued to; None for none.
        timestep_s: of MuJoCo.
        gravity: (3,) [m/s^2].
        steps: of MuJoCo in a tick.
    """

    spec: mujoco.MjSpec | None
    at: str
    far: str | None
    timestep_s: float
    gravity: tuple[float, float, float]
    steps: int

    @classmethod
    def of(cls, source: HostSource, at: str | tuple[str, str], tick_s: float | None) -> HostModel:
        """Return a model that has the site or body.

        Args:
            source: specification, which may get a massless body; or a compiled model; or path of an MJCF.
            at: name of a site, or else of a body; or two, the second for the soft robot's tip.
            tick_s: of the soft robot; None: MuJoCo's timestep.

        Raises:
            InputError: MuJoCo refuses it, it has no such site or body, or its steps will not do.
        """
        spec, model = _read(source)
        if not (isinstance(at, str) or (isinstance(at, tuple | list) and len(at) == 2)):
            raise InputError(f"at is {at!r}; give the name of a site or body, or two names for a soft joint")
        at, far = (at, None) if isinstance(at, str) else at
        mounting = find_mounting(model, at)
        _find_far(model, mounting, far)
        _check_steps(model)
        if spec is not None and model.body_simple[mounting.body]:
            # MuJoCo keeps no whole mass matrix of a body without children; what it carries needs one
            (spec.site(at).parent if mounting.kind == SITE else spec.body(at)).add_body(name=_free_name(spec))
        timestep_s = float(model.opt.timestep)
        return cls(spec, at, far, timestep_s, _gravity(model), _steps(tick_s, timestep_s))

    def scene(self, model: mujoco.MjModel, data: mujoco.MjData) -> HostScene:
        """Return the scene of a compiled model with its state.

        Raises:
            InputError: it is not the model that was attached to.
        """
        for what, value in (("model", model), ("data", data)):
            wanted = mujoco.MjModel if what == "model" else mujoco.MjData
            if not isinstance(value, wanted):
                raise InputError(f"{what} is {type(value).__name__}; give a mujoco.{wanted.__name__}")
        mounting = find_mounting(model, self.at)
        _check_steps(model)
        here = (float(model.opt.timestep), _gravity(model))
        for what, one, other in zip(
            ("timestep", "gravity"), here, (self.timestep_s, self.gravity), strict=True
        ):
            if one != other:
                raise InputError(
                    f"model.opt.{what} is {one}, and was {other} when it was attached to; set it before"
                )
        return HostScene(model, data, (mounting, _find_far(model, mounting, self.far)), self.steps)


def find_mounting(model: mujoco.MjModel, name: str) -> Mounting:
    """Return where a site or body of a model is.

    Args:
        model: compiled.
        name: of a site, or else of a body.

    Raises:
        InputError: no site or body has that name.
    """
    for kind, what in ((SITE, mujoco.mjtObj.mjOBJ_SITE), (BODY, mujoco.mjtObj.mjOBJ_BODY)):
        index = mujoco.mj_name2id(model, what, name) if isinstance(name, str) else -1
        if index >= 0:
            body = int(model.site_bodyid[index]) if kind == SITE else index
            return Mounting(kind, index, body, _moving(model, body))
    sites = _listed(model.site(k).name for k in range(model.nsite))
    bodies = _listed(model.body(k).name for k in range(1, model.nbody))
    raise InputError(f"at is {name!r}, which is no site or body; sites: {sites}; bodies: {bodies}")


def _find_far(model: mujoco.MjModel, mounting: Mounting, name: str | None) -> Mounting | None:
    """Return where the tip of a mounted soft robot is glued to.

    Raises:
        InputError: no site or body has that name, or it goes with the mount.
    """
    far = None if name is None else find_mounting(model, name)
    if far is not None and model.body_weldid[far.body] == model.body_weldid[mounting.body]:
        raise InputError(f"at: {name!r} goes rigidly with what carries the soft robot; name another body")
    return far


def _read(source: HostSource) -> tuple[mujoco.MjSpec | None, mujoco.MjModel]:
    if isinstance(source, str | Path):
        read = read_mjcf_file(Path(source), "scene")
        return read.spec, read.model
    set_up_engine()
    if isinstance(source, mujoco.MjModel):
        return None, source
    if not isinstance(source, mujoco.MjSpec):
        raise InputError(
            f"spec is {type(source).__name__}; give a mujoco.MjSpec, a mujoco.MjModel, or the path of an MJCF"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # whoever compiles it sees them
            model = source.copy().compile()
        check_finite(model)
    except ValueError as error:
        text = str(error).replace("\n", ", ")
        raise InputError(f"spec: MuJoCo refuses it: {text:.500}") from None
    return source, model


def _check_steps(model: mujoco.MjModel) -> None:
    if model.opt.integrator == _RK4:
        raise InputError(
            "option integrator is RK4, whose steps evaluate forces four times; the soft robot's act once a "
            "step: use Euler, implicit or implicitfast"
        )


def _gravity(model: mujoco.MjModel) -> tuple[float, float, float]:
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY:
        return 0.0, 0.0, 0.0
    x, y, z = np.asarray(model.opt.gravity, dtype=np.float64).tolist()
    return x, y, z


def _steps(tick_s: float | None, timestep_s: float) -> int:
    if tick_s is None:
        return 1
    steps = tick_s / timestep_s if isinstance(tick_s, float | int) else math.nan
    if not (math.isfinite(steps) and steps > 0.5 and abs(steps - round(steps)) <= _WHOLE):
        raise InputError(f"tick_s is {tick_s!r}; must be one or several timesteps of {timestep_s:g} s")
    return round(steps)


def _free_name(spec: mujoco.MjSpec) -> str:
    number = 1
    while spec.body(f"{_MOUNT}_{number}") is not None:
        number += 1
    return f"{_MOUNT}_{number}"


def _listed(names: Iterable[str]) -> str:
    known = [name for name in names if name]
    more = ", ..." if len(known) > _MOST_NAMES else ""
    return ", ".join(known[:_MOST_NAMES]) + more if known else "none with a name"


def _moving(model: mujoco.MjModel, body: int) -> IntArray:
    """Return the degrees of freedom that move a body, from the root on."""
    found: list[int] = []
    while body:
        first, count = int(model.body_dofadr[body]), int(model.body_dofnum[body])
        found = [*range(first, first + count), *found]
        body = int(model.body_parentid[body])
    return np.array(found, np.int64)
