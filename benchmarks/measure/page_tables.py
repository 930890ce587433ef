"""Tables of a page that a benchmark makes: between two comments, which name the command that makes them."""

from __future__ import annotations

from pathlib import Path


def put_table(page: Path, name: str, text: str) -> None:
    """Replace what stands between `<!-- NAME: ... -->` and `<!-- end of NAME -->`.

    Args:
        page: a Markdown file.
        name: of the table.
        text: Markdown.

    Raises:
        ValueError: the page has no such place.
    """
    before, opening, rest = page.read_text(encoding="utf-8").partition(f"<!-- {name}:")
    head, _, rest = rest.partition("-->\n")
    _, closing, after = rest.partition(f"<!-- end of {name} -->")
    if not (opening and closing):
        raise ValueError(f"{page} has no comments '<!-- {name}: ... -->' and '<!-- end of {name} -->'")
    page.write_text(f"{before}{opening}{head}-->\n{text.strip()}\n{closing}{after}", encoding="utf-8")
