"""JSON Schema (draft 2020-12) of scenario, robot and arm files, for editors. It is generated from the tables'
classes: bounds, defaults and enumerations come from the fields, descriptions from the docstrings. Rules
across tables are not in it.
"""

from copy import deepcopy
from typing import Any, Final, Literal, final

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue

from cosim.config import arm_table, plugins, several_arms
from cosim.config.schema import given_body, phase, scenario, soft_robot
from cosim.config.toml.old_keys import SCHEMA
from cosim.config.toml.tables import adapter_of

DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"
Kind = Literal["scenario", "robot", "arm"]
_ROOTS: Final[dict[Kind, type]] = {
    "scenario": scenario.Scenario,
    "robot": soft_robot.SoftRobotTable,
    "arm": arm_table.ArmTable,
}
_CHANGES: Final = "Changes"
_ARM: Final = "OneOfSeveralArms"
_ROBOT_GIVEN: Final = (
    {"type": "string", "description": "Name or path of a soft robot's file."},
    {"$ref": f"#/$defs/{soft_robot.SoftRobotTable.__name__}"},
    {"$ref": f"#/$defs/{soft_robot.SoftRobotTable.__name__}{_CHANGES}"},
)


def json_schema(kind: Kind) -> dict[str, Any]:
    """Return the JSON Schema of scenario, robot or arm files.

    Args:
        kind: "scenario", "robot" or "arm".
    """
    plugins.register_installed()
    root = _ROOTS[kind].__name__
    made = adapter_of(_ROOTS[kind]).json_schema(schema_generator=_WithoutNull)
    tables: dict[str, Any] = made.pop("$defs")
    if kind != "robot":
        tables[root] = made
    if kind == "scenario":
        made["required"].remove("name")  # that of the file, if it is left out
        tables[phase.PhaseTable.__name__]["required"].remove("duration_s")  # that of a tip path, beside one
        del tables[given_body.GivenBodyTable.__name__]
        _give_robot(tables[root]["properties"]["soft_robot"])
        _add_arms(tables)
    if kind != "arm":
        _add_changes(tables)
    top = {"anyOf": _ROBOT_GIVEN[1:]} if kind == "robot" else tables.pop(root)
    named = {"$id": f"urn:cosim:{kind}:{SCHEMA}", "title": f"cosim {kind}, schema {SCHEMA}"}
    return {"$schema": DIALECT, **named, **top, "$defs": tables}


@final
class _WithoutNull(GenerateJsonSchema):
    """Leaves null out of the schema: in TOML an absent value is an absent key."""

    def nullable_schema(self, schema: Any) -> JsonSchemaValue:
        """Return the schema of the value if it is present."""
        return self.generate_inner(schema["schema"])


def _add_arms(tables: dict[str, Any]) -> None:
    """Add the table of `[[arm]]` with the keys that each of several arms may give."""
    top = tables[scenario.Scenario.__name__]
    own = {key: top["properties"][key] for key in several_arms.OF_AN_ARM}
    name = {key: value for key, value in top["properties"]["name"].items() if key != "description"}
    name["description"] = "of the arm, in front of the names of its bodies, and of its folder of results."
    tables[_ARM] = {
        "type": "object",
        "description": "One of several arms in a scene; a key that it leaves out is that above the arms.",
        "additionalProperties": False,
        "properties": {"name": name, **own},
        "required": ["name"],
    }
    arms = {"type": "array", "minItems": 2, "items": {"$ref": f"#/$defs/{_ARM}"}}
    top["properties"]["arm"] = arms | {"description": "`[[arm]]` of several; the keys of one need none."}
    needed = [key for key in several_arms.OF_AN_ARM if key in top["required"]]
    top["required"] = [key for key in top["required"] if key not in needed]
    top["anyOf"] = [{"required": needed}, {"required": ["arm"]}]


def _add_changes(tables: dict[str, Any]) -> None:
    """Add the tables that change a soft robot's file: tables of a soft robot without required keys."""
    changes = deepcopy(tables[soft_robot.SoftRobotTable.__name__])
    for node in changes["properties"].values():
        name = node.get("$ref", "").rpartition("/")[2]
        if "required" in tables.get(name, {}):
            tables[name + _CHANGES] = {k: v for k, v in tables[name].items() if k != "required"}
            node["$ref"] += _CHANGES
    changes["properties"]["file"] = {"type": "string", "description": "Name or path of what is changed."}
    tables[soft_robot.SoftRobotTable.__name__ + _CHANGES] = changes | {"required": ["file"]}
    _give_robot(tables[soft_robot.AttachmentTable.__name__]["properties"]["robot"])


def _give_robot(node: dict[str, Any]) -> None:
    """Allow the forms in which files give a soft robot (name, path, changes to a file) for a key."""
    for key in ("$ref", "oneOf"):
        node.pop(key, None)
    node["anyOf"] = _ROBOT_GIVEN
