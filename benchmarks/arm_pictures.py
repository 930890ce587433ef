"""A sheet of pictures: every arm that comes with cosim, at its home.

    python benchmarks/arm_pictures.py [docs/arms.png]

No display is needed: on Linux MuJoCo draws by EGL, or as MUJOCO_GL says. What is drawn is the scene of a run,
without a soft robot. Every arm fills its picture; the length below is that of its chain, from the
first joint to the flange.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any

if sys.platform == "linux":
    os.environ.setdefault("MUJOCO_GL", "egl")  # MuJoCo reads it once, when it is imported

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from cosim.base.arm_file import ArmFile
from cosim.base.frames import Array
from cosim.base.resources import list_arms
from cosim.build.arms import find_arm
from cosim.kinematics.arm import Arm
from cosim.rigid.build.compiled_scene import compile_model
from cosim.rigid.build.description import VISUAL_GROUP, SceneDescription
from cosim.rigid.build.drawn_shapes import body_shapes

SIZE = (300, 330)
"""Of a picture with its caption [pixels]."""
CAPTION = 48
"""Height of the captions below the pictures [pixels]."""
FINER = 3
"""Pixels drawn for each that is kept, along one side."""
COLUMNS = 5
BACKGROUND = (226, 231, 238)
INK = (30, 36, 46)
AZIMUTH_DEG, ELEVATION_DEG = 135.0, -18.0
MARGIN = 1.12


def main() -> None:
    """Draw all arms and write the sheet."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("path", type=Path, nargs="?", default=Path("runs/arms.png"))
    path = parser.parse_args().path
    pictures = [captioned(find_arm(name)) for name in list_arms()]
    rows = -(-len(pictures) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * SIZE[0], rows * SIZE[1]), BACKGROUND)
    for place, picture in enumerate(pictures):
        row, column = divmod(place, COLUMNS)
        sheet.paste(picture, (column * SIZE[0], row * SIZE[1]))
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path}: {len(pictures)} arms, {path.stat().st_size / 1e3:.0f} kB")


def captioned(arm: ArmFile) -> Image.Image:
    """Return an arm's picture with its name, joints and length."""
    picture = drawn(arm)
    pen = ImageDraw.Draw(picture)
    middle, bottom = SIZE[0] / 2, SIZE[1]
    pen.text((middle, bottom - 34), arm.name, INK, ImageFont.load_default(18), anchor="mm")
    below = f"{len(arm.joint_names)} joints, {Arm(arm).reach:.2f} m"
    pen.text((middle, bottom - 14), below, INK, ImageFont.load_default(13), anchor="mm")
    return picture


def drawn(arm: ArmFile) -> Image.Image:
    """Return a picture of an arm at its home, on an even background."""
    model = compile_model(SceneDescription(arm, floor_height_m=None))
    width, height = FINER * SIZE[0], FINER * (SIZE[1] - CAPTION)
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    model.vis.quality.offsamples = 0  # else edges are mixed with MuJoCo's black, not with the background
    model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.35, 0.55
    data = mujoco.MjData(model)
    for name, position in zip(arm.joint_names, arm.home, strict=True):
        data.joint(name).qpos = position
    mujoco.mj_forward(model, data)
    shown = mujoco.MjvOption()
    shown.geomgroup[:] = np.arange(len(shown.geomgroup)) == VISUAL_GROUP
    with mujoco.Renderer(model, height, width) as renderer:
        camera = camera_on(drawn_points(model, data), width / height, model.vis.global_.fovy)
        renderer.update_scene(data, camera, shown)
        colours = renderer.render()
        renderer.enable_segmentation_rendering()
        nothing = renderer.render()[..., 0] < 0
    colours[nothing] = BACKGROUND
    picture = Image.new("RGB", SIZE, BACKGROUND)
    picture.paste(Image.fromarray(colours).resize((SIZE[0], SIZE[1] - CAPTION), Image.Resampling.BOX))
    return picture


def drawn_points(model: Any, data: Any) -> Array:
    """Return the vertices (n, 3) [m], world, of all drawn shapes."""
    shapes = body_shapes(model)
    return np.concatenate(
        [data.xpos[each.body] + each.vertices @ data.xmat[each.body].reshape(3, 3).T for each in shapes]
    )


def camera_on(points: Array, aspect: float, view_angle_deg: float) -> Any:
    """Return a camera that sees points, as large as they fit.

    Args:
        points: (n, 3) [m], world.
        aspect: width by height of the picture.
        view_angle_deg: from bottom to top of the picture.
    """
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation = AZIMUTH_DEG, ELEVATION_DEG
    turn, rise = np.radians([AZIMUTH_DEG, ELEVATION_DEG])
    ahead = np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
    right = np.array([np.sin(turn), -np.cos(turn), 0.0])
    axes = np.column_stack([right, np.cross(right, ahead), ahead])
    seen = points @ axes
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    camera.lookat[:] = axes @ middle
    half = np.tan(np.radians(view_angle_deg) / 2)
    across = np.abs(seen - middle)
    camera.distance = MARGIN * np.max(
        np.maximum(across[:, 0] / aspect, across[:, 1]) / half + middle[2] - seen[:, 2]
    )
    return camera


if __name__ == "__main__":
    main()
