"""What the reference pages are made from says all they promise."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import pytest

import cosim
from cosim.config.json_schema import json_schema

NAMES = [name for name in cosim.__all__ if not name.startswith("_")]


def public_parts(name: str) -> Iterator[tuple[str, Any]]:
    """Yield a public name and, of a class, what it defines itself for everybody."""
    what = getattr(cosim, name)
    yield name, what
    if inspect.isclass(what):
        for key, part in vars(what).items():
            if not key.startswith("_") and (inspect.isfunction(part) or isinstance(part, property)):
                yield f"{name}.{key}", part


def told_arguments(text: str) -> dict[str, str]:
    """Return what a docstring says of each argument."""
    block = text.partition("Args:\n")[2].partition("\n\n")[0]
    entries = re.findall(r"^    (\w[\w, ]*): (.*(?:\n        .*)*)", block, re.MULTILINE)
    return {name: meaning for names, meaning in entries for name in names.split(", ")}


UNIT = r"_(s|m|m3|N|Pa|W|Hz|rad|kg)$"
UNITLESS = ("fraction",)
PARTS = dict(part for name in NAMES for part in public_parts(name))


@pytest.mark.parametrize("name", PARTS)
def test_every_public_name_says_what_it_is_and_takes(name: str) -> None:
    text = inspect.getdoc(PARTS[name])
    assert text, "has no docstring"
    first = text.splitlines()[0]
    assert first.endswith((".", ":")) or "." in text.partition("\n\n")[0], "the first sentence has no end"
    if inspect.isfunction(PARTS[name]):
        parameters = set(inspect.signature(PARTS[name]).parameters) - {"self", "cls"}
        assert parameters <= set(told_arguments(text)), "an argument is not told"
        assert "Raises:" in text or not parameters or "." in name, "what it raises is not told"


@pytest.mark.parametrize("name", [name for name in PARTS if inspect.isfunction(PARTS[name])])
def test_arguments_have_shapes_and_units(name: str) -> None:
    told = told_arguments(inspect.getdoc(PARTS[name]) or "")
    for parameter in inspect.signature(PARTS[name]).parameters.values():
        meaning, annotation = told.get(parameter.name, ""), str(parameter.annotation)
        if "Array" in annotation:
            assert re.match(r"\(", meaning), f"{parameter.name} has no shape"
        if "float" in annotation or "Array" in annotation:
            has_unit = "[" in meaning or re.search(UNIT, parameter.name)
            assert has_unit or parameter.name in UNITLESS, f"{parameter.name} has no unit"


@pytest.mark.parametrize("name", [name for name in NAMES if is_dataclass(getattr(cosim, name))])
def test_every_field_is_told_and_every_array_has_shape_and_unit(name: str) -> None:
    kind = getattr(cosim, name)
    told = told_arguments(inspect.getdoc(kind) or "")
    unitless = (
        "direction",
        "quaternion",
        "phase",
        "tick",
        "iterations",
        "ratio",
        "contacts",
        "rank",
        "rotation",
    )
    for field in fields(kind):
        assert field.name in told, f"{field.name} is not told"
        if "Array" in str(field.type) and "Mapping" not in str(field.type):
            assert re.match(r"\(", told[field.name]), f"{field.name} has no shape"
            has_unit = "[" in told[field.name] or re.search(UNIT, field.name)
            assert has_unit or field.name.endswith(unitless), f"{field.name} has no unit"


@pytest.mark.parametrize("kind", ["scenario", "robot", "arm"])
def test_every_key_of_a_file_has_a_meaning(kind: Any) -> None:
    schema = json_schema(kind)
    tables = {"": schema, **schema["$defs"]}
    untold = [
        f"{name}.{key}"
        for name, table in tables.items()
        for key, node in table.get("properties", {}).items()
        if not node.get("description") and "$ref" not in node
    ]
    assert untold == []
