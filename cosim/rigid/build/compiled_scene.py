"""A scene's MuJoCo model and what is drawn of it, from which any number of scenes can be made."""

from __future__ import annotations

import copy
from functools import cached_property
from typing import final

import mujoco

from cosim.base.shown import BodyShape
from cosim.rigid.build.compile_model import compile_model
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.build.drawn_shapes import body_shapes
from cosim.rigid.scene.warnings import set_up_engine


@final
class CompiledScene:
    """The model of a scene, which stays as it was compiled.

    Args:
        description: what the scene is made of.

    Raises:
        InputError: MuJoCo refuses the arm's file or an object.
    """

    def __init__(self, description: SceneDescription) -> None:
        set_up_engine()
        self._model = compile_model(description)

    def model(self) -> mujoco.MjModel:
        """Return a model that may be changed."""
        return copy.copy(self._model)

    @cached_property
    def shapes(self) -> tuple[BodyShape, ...]:
        """What is drawn of the bodies."""
        return body_shapes(self._model)
