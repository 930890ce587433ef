"""The colour scale of the film's stress, as an image with numbers."""

from typing import Final

import numpy as np
import rerun as rr

from cosim.recording.colours import WHITE
from cosim.recording.entity_paths import STRESS_SCALE
from cosim.recording.film_colours import STRESS_RANGE_PA, stress_scale

_WIDTH: Final = 512
_HEIGHT: Final = 20
_TICKS: Final = 6
LEGEND_X: Final = (-20.0, _WIDTH + 20.0)
LEGEND_Y: Final = (-4.0, _HEIGHT + 26.0)


def log_stress_legend(stream: rr.RecordingStream) -> None:
    """Log the scale with evenly spaced numbers."""
    row = stress_scale(_WIDTH)[:, :3]
    stream.log(f"{STRESS_SCALE}/colours", rr.Image(np.tile(row, (_HEIGHT, 1, 1))), static=True)
    fraction = np.linspace(0.0, 1.0, _TICKS)
    low, high = STRESS_RANGE_PA
    x, y = fraction * _WIDTH, np.full(_TICKS, _HEIGHT + 4.0)
    labels = [f"{1e-6 * (low + s * (high - low)):.3g}" for s in fraction]
    ticks = rr.Points2D(
        np.stack([x, y], axis=1), radii=[1.0], colors=[WHITE], labels=labels, show_labels=True
    )
    stream.log(f"{STRESS_SCALE}/numbers", ticks, static=True)
