"""README, Makefile and package agree with each other; a wheel carries its data."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import cosim
from cosim.base.resources import list_scenarios, list_soft_robots
from cosim.cli.main import main

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_every_make_target_of_the_readme_exists() -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    named = set(
        re.findall(r"\bmake ([a-z]+)\b", "\n".join(re.findall(r"```sh\n(.*?)```", README, re.DOTALL)))
    )
    assert {"demo", "test"} <= named <= targets


def test_continuous_integration_runs_the_readmes_test_command() -> None:
    assert "make test" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")


def test_the_tested_set_of_packages_fits_what_the_project_asks_for() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = [
        *project["dependencies"],
        *(one for each in ("dev", "docs") for one in project["optional-dependencies"][each]),
    ]
    tested = {
        canonicalize_name(name): version
        for name, version in re.findall(
            r"^([\w.-]+)==(\S+)$", (ROOT / "constraints.txt").read_text("utf-8"), re.M
        )
    }
    for requirement in map(Requirement, asked):
        assert requirement.specifier.contains(tested[canonicalize_name(requirement.name)]), requirement


def test_every_command_of_the_readme_is_understood(capsys: pytest.CaptureFixture[str]) -> None:
    shell = "\n".join(re.findall(r"```sh\n(.*?)```", README, re.DOTALL))
    used = set(re.findall(r"^cosim (\w+)", shell, re.MULTILINE))
    with pytest.raises(SystemExit):
        main(["--help"])
    shown = capsys.readouterr().out
    assert used == {"check", "list", "new", "run", "verify", "view"}
    assert all(re.search(rf"^\s+{command}\s", shown, re.MULTILINE) for command in used)


def test_every_scenario_of_the_readme_exists() -> None:
    for name in re.findall(r"^cosim run (\w+) ", README, re.MULTILINE):
        assert name in list_scenarios()


def test_every_link_of_a_document_leads_somewhere() -> None:
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]
    links = [
        (page, target)
        for page in pages
        for target in re.findall(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    ]
    assert [(page.name, target) for page, target in links if not (page.parent / target).exists()] == []


def test_every_page_is_reached_from_the_readme_by_links() -> None:
    """As on the web, where the lists of Sphinx are no links."""
    reached, todo = set[Path](), [ROOT / "README.md"]
    while todo:
        page = todo.pop().resolve()
        if page in reached or not page.exists():
            continue
        reached.add(page)
        if page.suffix == ".md":
            links = re.findall(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
            todo += [page.parent / link for link in links]
    pages = [page for page in (ROOT / "docs").glob("*") if page.suffix in (".md", ".ipynb")]
    assert [page.name for page in pages if page.resolve() not in reached] == []


def test_every_page_stands_in_the_index() -> None:
    docs = ROOT / "docs"
    index = (docs / "index.md").read_text(encoding="utf-8")
    listed = re.findall(r"^([\w-]+)$", index, re.MULTILINE)
    pages = {page.stem for page in docs.glob("*") if page.suffix in (".md", ".ipynb")} - {"index"}
    assert pages == set(listed), "put the page under a caption of docs/index.md"
    assert len(listed) == len(set(listed))


def test_the_citation_has_the_packages_version() -> None:
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(rf"^version: {re.escape(cosim.__version__)}$", text, re.MULTILINE)


def test_an_installed_wheel_finds_its_data_from_another_directory(tmp_path: Path) -> None:
    pytest.importorskip("hatchling", reason="needs the development tools: pip install -e .[dev]")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path / "dist")]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    site, elsewhere = tmp_path / "site", tmp_path / "elsewhere"
    elsewhere.mkdir()
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    code = (
        f"import sys; sys.path.insert(0, {str(site)!r}); import cosim; from cosim.base import resources as r;"
        "assert cosim.__file__.startswith(sys.path[0]), cosim.__file__;"
        "cosim.load_scenario('ur5e_hexagon_arm'); assert (r.robots_directory() / 'ur5e').is_dir();"
        "from cosim.cli.main import main; main(['new', 'mine']);"
        "print(*r.list_scenarios(), *r.list_soft_robots())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=elsewhere, check=True, capture_output=True, text=True
    )
    assert done.stdout.splitlines()[1].split() == [*list_scenarios(), *list_soft_robots()]
    assert (elsewhere / "mine.toml").is_file()


def test_dependencies_are_bounded_where_their_interfaces_move() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for name in ("coal", "example-robot-data", "mujoco", "numba", "pin", "rerun-sdk"):
        (entry,) = (text for text in project["dependencies"] if re.match(rf"{name}[^a-z-]", text))
        assert "<" in entry or "==" in entry
