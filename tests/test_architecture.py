"""The package keeps its shape: order of layers, sole importers, sizes, no traces of a machine."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = sorted((ROOT / "cosim").rglob("*.py"))
PYTHON_FILES = SOURCES + sorted((ROOT / "tests").rglob("*.py")) + sorted((ROOT / "benchmarks").rglob("*.py"))
TEXT_SUFFIXES = {".py", ".toml", ".md", ".cff", ".urdf", ".yaml", ".yml", ".sh", ""}

# What a layer may import, besides itself. `top` joins everything for the command line and cosim.run.
BASICS = {
    "errors", "frames", "frozen", "resources", "arm_files", "body_shape", "kept_data", "kernel_cache",
    "kernels", "mesh_files", "output_directory", "stateful", "state_archive", "state_check", "whole_files",
    "__init__",
}  # fmt: skip
TOP = {
    "api", "checkpoint", "code_identity", "driver", "first_run", "loaded_files", "result", "run_files",
    "shown_state", "simulation",
}  # fmt: skip
PHYSICS = {"basics", "soft", "rigid", "kinematics"}
JOINING = PHYSICS | {"coupling", "actuation"}
MAY_IMPORT = {
    "basics": {"basics"},
    "soft": {"basics"},
    "verification": {"basics", "soft"},
    "rigid": {"basics"},
    "kinematics": {"basics"},
    "coupling": PHYSICS,
    "actuation": {"basics", "soft"},
    "scenario": JOINING,
    "recording": JOINING | {"scenario"},
    "trade": JOINING | {"scenario"},
    "top": JOINING | {"scenario", "recording", "trade"},
    "cli": JOINING | {"scenario", "recording", "top", "verification", "trade"},
}
SOLE_IMPORTERS = {"mujoco": "rigid", "pinocchio": "kinematics", "rerun": "recording"}
MAX_FILE_LINES = 320
MAX_FUNCTION_LINES = 60


def layer_of(module: str) -> str:
    """Return the layer of a module given as a dotted path below cosim ("" is the package itself)."""
    head = module.split(".")[0] or "__init__"
    return "basics" if head in BASICS else "top" if head in TOP else "cli" if head == "__main__" else head


def imports_of(path: Path) -> set[str]:
    """Return the modules that a file imports; imports for type checkers only do not count."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
            node.body = []
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            base = node.module or ""
            found |= {base} if base != "cosim" else {f"cosim.{alias.name}" for alias in node.names}
    return found


def layer_violations(path: Path, imports: set[str]) -> list[str]:
    """Return the imports that break the order of the layers or the rule of sole importers."""
    own = layer_of(".".join(path.relative_to(ROOT / "cosim").with_suffix("").parts))
    violations = []
    for module in imports:
        package, _, rest = module.partition(".")
        if package == "cosim" and not rest.startswith("__version__"):
            if layer_of(rest) not in MAY_IMPORT[own] | {own}:
                violations.append(f"{own} imports {module}")
        elif SOLE_IMPORTERS.get(package, own) != own:
            violations.append(f"{own} imports {package}; only {SOLE_IMPORTERS[package]} may")
    return violations


def relative(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", SOURCES, ids=relative)
def test_layers_import_downwards_only(path: Path) -> None:
    assert layer_violations(path, imports_of(path)) == []


@pytest.mark.parametrize(
    ("file", "module"),
    [
        ("soft/x.py", "cosim.rigid.scene"),
        ("soft/x.py", "mujoco"),
        ("rigid/x.py", "pinocchio"),
        ("coupling/x.py", "cosim.scenario.snapshot"),
        ("scenario/x.py", "cosim.recording.recorder"),
        ("scenario/x.py", "rerun.blueprint"),
        ("recording/x.py", "cosim.driver"),
        ("soft/x.py", "cosim.verification.suite"),
        ("verification/x.py", "cosim.scenario.schema"),
        ("frames.py", "cosim.soft.body"),
        ("actuation/x.py", "cosim.scenario.schema"),
    ],
)
def test_the_rule_finds_violations(file: str, module: str) -> None:
    assert layer_violations(ROOT / "cosim" / file, {module})


def test_every_folder_of_the_package_is_a_known_layer() -> None:
    folders = {path.name for path in (ROOT / "cosim").iterdir() if path.is_dir()}
    assert folders - {"__pycache__", "_data"} == set(MAY_IMPORT) - {"basics", "top"}
    modules = {path.stem for path in (ROOT / "cosim").glob("*.py")}
    assert modules == BASICS | TOP | {"__main__"}


@pytest.mark.parametrize("path", PYTHON_FILES, ids=relative)
def test_files_and_functions_stay_short(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= MAX_FILE_LINES
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno is not None
            lines = node.end_lineno - node.lineno + 1
            assert lines <= MAX_FUNCTION_LINES, f"{node.name} has {lines} lines"


@pytest.mark.parametrize("path", SOURCES, ids=relative)
def test_public_names_say_what_they_are(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    definitions = [node for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
    documented = ast.get_docstring(tree) is not None or not definitions
    assert documented, "the module has no docstring"
    for node in definitions:
        if not node.name.startswith("_"):
            assert ast.get_docstring(node), f"{node.name} has no docstring"


def test_no_file_names_a_place_on_somebodys_machine() -> None:
    pattern = re.compile(r"/(?:home|root|work|Users|tmp)/[A-Za-z0-9_.]")
    hidden = {".ci"}
    generated = {"runs", "build", "dist", "__pycache__"}
    files = (
        path
        for path in ROOT.rglob("*")
        if path.suffix in TEXT_SUFFIXES
        and path.is_file()
        and not generated & set(path.relative_to(ROOT).parts)
        and not any(part.startswith(".") and part not in hidden for part in path.relative_to(ROOT).parts)
    )
    found = [relative(path) for path in files if pattern.search(path.read_text(encoding="utf-8"))]
    assert found == []
