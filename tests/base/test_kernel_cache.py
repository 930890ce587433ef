"""Machine code is kept under a hash of all the source that went into it."""

from __future__ import annotations

import ast
import os
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from types import CodeType, ModuleType

import pytest

from cosim.base import compilation, kernel_cache, kernels
from tests.base.forked_python import run_forked
from tests.compiled import all_modules

SOURCES = Path(kernels.__file__).parent
KERNEL = """
from cosim.base.kernels import kernel
from {package}.factor import times
@kernel
def scaled(x: float) -> float:
    return times(x)
"""
HELPER = """
from cosim.base.kernels import device_function
from {package}.constants import FACTOR
@device_function
def times(x):
    return {factor} * FACTOR * x
"""


def of_modules(source: str) -> str:
    """Return code that imports the modules of a helper and of a number, and names both through these."""
    source = source.replace("from {package}.factor import times", "from {package} import factor")
    source = source.replace("from {package}.constants import FACTOR", "from {package} import constants")
    return source.replace("return times", "return factor.times").replace(" FACTOR", " constants.FACTOR")


def write(
    folder: Path, name: str, factor: float = 2.0, constant: float = 1.0, *, qualified: bool = False
) -> None:
    """Write a package of a kernel, a helper that is inlined from another file, and a number of a third.

    Args:
        folder: of the package.
        name: of the package.
        factor: in the helper.
        constant: the number.
        qualified: whether files import one another as modules, not names from these.
    """
    kernel, helper = map(of_modules, (KERNEL, HELPER)) if qualified else (KERNEL, HELPER)
    numbers = f"# of kernels, see cosim.base.kernel_cache\nFACTOR = {constant}\n"
    (folder / "constants.py").write_text(numbers, encoding="utf-8")
    (folder / "factor.py").write_text(helper.format(package=name, factor=factor), encoding="utf-8")
    (folder / "scaled.py").write_text(kernel.format(package=name), encoding="utf-8")


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Return a copy of cosim with what kernels need, and such a package within it."""
    folder = tmp_path / "cosim"
    shutil.copytree(SOURCES, folder / "base", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "__init__.py").touch()
    shutil.copy(SOURCES.parent / "errors.py", folder)
    write(folder, "cosim")
    return folder


def run(package: Path, name: str = "cosim", before: str = "", **environment: str) -> tuple[float, int, str]:
    """Return what the kernel makes of 1 in a new process, how often it was compiled, and what was said."""
    code = (
        f"from {name}.scaled import scaled; y = scaled(1.0);print(y, sum(scaled.stats.cache_misses.values()))"
    )
    # by size and whole seconds Python would not see that a file is changed at once
    fresh = "import sys; sys.dont_write_bytecode = True; "
    done = run_forked(fresh + before + code, package.parent, **environment)
    assert done.returncode == 0, done.stderr
    value, misses = done.stdout.split()
    return float(value), int(misses), done.stderr.replace(f"{compilation.ANNOUNCEMENT}\n", "")


def kept_files(folder: Path) -> list[Path]:
    return sorted((folder / "kernels").rglob("*.nbc"))


@pytest.mark.parametrize(
    ("name", "before"), [("cosim", ""), ("own", ""), ("own", "import numba; numba.__version__ = '0.99.0';")]
)
def test_what_is_inlined_from_another_file_is_compiled_anew_when_that_changes(
    package: Path, name: str, before: str
) -> None:
    folder = package.parent / name
    folder.mkdir(exist_ok=True)
    (folder / "__init__.py").touch()
    write(folder, name)
    assert run(package, name, before)[:2] == (2.0, 1)
    assert run(package, name, before)[:2] == (2.0, 0)
    write(folder, name, factor=3.0)
    assert run(package, name, before)[:2] == (3.0, 1)
    write(folder, name, factor=3.0, constant=10.0)
    assert run(package, name, before)[:2] == (30.0, 1)
    write(folder, name)
    assert run(package, name, before) == (2.0, 0, "")  # kept beside the others


def test_what_is_called_through_its_module_is_compiled_anew_when_that_changes(package: Path) -> None:
    write(package, "cosim", qualified=True)
    assert "factor.times" in (package / "scaled.py").read_text(encoding="utf-8")
    assert "constants.FACTOR" in (package / "factor.py").read_text(encoding="utf-8")
    assert run(package)[:2] == (2.0, 1)
    assert run(package)[:2] == (2.0, 0)
    write(package, "cosim", factor=3.0, qualified=True)
    assert run(package)[:2] == (3.0, 1)
    write(package, "cosim", factor=3.0, constant=10.0, qualified=True)
    assert run(package)[:2] == (30.0, 1)


def test_damaged_machine_code_is_compiled_anew_with_a_warning(package: Path) -> None:
    assert run(package) == (2.0, 1, "")
    (file,) = kept_files(package / "__pycache__")
    sound = file.read_bytes()
    for content in (b"", bytes(range(256)) * 40, sound[: len(sound) // 2], sound[:-1] + b"?"):
        file.write_bytes(content)
        value, misses, said = run(package)
        assert (value, misses) == (2.0, 1)
        assert f"RuntimeWarning: {file}: is damaged" in said
        assert run(package) == (2.0, 0, "")


def test_a_folder_to_which_others_may_write_is_not_used(package: Path, tmp_path: Path) -> None:
    chosen, own = tmp_path / "chosen", tmp_path / "home"
    chosen.mkdir(mode=0o777)
    places = {"COSIM_CACHE_DIR": str(chosen), "XDG_CACHE_HOME": str(own)}
    assert run(package, **places) == (2.0, 1, "")
    # an own one, whoever writes to that around it; what root makes everybody may read
    assert (chosen / "kernels").stat().st_mode & 0o777 == (0o700 if os.getuid() else 0o755)
    (file,) = kept_files(chosen)
    file.write_bytes(b"not to be read")
    (chosen / "kernels").chmod(0o777)
    value, misses, said = run(package, **places)
    assert (value, misses) == (2.0, 1)
    assert f"RuntimeWarning: {chosen / 'kernels'}: others own it or may write to it" in said
    assert "is damaged" not in said
    assert file.read_bytes() == b"not to be read"
    assert len(kept_files(own / "cosim")) == 1
    assert run(package, **places)[:2] == (2.0, 0)
    file.unlink()
    (chosen / "kernels").chmod(0o700)  # the remedy
    assert run(package, **places) == (2.0, 1, "")


def test_without_a_folder_that_can_be_written_kernels_are_compiled_each_time(package: Path) -> None:
    places = {"COSIM_CACHE_DIR": str(package / "errors.py"), "XDG_CACHE_HOME": str(package / "errors.py")}
    assert run(package, **places) == run(package, **places) == (2.0, 1, "")


@pytest.mark.skipif(os.getuid() != 0, reason="only root can write as somebody else")
def test_another_user_reads_what_root_has_compiled(package: Path) -> None:
    """Without a folder to write to as well; not what a third user might have written."""
    with TemporaryDirectory() as place:  # that of pytest is closed to other users
        Path(place).chmod(0o755)
        shutil.copytree(package, Path(place, "cosim"), dirs_exist_ok=True)
        package, nowhere = Path(place, "cosim"), str(Path(place, "cosim", "errors.py"))
        assert run(package, XDG_CACHE_HOME=nowhere) == (2.0, 1, "")
        other = "import os; os.setgid(12345); os.setuid(12345);"
        assert run(package, before=other, XDG_CACHE_HOME=nowhere) == (2.0, 0, "")
        assert len(kept_files(package / "__pycache__")) == 1
        os.chown(package / "__pycache__" / "kernels", 54321, 54321)
        value, misses, said = run(package, before=other, XDG_CACHE_HOME=nowhere)
        assert (value, misses) == (2.0, 1)
        assert "others own it or may write to it" in said


def test_settings_of_the_compiler_count(package: Path) -> None:
    assert run(package)[1] == 1
    assert run(package, NUMBA_OPT="1")[1] == 1
    assert run(package, NUMBA_NUM_THREADS="1")[1] == 0


def test_a_first_call_loads_what_was_compiled_before_it(package: Path) -> None:
    ahead = "from cosim.scaled import scaled; scaled.compile(scaled.fixed_signature);"
    assert run(package, before=ahead)[:2] == (2.0, 1)
    assert run(package)[:2] == (2.0, 0)


def test_scripts_beside_one_another_have_their_own(package: Path) -> None:
    runs = []
    for name in ("one", "other"):
        script = package.parent / f"{name}.py"
        script.write_text(KERNEL.format(package="cosim").replace("x)", f"x) + {len(name)}"), encoding="utf-8")
        runs.append(f"print(runpy.run_path({str(script)!r}, run_name='__main__')['scaled'](1.0))")
    for _ in range(2):
        done = run_forked(f"import runpy; {'; '.join(runs)}", package.parent)
        assert done.stdout.split() == ["5.0", "7.0"], done.stderr


def test_files_from_which_kernels_take_names_are_part_of_the_hash() -> None:
    """Numbers as well, which are compiled into them."""
    outside = set()
    for module in all_modules():
        own = [each.py_func for each in vars(module).values() if hasattr(each, "py_func")]
        read = {name for function in own for name in names_in(function.__code__)}
        tree = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("cosim"):
                names = [alias.name for alias in node.names if (alias.asname or alias.name) in read]
                for name in names:
                    found = sys.modules.get(f"{node.module}.{name}", sys.modules[str(node.module)])
                    outside |= set() if has_kernels(found) else {found.__name__}
    assert outside == set()


def names_in(code: CodeType) -> set[str]:
    """Return the names that code reads, in functions within as well."""
    within = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return {*code.co_names, *(name for each in within for name in names_in(each))}


def has_kernels(module: ModuleType) -> bool:
    """Return whether a module is part of the hash."""
    return kernel_cache.has_kernels(Path(str(module.__file__)).read_bytes())
