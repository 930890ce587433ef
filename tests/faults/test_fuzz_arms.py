"""Files of arms with random damage are read or refused in one line; nothing else happens."""

from __future__ import annotations

import random
import re
from pathlib import Path

import pytest

from cosim.build.file_checks import checked_arm
from cosim.errors import InputError
from tests.config.arm_texts import SIX_JOINTS_MJCF, TWO_JOINTS

MUTANTS = 120
VALUES = ("0", "-1", "1e30", "inf", "", "x", "1e-30", "100", "1 2", "0 0 0", "world", "root", "hand")
TEXT, ELEMENT, ATTRIBUTE = r'"[^"]*"', r"<[^<>]*/>", r' \w+="[^"]*"'


def mutated(text: str, chance: random.Random) -> str:
    """Return a text with another value, or with a part that is gone, moved, or there twice."""

    def place(pattern: str) -> re.Match[str]:
        return chance.choice(list(re.finditer(pattern, text)))

    match chance.randrange(5):
        case 0:
            found, new = place(TEXT), f'"{chance.choice(VALUES)}"'
        case 1:
            found, new = place(ELEMENT), ""
        case 2:
            found = place(ELEMENT)
            new = 2 * found.group()
        case 3:
            found, new = place(ATTRIBUTE), ""
        case _:
            found, new = place(TEXT), place(TEXT).group()
    return text[: found.start()] + new + text[found.end() :]


@pytest.mark.parametrize(("suffix", "text"), [("urdf", TWO_JOINTS), ("xml", SIX_JOINTS_MJCF)])
def test_damaged_arms(tmp_path: Path, suffix: str, text: str) -> None:
    chance, path = random.Random(7), tmp_path / f"arm.{suffix}"
    refused = []
    for _ in range(MUTANTS):
        damaged = text
        for _ in range(chance.randint(1, 2)):
            damaged = mutated(damaged, chance)
        path.write_text(damaged)
        try:
            checked_arm(str(path))
        except InputError as error:
            refused.append(str(error))
    assert MUTANTS // 3 < len(refused) < MUTANTS
    assert [line for line in refused if "\n" in line or "arm" not in line] == []
