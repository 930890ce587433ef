"""Every key of scenario, robot and arm files as tables, from the JSON Schema that editors are given."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final

from cosim.config.json_schema import Kind, json_schema

HEAD: Final = "| key | unit | type and bounds | default | meaning |\n|---|---|---|---|---|"
_ROOTS: Final = {"scenario": "", "robot": "SoftRobotTable", "arm": ""}
_ELSEWHERE: Final = {"SoftRobotTable": "keys_robot.md"}
"""Tables that have a page of their own."""


def key_tables(kind: Kind) -> str:
    """Return Markdown with a section for each table of a kind of files.

    Args:
        kind: "scenario", "robot" or "arm".
    """
    schema = json_schema(kind)
    root = schema["$defs"].get(_ROOTS[kind], schema)
    elsewhere = {} if kind == "robot" else _ELSEWHERE
    tables = {name: table for name, table in schema["$defs"].items() if table is not root}
    return "\n\n".join(_Tables(tables, elsewhere).sections("", root))


@dataclass
class _Tables:
    """Walks over a schema, and tells each table once, where it is met first.

    Args:
        defined: tables by name.
        elsewhere: pages of tables that are not told here.
        told: headings of tables by name.
    """

    defined: dict[str, Any]
    elsewhere: dict[str, str]
    told: dict[str, str] = field(default_factory=dict)

    def sections(self, path: str, table: dict[str, Any]) -> Iterator[str]:
        """Yield the section of a table, then those of the tables in it.

        Args:
            path: of the table in a file; empty for the file itself.
            table: its schema.
        """
        inner = [
            (heading, name)
            for key, node in table["properties"].items()
            for heading, name in self._tables_in(_joined(path, key), node)
        ]
        new = {name: heading for heading, name in reversed(inner) if name not in self.told}
        self.told |= new
        required = table.get("required", ())
        rows = [
            self._row(_joined(path, key), key, node, key in required)
            for key, node in table["properties"].items()
        ]
        heading = f"## `{_bracketed(path)}`" if path else "## Outside of tables"
        yield "\n\n".join([heading, table.get("description", ""), "\n".join([HEAD, *rows])])
        for heading, name in inner:
            if new.pop(name, None) is not None:
                yield from self.sections(heading, self.defined[name])

    def _tables_in(self, path: str, node: dict[str, Any]) -> Iterator[tuple[str, str]]:
        """Yield path and name of the tables that a key may hold; a list of tables has `[]` at its end."""
        for choice in (node, *node.get("anyOf", ()), *node.get("oneOf", ())):
            name = choice.get("$ref", "").rpartition("/")[2]
            if name in self.defined and name not in self.elsewhere and not name.endswith("Changes"):
                yield path, name
        if isinstance(node.get("items"), dict):
            yield from self._tables_in(f"{path}[]", node["items"])

    def _row(self, path: str, key: str, node: dict[str, Any], required: bool) -> str:
        meaning = re.sub(r" ?Unit: \S.*\.$", "", node.get("description", ""))
        links = [self._link(name) for _, name in self._tables_in(path, node)]
        links += [f"[its page]({page})" for name, page in self.elsewhere.items() if name in str(node)]
        default = "required" if required else _value(node["default"]) if "default" in node else ""
        cells = [f"`{key}`", node.get("x-unit", ""), _type(node), default, " ".join([meaning, *links])]
        return "| " + " | ".join(cell.replace("|", "\\|").strip() for cell in cells) + " |"

    def _link(self, name: str) -> str:
        heading = _bracketed(self.told[name])
        return f"[see `{heading}`](#{re.sub(r'[^a-z0-9_ -]', '', heading.lower()).replace(' ', '-')})"


def _joined(path: str, key: str) -> str:
    return f"{path}.{key}" if path else key


def _bracketed(path: str) -> str:
    """Return how a table is opened in a file: [a.b], or [[a.b]] of a list of tables."""
    plain = path.replace("[]", "")
    return f"[[{plain}]]" if path.endswith("[]") else f"[{plain}]"


def _type(node: dict[str, Any]) -> str:
    """Return type and bounds of a value in words."""
    if "$ref" in node or "oneOf" in node:
        return "table"
    if "anyOf" in node:
        return _alternatives([_type(choice) for choice in node["anyOf"]])
    if "enum" in node:
        return ", ".join(map(_value, node["enum"]))
    if "const" in node:
        return _value(node["const"])
    if node["type"] == "array":
        parts = node.get("prefixItems") or [node.get("items", {})]
        inner = ", ".join(dict.fromkeys(_type(part) for part in parts if part)) or "value"
        return f"list of {len(parts)}: {inner}" if "prefixItems" in node else f"list: {inner}"
    if node["type"] == "object":
        values = node.get("additionalProperties")
        return f"table by name: {_type(values)}" if isinstance(values, dict) else "table"
    return " ".join(filter(None, [node["type"], _bounds(node)]))


def _alternatives(types: list[str]) -> str:
    """Return types joined by "or"; a list or table of what stands first does not repeat it."""
    first, *further = dict.fromkeys(types)
    return " or ".join([first, *(kind.replace(f": {first}", " of these") for kind in further)])


def _bounds(node: dict[str, Any]) -> str:
    below, above = node.get("exclusiveMinimum"), node.get("exclusiveMaximum")
    said = []
    if below is not None and node.get("minimum", below) <= below:
        said.append(f"> {below:g}")
    elif "minimum" in node:
        said.append(f"≥ {node['minimum']:g}")
    if above is not None:
        said.append(f"< {above:g}")
    elif "maximum" in node:
        said.append(f"≤ {node['maximum']:g}")
    return ", ".join(said)


def _value(value: Any) -> str:
    return f"`{json.dumps(value, ensure_ascii=False)}`"
