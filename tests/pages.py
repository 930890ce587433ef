"""Pages of the documentation as they are shown: with the files that they include."""

from __future__ import annotations

import re
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"
LANGUAGES = {".py": "python", ".toml": "toml", ".urdf": "xml", ".xml": "xml"}


def page(name: str) -> str:
    """Return the text of a page, with every included file as a block of its language."""

    def shown(mark: re.Match[str]) -> str:
        file = DOCS / mark[1]
        return f"```{mark[2] or LANGUAGES[file.suffix]}\n{file.read_text('utf-8')}```"

    text = (DOCS / f"{name}.md").read_text("utf-8")
    return re.sub(
        r"^```\{literalinclude\} (\S+)\n(?::language: (\w+)\n)?```$", shown, text, flags=re.MULTILINE
    )
