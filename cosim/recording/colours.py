"""The palette of a recording. The colours can be distinguished with any kind of colour vision: the palette of
Okabe and Ito, a little lighter for the dark background.
"""

from typing import Final, TypeAlias

Colour: TypeAlias = tuple[int, int, int]

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


def series_colours(count: int) -> list[Colour]:
    """Return `count` colours for the lines of one plot, repeating after eight."""
    return [SERIES[k % len(SERIES)] for k in range(count)]
