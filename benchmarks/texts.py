"""How the texts read that users meet: lengths of sentences, and phrases that are hard to read.

    python benchmarks/texts.py [--show ROW ...] [--pages SEED]

Sentences are those of docs and README, without code, tables and headings. Phrases are counted in docs,
README, messages, help and public docstrings. `--show` prints where the phrases of some rows are. `--pages`
prints the sentences of five pages of docs that a seed draws, to be judged one by one. Exit code 1 beyond the
bounds: median 16 words, 95 % 30 words, 10 phrases.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import random
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import Final

import cosim
from cosim.config.schema import film, objects, pattern, phase, scenario, soft_robot

ROOT: Final = Path(__file__).resolve().parents[1]
SCHEMA: Final = (film, objects, pattern, phase, scenario, soft_robot)
MEDIAN_MAX, MOST_MAX, PHRASES_MAX = 16, 30, 10
PHRASES: Final = {
    1: r"\banew\b",
    2: r"\b(is|are) told\b|\btells\b",
    3: r"\bof (its|one's|your|their) own\b",
    4: r"\bwhat (it|is|are|he|they|the|a|an) \w+",
    5: r"\bstands? (for|in|twice|there|beside)\b",
    6: r"\bgo(es)? on\b|\bgone on\b|\bwent on\b",
    7: r"\bserves?\b",
    8: r"\bthere is none\b|\bnone is there\b",
    11: r"bit for bit|with the same bits",
    12: r"waits? for no engine",
}
"""Rows of the list of habits that are counted."""
_SAYS: Final = {"print", "warning", "info", "tell", "_tell", "add_argument", "add_parser", "Fault"}


def pages() -> list[Path]:
    """Return the pages of docs, in the order of their names."""
    return sorted((ROOT / "docs").glob("*.md"))


def text_of(page: Path) -> str:
    """Return the text of a page, an included one in place of what includes it."""
    text = page.read_text(encoding="utf-8")
    included = re.search(r"```\{include\} (\S+)", text)
    return text_of((page.parent / included[1]).resolve()) if included else text


def sentences(text: str) -> Iterator[tuple[int, str]]:
    """Yield the number of words and the words of each sentence, without code, tables and headings."""
    for pattern_, instead in (
        (r"(?s)```.*?```", ""), (r"(?m)^[|#].*$", ""), (r"`[^`]*`", "CODE"),
        (r"\[([^\]]*)\]\([^)]*\)", r"\1"), (r"\$[^$]*\$", "F"),
    ):  # fmt: skip
        text = re.sub(pattern_, instead, text)
    for paragraph in re.split(r"\n\s*\n|\n(?=[-*] )", text):
        for sentence in re.split(r"(?<=[.!?:])\s+(?=[A-Z`(\[])", " ".join(paragraph.split())):
            if (words := len(re.findall(r"[A-Za-z0-9'.-]+", sentence))) > 2:
                yield words, sentence


def told() -> Iterator[tuple[str, str]]:
    """Yield place and text of all that users read: docs, README, public docstrings, messages, help."""
    for page in [*pages(), ROOT / "README.md"]:
        yield page.name, page.read_text(encoding="utf-8")
    for name in cosim.__all__:
        yield from _docstrings(name, getattr(cosim, name))
    for module in SCHEMA:
        for name, what in vars(module).items():
            if inspect.isclass(what) and what.__module__ == module.__name__:
                yield name, what.__doc__ or ""
    for file in (ROOT / "cosim").rglob("*.py"):
        yield from ((str(file.relative_to(ROOT)), text) for text in _messages(file))


def _docstrings(name: str, what: object) -> Iterator[tuple[str, str]]:
    if callable(what):
        yield name, inspect.getdoc(what) or ""
    if inspect.isclass(what):
        for key, value in vars(what).items():
            method = getattr(value, "__func__", None) or getattr(value, "fget", None) or value
            if not key.startswith("_") and inspect.isfunction(method):
                yield f"{name}.{key}", method.__doc__ or ""


def _messages(file: Path) -> set[str]:
    """Return the texts of a module's errors, messages and help."""
    found = set[str]()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        name = ""
        if isinstance(node, ast.Call):
            name = str(getattr(node.func, "id", getattr(node.func, "attr", "")))
        if name in _SAYS or isinstance(node, ast.Raise | ast.Yield):
            texts = (each.value for each in ast.walk(node) if isinstance(each, ast.Constant))
            found |= {text for text in texts if isinstance(text, str) and " " in text}
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the counts, and return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--show", type=int, nargs="+", default=(), metavar="ROW")
    parser.add_argument("--pages", type=int, metavar="SEED", help="print the sentences of five drawn pages")
    options = parser.parse_args(arguments)
    if options.pages is not None:
        for page in random.Random(options.pages).sample(pages(), 5):
            print(f"\n{page.name}")
            print(*(f"{words:3} {sentence}" for words, sentence in sentences(text_of(page))), sep="\n")
    counts = Counter[int]()
    for place, text in told():
        for row, phrase in PHRASES.items():
            for found in re.finditer(phrase, text):
                counts[row] += 1
                if row in options.show:
                    around = text[max(0, found.start() - 60) : found.end() + 60]
                    print(f"{row} {place}: {' '.join(around.split())}")
    texts = [page.read_text(encoding="utf-8") for page in [*pages(), ROOT / "README.md"]]
    lengths = sorted(words for text in texts for words, _ in sentences(text))
    middle, most = median(lengths), lengths[int(0.95 * (len(lengths) - 1))]
    print(f"{len(lengths)} sentences: median {middle:g} words, 95 % have at most {most}")
    print(f"{counts.total()} phrases: {', '.join(f'row {row}: {counts[row]}' for row in PHRASES)}")
    return int(middle > MEDIAN_MAX or most > MOST_MAX or counts.total() > PHRASES_MAX)


if __name__ == "__main__":
    raise SystemExit(main())
