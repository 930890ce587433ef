"""The search for faults that no test notices: which there are, and that each is judged by tests."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from benchmarks.faults.code_faults import Fault, faults
from benchmarks.faults.mutants import ROOT, draw, judge, record
from benchmarks.faults.source_tree import SourceTree


def faults_of(text: str) -> list[str]:
    """Return what each fault makes of a text."""
    source = text.encode()
    return [fault.applied(source).decode() for fault in faults("cosim/a.py", source)]


@pytest.mark.parametrize(
    ("text", "faults"),
    [
        ("a = b + c", ["a = (b - c)"]),
        ("a -= b * c", ["a += b * c", "a -= (b / c)"]),
        ("a = -b", ["a = (b)"]),
        ("a = b < c", ["a = (b <= c)"]),
        ("a = b >= 0.5", ["a = (b > 0.5)", "a = b >= 1.0", "a = b >= 0.0"]),
        ("a = b is None and not c", ["a = (b is None or not c)", "a = (b is not None) and not c",
                                     "a = b is None and (c)"]),
        ("a = b[0]", ["a = b[1]"]),
        ("a = b[:, 1:-1]", ["a = b[:, 2:-1]", "a = b[:, 1:(1)]", "a = b[:, 1:-2]"]),
        ("a = range(4)", ["a = range(3)"]),
        ("a = min(b, c)", ["a = (max(b, c))"]),
        ("a = np.fmax(b, c)", ["a = (np.fmin(b, c))"]),
        ("a = f(b, c)", ["a = (f(c, b))"]),
        ("a = f(b, b)", []),
        ("a = b @ c", ["a = (c @ b)"]),
        ("f()", ["pass"]),
        ("def f(a):\n    b()\n    c = a", ["def f(a):\n    pass\n    c = a",
                                          "def f(a):\n    return\n    c = a",
                                          "def f(a):\n    b()\n    return"]),
        ("def f(a):\n    b()\n    return a", ["def f(a):\n    pass\n    return a"]),
        ("def f(a: tuple[int, 2] = 1) -> int:\n    '''One.'''\n    return a",
         ["def f(a: tuple[int, 2] = 2) -> int:\n    '''One.'''\n    return a",
          "def f(a: tuple[int, 2] = 0) -> int:\n    '''One.'''\n    return a"]),
        ("raise E(1 + 2)", []),
        ("a = f'{b + 1}' + 'c'", []),
        ("tell(1, 2)", ["pass"]),
        ("@f(1)\nclass A:\n    b: int = 0", ["@f(1)\nclass A:\n    b: int = 1"]),
    ],
)  # fmt: skip
def test_faults_are_small_changes_of_what_a_test_could_see(text: str, faults: list[str]) -> None:
    assert sorted(faults_of(text)) == sorted(faults)


def test_a_seed_draws_the_same_faults_from_all_rooms_and_all_are_python() -> None:
    drawn = draw(3, 200)
    assert drawn == draw(3, 200)
    assert len({(fault.path, fault.line) for fault in drawn}) == 200
    assert len({fault.path.split("/")[1] for fault in drawn}) > 10
    assert set(drawn) != set(draw(4, 200))
    for fault in drawn:
        source = (ROOT / fault.path).read_bytes()
        compile(fault.applied(source), fault.path, "exec")
        assert fault.difference(source)
    assert {fault.path.split("/")[1] for fault in draw(3, 20, ["plan", "soft/contact"])} == {"plan", "soft"}


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """Return a small repository of which one function is tested, by way of a number."""
    files = {
        "cosim/__init__.py": "",
        "cosim/sides.py": "HEIGHT = 3.0\n\n\ndef perimeter(a):\n    return 2.0 * a\n",
        "cosim/area.py": "from cosim.sides import HEIGHT\n\n\ndef area(a):\n    return HEIGHT * a\n",
        "tests/test_area.py": "from cosim.area import area\n\ndef test_area():\n    assert area(2.0) == 6.0",
    }
    for name, text in files.items():
        (tmp_path / "repository" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "repository" / name).write_text(text, encoding="utf-8")
    shutil.copytree(ROOT / "benchmarks" / "faults", tmp_path / "repository" / "benchmarks" / "faults")
    subprocess.run(["git", "init", "-q"], cwd=tmp_path / "repository", check=True)
    subprocess.run(["git", "add", "."], cwd=tmp_path / "repository", check=True)
    return tmp_path / "repository"


def test_a_fault_is_found_by_a_test_that_fails_and_by_nothing_else(repository: Path, tmp_path: Path) -> None:
    sound, records = record(tmp_path / "work", repository, processes=1)
    assert records.functions == {"tests/test_area.py::test_area": ["cosim/area.py:area"]}
    source = (repository / "cosim/sides.py").read_bytes()
    number, *_, untested = faults("cosim/sides.py", source)
    assert (number.owner, untested.owner) == ("HEIGHT", "perimeter")
    # a number leaves no trace of its own: what uses it does
    assert records.order(number) == ["tests/test_area.py::test_area"]
    assert records.order(untested) == []
    verdict = judge(number, sound, records, tmp_path / "faulty", near=True)
    assert (verdict.found, verdict.by) == (True, "tests/test_area.py::test_area")
    assert not judge(untested, sound, records, tmp_path / "faulty", near=True).found
    assert not judge(untested, sound, records, tmp_path / "faulty", near=False).found
    assert (sound.root / "cosim/sides.py").read_bytes() == source


def test_kernels_that_use_a_changed_file_are_compiled_anew(repository: Path, tmp_path: Path) -> None:
    tree = SourceTree.of_repository(repository, tmp_path / "sound").linked(tmp_path / "faulty")
    folder = tree.root / "cosim" / "__pycache__"
    folder.mkdir()
    for name in ("area.area-4.py311.nbi", "area.area-4.py311.1.nbc", "sides.perimeter-4.py311.nbi"):
        (folder / name).touch()
    tree.replace("cosim/area.py", b"")
    assert [path.name for path in folder.iterdir()] == ["sides.perimeter-4.py311.nbi"]
    (folder / "area.area-4.py311.nbi").touch()
    tree = SourceTree.of_repository(repository, tmp_path / "other")
    shutil.copytree(folder, tree.root / "cosim" / "__pycache__")
    tree.replace("cosim/sides.py", b"HEIGHT = 2.0\n")
    assert not list((tree.root / "cosim" / "__pycache__").iterdir())


def test_a_fault_says_what_it_changes() -> None:
    source = b"a = 1\nb = a < 2\n"
    fault = Fault("cosim/a.py", 2, "b", "comparison", 10, 15, "(a <= 2)")
    assert fault in faults("cosim/a.py", source)
    assert fault.difference(source) == ["-b = a < 2", "+b = (a <= 2)"]
