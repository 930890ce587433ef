"""The words of docs/architecture.md as a glossary."""

from __future__ import annotations

import re
from pathlib import Path


def glossary_text() -> str:
    """Return the table of words as a glossary's directive, in which pages find a word by {term}."""
    page = (Path(__file__).parents[1] / "architecture.md").read_text(encoding="utf-8")
    table = page.partition("| word | meaning |\n|---|---|\n")[2].partition("\n\n")[0]
    rows = re.findall(r"^\| (.+?) \| (.+) \|$", table, re.MULTILINE)
    entries = ["\n".join([*words.split(", "), f"  {meaning}"]) for words, meaning in rows]
    return "\n".join(["```{glossary}", "\n\n".join(entries), "```"])
