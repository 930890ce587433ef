"""Columns of runs, and the figures that they are reduced to, as tables."""

from __future__ import annotations

from collections.abc import Iterable

from cosim.base.column import Column, Columns, RunFigure, columns_of


def column_table(kind: type[Columns]) -> str:
    """Return Markdown with a row for each column of a class."""
    rows = [
        f"| `{name}` | {', '.join(column.axes)} | {column.unit} | {column.meaning} |"
        for name, column in columns_of(kind).items()
    ]
    return "\n".join(["| column | shape | unit | meaning |\n|---|---|---|---|", *rows])


def figure_table(reduced: Iterable[tuple[Column, RunFigure]]) -> str:
    """Return Markdown with a row for each figure of the summary that a column is reduced to."""
    rows = [f"| `{figure.name}` | `{column.name}` | {figure.meaning} |" for column, figure in reduced]
    return "\n".join(["| key | of the column | meaning |\n|---|---|---|", *rows])
