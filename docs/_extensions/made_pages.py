"""Puts what the code knows into pages: a line `% made: NAME` becomes that text when a page is read.

Links to pages outside this folder, which GitHub follows, are made to lead to the file.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from column_tables import column_table, figure_table
from key_tables import key_tables
from public_names import public_errors, public_names

from cosim import RunResult
from cosim.base.column import ends_of, figures_of
from cosim.base.columns import TickColumns

if TYPE_CHECKING:
    from sphinx.application import Sphinx

TEXTS: Final[dict[str, Callable[[], str]]] = {
    "keys of scenario": lambda: key_tables("scenario"),
    "keys of robot": lambda: key_tables("robot"),
    "keys of arm": lambda: key_tables("arm"),
    "columns of results": lambda: column_table(RunResult),
    "columns of ticks": lambda: column_table(TickColumns),
    "figures of columns": lambda: figure_table(figures_of(TickColumns)),
    "figures of phases": lambda: figure_table(ends_of(TickColumns)),
    "public names": public_names,
    "public errors": public_errors,
}
_OWN_PAGES: Final = {"../CONTRIBUTING.md": "contributing.md", "../CHANGELOG.md": "changelog.md"}
_OUTSIDE: Final = re.compile(r"(?<=\]\()\.\./[^)#]+\.md(?=[)#])")
_MARK: Final = re.compile(r"^% made: (.+)$", re.MULTILINE)


def setup(app: Sphinx) -> dict[str, Any]:
    """Tell Sphinx what to do with every page it reads."""
    app.connect("source-read", _put_texts)
    return {"parallel_read_safe": True}


def _put_texts(app: Sphinx, page: str, source: list[str]) -> None:
    text = _MARK.sub(lambda mark: TEXTS[mark[1]](), source[0])
    source[0] = _OUTSIDE.sub(lambda link: _OWN_PAGES.get(link[0], f"path:{link[0]}"), text)
