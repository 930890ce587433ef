"""On systems without POSIX, and without the libraries of the arm: what can run runs, what cannot says why."""

import subprocess
import sys
from pathlib import Path
from textwrap import dedent

BARE = """
    import os, signal, sys
    for name in ("fcntl", "pwd", "grp", "resource", "pinocchio", "coal"):
        sys.modules[name] = None
    for module, name in ((os, "getuid"), (os, "geteuid"), (os, "sched_getaffinity"), (signal, "SIGHUP")):
        if hasattr(module, name):
            delattr(module, name)
    from cosim.cli.main import main
"""
"""What a process is without, before it loads anything of cosim."""


def bare(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", dedent(BARE) + code], cwd=folder, capture_output=True, text=True, timeout=300
    )


def test_a_run_without_an_arm_needs_neither_posix_nor_pinocchio(tmp_path: Path) -> None:
    words = ["run", "three_unit_inflation", "--out", "run", "--no-recording", "--quiet"]
    found = bare(f"raise SystemExit(main({words}))", tmp_path)
    assert (found.returncode, found.stdout) == (0, ""), found.stderr
    assert (tmp_path / "run" / "summary.json").is_file()


def test_a_soft_robot_on_a_users_model_does_not_load_the_arms_libraries(tmp_path: Path) -> None:
    code = dedent("""
        import cosim, mujoco
        spec = mujoco.MjSpec.from_string(
            "<mujoco><worldbody>"
            "<body name='hand' pos='0 0 1'><freejoint/><geom size='0.05'/></body>"
            "</worldbody></mujoco>"
        )
        soft = cosim.attach(spec, at="hand", robot="square_core")
        model = spec.compile()
        data = mujoco.MjData(model)
        soft.step(model, data)
        print(soft.tip_position)
    """)
    found = bare(code, tmp_path)
    assert found.returncode == 0, found.stderr
    assert found.stdout.startswith("[")


def test_a_run_with_an_arm_names_the_command_that_installs_what_is_missing(tmp_path: Path) -> None:
    words = ["run", "ur5e_hexagon_arm", "--out", "run", "--quiet"]
    found = bare(f"raise SystemExit(main({words}))", tmp_path)
    assert found.returncode == 2
    assert "'coal' cannot be loaded: pip install pin coal" in found.stderr
    assert "Traceback" not in found.stderr
