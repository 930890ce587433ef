"""Renders rigid bodies and the film with MuJoCo, as a camera sees them, without a screen. The renderer has a
separate model of what is drawn: each rigid body and camera is a body that is set to its pose, and
the film is a skin whose vertices are set to the film's nodes. Colour is one pass; depth and segmentation are
another, in which every body has one colour, so that edges do not mix.
"""

import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from ctypes.util import find_library
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final, final

import mujoco
import numpy as np
from numpy.typing import NDArray

from cosim.base.frames import Array, IntArray, cross
from cosim.base.solid import BodyShape
from cosim.errors import InputError, OutputError

NOTHING, FILM, FIRST_BODY = 0, 1, 2
"""Values of the segmentation: background, the film, and rigid bodies from this number on."""
_NEAR_m: Final = 0.005
_FAR_m: Final = 20.0
_FILM_RGBA: Final = (0.75, 0.80, 0.88, 1.0)
_LIBRARIES: Final = {"cgl": "CGL"} if sys.platform == "darwin" else {"egl": "EGL", "osmesa": "OSMesa"}
"""What draws without a screen: name in MUJOCO_GL and in MuJoCo's package, and the system's library."""
_REMEDY: Final = (
    "install EGL (Debian: apt install libegl1 libgl1-mesa-dri) or OSMesa (libosmesa6), and choose one by the "
    "environment variable MUJOCO_GL=egl or MUJOCO_GL=osmesa"
)


@final
@dataclass(frozen=True)
class Lens:
    """Size and field of view of a camera's picture.

    Args:
        width: in pixels.
        height: in pixels.
        fov_rad: field of view from the lower to the upper edge.
    """

    width: int
    height: int
    fov_rad: float


@final
@dataclass(frozen=True, eq=False)
class Drawn:
    """A picture of a camera.

    Args:
        rgb: (height, width, 3).
        depth_m: (height, width), along the line of sight of the picture's centre; infinite in the background.
        segments: (height, width), `NOTHING`, `FILM`, or `FIRST_BODY` and on.
    """

    rgb: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    segments: NDArray[np.int16]


@final
@dataclass(frozen=True, eq=False)
class DrawnScene:
    """Rigid bodies and film to draw.

    Args:
        shapes: of the rigid bodies, in their frames.
        bodies: number of rigid bodies.
        triangles: (m, 3), of the film.
        nodes: number of its nodes.
    """

    shapes: Sequence[BodyShape]
    bodies: int
    triangles: IntArray
    nodes: int


@final
class SceneRenderer:
    """Draws a scene; it may be used in one thread only.

    Args:
        scene: to draw.
        lenses: of the cameras.

    Raises:
        OutputError: there is neither EGL nor OSMesa, or it does not work.
    """

    def __init__(self, scene: DrawnScene, lenses: Sequence[Lens]) -> None:
        self._lenses, self._bodies = tuple(lenses), scene.bodies
        self._model = _model(scene, self._lenses)
        self._data = mujoco.MjData(self._model)
        self._vertices = self._model.skin_vert.reshape(-1, 3)
        self._context = _gl_context(max(one.width for one in lenses), max(one.height for one in lenses))
        self._context.make_current()
        self._scene = mujoco.MjvScene(self._model, maxgeom=self._model.ngeom + 16)
        self._options = mujoco.MjvOption()
        self._drawing = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._drawing)
        self._drawing.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR

    def place(self, positions: Array, quaternions: Array, nodes: Array) -> None:
        """Set the poses of rigid bodies, and the film's nodes.

        Args:
            positions: (bodies, 3) [m], world.
            quaternions: (bodies, 4), (w, x, y, z), world from body.
            nodes: (n, 3) [m], of the film, world.
        """
        self._data.mocap_pos[: self._bodies] = positions
        self._data.mocap_quat[: self._bodies] = quaternions
        self._vertices[:] = nodes

    def draw(self, camera: int, position: Array, rotation: Array) -> Drawn:
        """Return the picture of a camera.

        Args:
            camera: its index among the lenses.
            position: (3,) [m], world.
            rotation: (3, 3), world from camera: x to the right, y up, z against the line of sight.
        """
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
        self._data.mocap_pos[self._bodies + camera] = position
        self._data.mocap_quat[self._bodies + camera] = quaternion
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        self._context.make_current()
        looking = mujoco.MjvCamera()
        looking.type, looking.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, camera
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self._model, self._data, self._options, None, looking, everything, self._scene)
        lens = self._lenses[camera]
        area = mujoco.MjrRect(0, 0, lens.width, lens.height)
        rgb, codes = np.empty((2, lens.height, lens.width, 3), np.uint8)
        depth = np.empty((lens.height, lens.width), np.float32)
        self._pass(area, rgb, None)
        flags = (mujoco.mjtRndFlag.mjRND_SEGMENT, mujoco.mjtRndFlag.mjRND_IDCOLOR)
        for flag in flags:
            self._scene.flags[flag] = 1
        self._pass(area, codes, depth)
        for flag in flags:
            self._scene.flags[flag] = 0
        return Drawn(rgb[::-1].copy(), _metres(depth[::-1]), self._segments(codes[::-1]))

    def close(self) -> None:
        """Free the graphics context and its buffers."""
        if self._context is not None:
            self._context.make_current()
            self._drawing.free()
            self._context.free()
            self._context = None

    def __del__(self) -> None:
        with suppress(Exception):  # if the constructor failed, or while the interpreter exits
            self.close()

    def _pass(self, area: Any, colours: NDArray[np.uint8], depth: NDArray[np.float32] | None) -> None:
        mujoco.mjr_render(area, self._scene, self._drawing)
        mujoco.mjr_readPixels(colours, depth, area, self._drawing)

    def _segments(self, codes: NDArray[np.uint8]) -> NDArray[np.int16]:
        """Return segments (h, w) from colours (h, w, 3) of a pass in which every geom has one colour."""
        found = np.zeros(self._scene.ngeom + 1, np.int16)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.segid >= 0:
                skin = geom.objtype == mujoco.mjtObj.mjOBJ_SKIN
                found[geom.segid + 1] = FILM if skin else FIRST_BODY + self._model.geom_bodyid[geom.objid] - 1
        code = codes[..., 0] + 256 * codes[..., 1].astype(np.int32) + 65536 * codes[..., 2].astype(np.int32)
        return np.asarray(found[code])


def _metres(buffer: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return depths [m] of a buffer d: 1 at the near plane n, 0 at the far plane f.

    With a perspective projection 1 / z is linear in d: 1 / z = d / n + (1 - d) / f.
    """
    inverse = buffer / np.float64(_NEAR_m) + (1.0 - buffer) / np.float64(_FAR_m)
    return np.where(buffer > 0.0, 1.0 / inverse, np.inf).astype(np.float32)


def _model(scene: DrawnScene, lenses: Sequence[Lens]) -> Any:
    spec = mujoco.MjSpec()
    spec.visual.map.znear, spec.visual.map.zfar = _NEAR_m, _FAR_m
    spec.stat.extent, spec.stat.center = 1.0, (0.0, 0.0, 0.0)
    spec.visual.quality.offsamples = 0
    spec.visual.global_.offwidth = max(one.width for one in lenses)
    spec.visual.global_.offheight = max(one.height for one in lenses)
    spec.worldbody.add_light(  # shadows cost as much as the picture
        pos=(1.0, -1.0, 3.0), dir=(-0.3, 0.3, -1.0), castshadow=False,
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    )  # fmt: skip
    bodies = [spec.worldbody.add_body(name=f"body_{k}", mocap=True) for k in range(scene.bodies)]
    for k, shape in enumerate(scene.shapes):
        name = f"shape_{k}"
        spec.add_mesh(
            name=name, uservert=shape.vertices.ravel(), userface=shape.triangles.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )  # fmt: skip
        bodies[shape.body].add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, rgba=shape.rgba, contype=0, conaffinity=0
        )
    for k, lens in enumerate(lenses):
        held = spec.worldbody.add_body(name=f"camera_{k}", mocap=True)
        held.add_camera(name=f"camera_{k}", fovy=float(np.degrees(lens.fov_rad)))
    bone = spec.worldbody.add_body(name="film")
    spec.add_skin(
        name="film", rgba=_FILM_RGBA, vert=np.zeros(3 * scene.nodes), face=scene.triangles.ravel(),
        bodyname=[bone.name], bindpos=[0.0, 0.0, 0.0], bindquat=[1.0, 0.0, 0.0, 0.0],
        vertid=[list(range(scene.nodes))], vertweight=[[1.0] * scene.nodes],
    )  # fmt: skip
    return spec.compile()


def _gl_context(width: int, height: int) -> Any:
    """Return an offscreen context of the library that MUJOCO_GL names, or of the first that is installed."""
    asked = os.environ.get("MUJOCO_GL", "").lower()
    there = [name for name in _LIBRARIES if name == "cgl" or find_library(_LIBRARIES[name])]
    names = [asked] if asked in _LIBRARIES else there  # CGL is a part of macOS
    if not names:
        raise OutputError(f"cameras draw without a screen by EGL or OSMesa, and neither is there: {_REMEDY}")
    try:
        return import_module(f"mujoco.{names[0]}").GLContext(width, height)
    except Exception as error:  # drivers raise any exception
        text = (str(error).splitlines() or [""])[0]
        raise OutputError(
            f"cameras cannot draw by {names[0]}: {type(error).__name__}: {text}; {_REMEDY}"
        ) from error


def add_film(scene: mujoco.MjvScene, positions: Array, triangles: IntArray) -> None:
    """Add a film to a scene that MuJoCo draws: a geom for each triangle, with its edges and normal as axes.

    Args:
        scene: with room for the geoms.
        positions: (n, 3) [m], world.
        triangles: (m, 3), nodes of each.

    Raises:
        InputError: the scene has no room for them.
    """
    first, room = scene.ngeom, len(scene.geoms) - scene.ngeom
    if len(triangles) > room:
        raise InputError(f"the film has {len(triangles)} triangles, the scene room for {room}; raise maxgeom")
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    axes = np.stack([b - a, c - a, cross(b - a, c - a)], axis=2).reshape(-1, 9)
    size, colour = np.ones(3), np.array(_FILM_RGBA, np.float32)
    for k, (place, frame) in enumerate(zip(a, axes, strict=True)):
        mujoco.mjv_initGeom(
            scene.geoms[first + k], mujoco.mjtGeom.mjGEOM_TRIANGLE, size, place, frame, colour
        )
    scene.ngeom = first + len(triangles)
