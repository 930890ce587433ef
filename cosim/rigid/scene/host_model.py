"""A user's MuJoCo model to which a soft robot is attached: finds the site or body of the mount, and checks
options and time steps.
"""

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
from cosim.rigid.build import engine, mjcf_files
from cosim.rigid.scene.arm_layout import BODY, SITE, Mounting
from cosim.rigid.scene.host_scene import HostScene, check_steps, gravity_of

HostSource: TypeAlias = "mujoco.MjSpec | mujoco.MjModel | str | Path"
_MOUNT: Final = "cosim_mount"
_MOST_NAMES: Final = 40
_WHOLE: Final = 1e-6
"""Largest deviation of a tick from whole steps, over a step."""


@final
@dataclass(frozen=True)
class HostModel:
    """A user's model at the moment when a soft robot is attached.

    Args:
        spec: specification of the model; None if it is compiled already.
        at: name of the site or body of the mount.
        far: name of the site or body that the soft robot's tip is glued to, or None.
        timestep_s: MuJoCo's timestep.
        gravity: (3,) [m/s^2].
        steps: number of MuJoCo's steps in a tick.
    """

    spec: mujoco.MjSpec | None
    at: str
    far: str | None
    timestep_s: float
    gravity: tuple[float, float, float]
    steps: int

    @classmethod
    def of(cls, source: HostSource, at: str | tuple[str, str], tick_s: float | None) -> "HostModel":
        """Return the model of a source, after a check.

        Args:
            source: a specification, to which a massless body may be added; or a compiled model; or the path
                of an MJCF file.
            at: name of a site, or of a body; or two names, the second for the soft robot's tip.
            tick_s: tick of the soft robot; None for MuJoCo's timestep.

        Raises:
            InputError: MuJoCo cannot read it, it has no such site or body, or its time steps are unsuitable.
        """
        spec, model = _read(source)
        if not (isinstance(at, str) or (isinstance(at, tuple | list) and len(at) == 2)):
            raise InputError(f"at is {at!r}; give the name of a site or body, or two names for a soft joint")
        at, far = (at, None) if isinstance(at, str) else at
        mounting = find_mounting(model, at)
        _find_far(model, mounting, far)
        check_steps(model)
        if spec is not None and model.body_simple[mounting.body]:
            # MuJoCo's mass matrix of a body without children is diagonal; added inertia needs a full one
            (spec.site(at).parent if mounting.kind == SITE else spec.body(at)).add_body(name=_free_name(spec))
        timestep_s = float(model.opt.timestep)
        return cls(spec, at, far, timestep_s, gravity_of(model), _steps(tick_s, timestep_s))

    def scene(self, model: mujoco.MjModel, data: mujoco.MjData) -> HostScene:
        """Return the scene of a compiled model with its state.

        Raises:
            InputError: it is not the model that the soft robot was attached to.
        """
        for what, value in (("model", model), ("data", data)):
            wanted = mujoco.MjModel if what == "model" else mujoco.MjData
            if not isinstance(value, wanted):
                raise InputError(f"{what} is {type(value).__name__}; give a mujoco.{wanted.__name__}")
        mounting = find_mounting(model, self.at)
        check_steps(model)
        here = (float(model.opt.timestep), gravity_of(model))
        for what, one, other in zip(
            ("timestep", "gravity"), here, (self.timestep_s, self.gravity), strict=True
        ):
            if one != other:
                raise InputError(
                    f"model.opt.{what} is {one}, and was {other} when it was attached to; set it before"
                )
        return HostScene(model, data, (mounting, _find_far(model, mounting, self.far)), self.steps)


def find_mounting(model: mujoco.MjModel, name: str) -> Mounting:
    """Return the mount at a site or body.

    Args:
        model: compiled.
        name: of a site, or of a body.

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
    """Return the mount that the tip of a soft robot is glued to, or None.

    Raises:
        InputError: no site or body has that name, or it is rigidly connected to the mount.
    """
    far = None if name is None else find_mounting(model, name)
    if far is not None and model.body_weldid[far.body] == model.body_weldid[mounting.body]:
        raise InputError(f"at: {name!r} is rigidly connected to the mount; name another body")
    return far


def _read(source: HostSource) -> tuple[mujoco.MjSpec | None, mujoco.MjModel]:
    if isinstance(source, str | Path):
        read = mjcf_files.read_mjcf_file(Path(source), "scene")
        return read.spec, read.model
    engine.set_up_engine()
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
        engine.check_finite(model)
    except ValueError as error:
        text = str(error).replace("\n", ", ")
        raise InputError(f"spec: MuJoCo refuses it: {text:.500}") from None
    return source, model


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
