"""The commands `cosim new`, `cosim schema` and `cosim list arms`: a starting scenario, the JSON Schema of
files for editors, and the arms that come with cosim.
"""

import json
import re
from pathlib import Path
from typing import Final

from cosim.base import resources, writing
from cosim.base.whole_files import write_whole
from cosim.build.arms import find_arm
from cosim.config import arm_files
from cosim.config.json_schema import Kind, json_schema
from cosim.errors import InputError

SCHEMA_FILE: Final = "cosim-scenario.schema.json"
_LONGEST_NAME: Final = 64
_STARTING_SCENARIO: Final = Path(__file__).with_name("starting_scenario.toml")


def schema_text(kind: Kind) -> str:
    """Return the JSON Schema of a kind of files, as a text."""
    return json.dumps(json_schema(kind), indent=2, ensure_ascii=False) + "\n"


def check_new_name(name: str, longest: int) -> None:
    """Check the name of a scenario that is written as NAME.toml.

    Raises:
        InputError: it has other characters, or is longer than `longest`.
    """
    if not re.fullmatch("[A-Za-z][A-Za-z0-9_-]*", name) or len(name) > longest:
        raise InputError(
            f"new {name!r}: give a letter followed by letters, digits, '_' or '-', {longest} characters at "
            "most, without .toml"
        )


def new_command(name: str) -> None:
    """Write a starting scenario, and the JSON Schema with which editors check it, to the working directory.

    Args:
        name: of the scenario.

    Raises:
        InputError: the name is invalid, or a file of that name exists.
        OutputError: a file cannot be written.
    """
    check_new_name(name, _LONGEST_NAME)
    path, schema, text = Path(f"{name}.toml"), Path(SCHEMA_FILE), schema_text("scenario")
    if path.exists():
        raise InputError(f"new {name}: {path} is there and is not overwritten; give another name")
    if schema.exists() and schema.read_bytes() != text.encode():
        raise InputError(f"new {name}: another {schema} is there and is not overwritten; move it away")
    scenario = f"#:schema ./{SCHEMA_FILE}\n{_STARTING_SCENARIO.read_text(encoding='utf-8')}"
    for file, content in ((schema, text), (path, scenario)):
        with writing.writing(file):
            write_whole(file, content)
    print(f"{path} written, with {schema} for editors; run it: cosim run {path}")


def arm_lines() -> list[str]:
    """Return a line for each arm that comes with cosim: its name, joints, flange and title."""
    rows = []
    for name in resources.list_arms():
        try:
            arm = find_arm(name)
        except InputError as error:
            rows.append((name, str(error)))
            continue
        title = arm_files.read_arm_table(resources.arm_path(name)).title or ""
        rows.append((name, f"{len(arm.joint_names)} joints, {arm.notes[0].partition(',')[0]}  {title}"))
    width = max((len(name) for name, _ in rows), default=0)
    return [f"{name:<{width}}  {text}" for name, text in rows]
