"""Colours: one palette for things, one perceptual scale for stress."""

from __future__ import annotations

from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cosim.base.frames import Array

Colour: TypeAlias = tuple[int, int, int]
Rgba: TypeAlias = NDArray[np.uint8]

# Told apart by people with any kind of colour vision (the palette of Okabe and Ito, made a little
# lighter for a dark ground).
SKY: Final[Colour] = (96, 188, 240)
ORANGE: Final[Colour] = (238, 164, 32)
VERMILION: Final[Colour] = (232, 106, 40)
GREEN: Final[Colour] = (26, 184, 136)
PINK: Final[Colour] = (222, 132, 180)
YELLOW: Final[Colour] = (240, 228, 66)
BLUE: Final[Colour] = (70, 140, 214)
GREY: Final[Colour] = (150, 156, 166)
WHITE: Final[Colour] = (236, 239, 244)
SERIES: Final[tuple[Colour, ...]] = (ORANGE, SKY, GREEN, PINK, VERMILION, BLUE, YELLOW, GREY)

BACKGROUND: Final[Colour] = (24, 27, 33)
FLOOR_SHADE: Final = (0.18, 0.20, 0.24)

# Ends of the stress scale in OkLCh: lightness, chroma, hue [degree]; indigo over teal to yellow.
_SCALE_FROM: Final = (0.36, 0.13, 285.0)
_SCALE_TO: Final = (0.94, 0.17, 103.0)


def series_colours(count: int) -> list[Colour]:
    """Return `count` colours for the lines of one plot, repeating after eight."""
    return [SERIES[k % len(SERIES)] for k in range(count)]


def stress_scale(steps: int = 256) -> Rgba:
    """Return a colour scale whose lightness rises evenly, so that equal steps look equal.

    A straight line in OkLCh; colours outside sRGB are clipped. Source: B. Ottosson, "A perceptual
    color space for image processing" (2020).

    Args:
        steps: number of colours.

    Returns:
        (steps, 4), opaque, low stress first.
    """
    fraction = np.linspace(0.0, 1.0, steps)[:, None]
    lightness, chroma, hue = (np.array(_SCALE_FROM) * (1.0 - fraction) + np.array(_SCALE_TO) * fraction).T
    linear = _linear_srgb(lightness, chroma, np.radians(hue))
    encoded = np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0) ** (1 / 2.4) - 0.055
    )
    rgba = np.full((steps, 4), 255, dtype=np.uint8)
    rgba[:, :3] = np.round(255.0 * np.clip(encoded, 0.0, 1.0))
    return rgba


def _linear_srgb(lightness: Array, chroma: Array, hue: Array) -> Array:
    """Convert OkLCh to linear sRGB (n, 3), not clipped."""
    a, b = chroma * np.cos(hue), chroma * np.sin(hue)
    cone_roots = np.stack(
        [
            lightness + 0.3963377774 * a + 0.2158037573 * b,
            lightness - 0.1055613458 * a - 0.0638541728 * b,
            lightness - 0.0894841775 * a - 1.2914855480 * b,
        ],
        axis=1,
    )
    to_srgb = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.7076147010],
        ]
    )
    return np.asarray(cone_roots**3 @ to_srgb.T)
