"""Forty pairs of runs whose answers are tied by symmetry, scale or bookkeeping, each drawn with a seed.

A pair needs no known answer: a scene that is turned, moved, scaled, written in another order, saved in the
middle or hung on somebody else's model has to do the same.
"""

from __future__ import annotations

import copy
import json
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import cosim
from cosim.cli.main import main
from cosim.results.result import RunResult

Array = NDArray[np.float64]
Table = dict[str, Any]
ROBOTS = Path(__file__).parents[2] / "robots"
PAIRS = 5
SEED = 2026
TICK_S = 0.002

RESIDUAL_N = 1e-8
"""Largest force left on a node in all of these runs, in both modes."""
MOVED_M = 1e-7
"""Turned and moved scenes: numbers of another size round otherwise, in inverse kinematics too; 0.1 um."""
SOLVED_M = 1e-7
"""Other pairs of the same physics: each run leaves RESIDUAL_N, and a wrinkled film gives way by some 1e-8 m
under it; room for ten times that. Loads move these robots by more than 1e-4 m, see MOVES_M."""
MOVES_M = 1e-4
"""Least motion of the tip in a pair, lest nothing be compared with nothing."""
SOLVED_N = 2e-6
"""Force on the flange: what is left adds up to at most 100 RESIDUAL_N in each of the two runs."""
PENALTY_M = 2e-4
"""What films that press on one another may sink in: their stiffness stays as it is when forces scale."""
EYELETS_MET_M = 1e-4
"""Below this distance of two eyelets the length of the cable between them is rounded: a length that stays."""

FINE: Table = {
    "residual_tolerance_N": RESIDUAL_N,
    "dynamic_tolerance_N": RESIDUAL_N,
    "dynamic_newton_iterations": 20,
    "damping_per_s": 10.0,
}


class Scene(NamedTuple):
    """The tables of a scenario's file and of its soft robot's."""

    scenario: Table
    robot: Table

    def copy(self) -> Scene:
        """Return one that can be changed by itself."""
        return copy.deepcopy(self)


def written(value: Any) -> str:
    """Return a value as TOML, tables in one line."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f'"{key}" = {written(each)}' for key, each in value.items()) + " }"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(written, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value)


def file_of(scene: Scene, folder: Path) -> Path:
    """Write both files of a scene and return the scenario's."""
    folder.mkdir(exist_ok=True)
    robot = folder / "drawn_robot.toml"
    for path, table in ((robot, scene.robot), (folder / "drawn.toml", scene.scenario)):
        path.write_text("".join(f"{key} = {written(value)}\n" for key, value in table.items()))
    return folder / "drawn.toml"


def ran(scene: Scene, folder: Path, overrides: Table | None = None) -> RunResult:
    """Run a scene from its files."""
    return cosim.run(file_of(scene, folder), overrides=overrides, error=False)


def numbers(rng: np.random.Generator, least: float, most: float, count: int) -> list[float]:
    """Return drawn numbers as Python's own, which are written to the last digit."""
    return [float(each) for each in rng.uniform(least, most, count)]


def drawn_robot(rng: np.random.Generator, name: str | None = None) -> Table:
    """Return the file of a small robot."""
    name = name or str(rng.choice(["square_core", "square_core_cables", "hexagon_arm"]))
    robot: Table = tomllib.loads((ROBOTS / f"{name}.toml").read_text())
    if name == "hexagon_arm":
        robot["stack"]["units"] = 2
    return robot


def drawn(rng: np.random.Generator, robot: Table, number: int, **given: Any) -> Scene:
    """Return a scene with a soft robot that hangs somewhere, and is inflated, pulled and shifted.

    Args:
        rng: draws it.
        robot: file of the soft robot.
        number: of the pair, which chooses mode and model, so that each occurs among those of a kind.
        given: tables that take the place of drawn ones.
    """
    x, y, slant = numbers(rng, -0.05, 0.05, 2), numbers(rng, -0.3, 0.3, 2), numbers(rng, -1.0, 1.0, 1)
    ticks = 2 * int(rng.integers(10, 30))
    (start_Pa,), (end_Pa,) = numbers(rng, 3e3, 6e3, 1), numbers(rng, 7e3, 12e3, 1)
    phase: Table = {
        "name": "load", "duration_s": ticks * TICK_S, "increments": 2 * int(rng.integers(2, 4)),
        "ramp": "linear", "pressure_Pa": end_Pa,
    }  # fmt: skip
    if robot.get("cable"):
        phase["cable_tension_N"] = numbers(rng, 0.2, 1.5, len(robot["cable"]))
    scenario: Table = {
        "schema": 2, "title": "Drawn", "robot": "none", "soft_robot": "drawn_robot.toml",
        "mode": "quasistatic" if number in (2, 3) else "dynamic", "model": {"published": number in (1, 2)},
        "clock": {"tick_s": TICK_S}, "solver": dict(FINE),
        "start": {
            "flange": {
                "position_m": [0.4 + x[0], x[1], 0.5], "direction": [*y, -1.0], "roll_rad": slant[0],
            },
            "pressure_Pa": start_Pa,
        },
        "phase": [phase],
    }  # fmt: skip
    return Scene({**scenario, **given}, robot)


def with_arm(rng: np.random.Generator, number: int) -> Scene:
    """Return a drawn scene; on a UR5e for odd numbers, on its own for even ones."""
    scene = drawn(rng, drawn_robot(rng), number)
    if number % 2:
        base = {"position_m": [0.0, 0.0, 0.0], "quaternion": [1.0, 0.0, 0.0, 0.0]}
        scene.scenario.update(robot="ur5e", arm_base=base)
        scene.scenario["phase"][0]["flange_shift_m"] = numbers(rng, -0.01, 0.01, 3)
    return scene


Turn = Callable[[Array], Array]
Record = Callable[[str, float], None]


def expect(found: RunResult, expected: RunResult, moved: Turn, turned: Turn, bound_m: float) -> None:
    """Assert that film, tip and force on the flange are those of another run after a motion.

    Args:
        found: one run.
        expected: the other.
        moved: what became of points, (..., 3).
        turned: what became of directions, (..., 3).
        bound_m: largest distance.
    """
    for name in ("tip_position", "node_position"):
        distance = np.abs(getattr(found, name) - moved(getattr(expected, name))).max()
        assert distance <= bound_m, f"{name}: {distance:.2g} m"
    force = np.abs(found.flange_force - turned(expected.flange_force)).max()
    assert force <= SOLVED_N, f"flange_force: {force:.2g} N"
    assert np.abs(found.tip_position - found.tip_position[0]).max() > MOVES_M


def same(values: Array) -> Array:
    """Leave values as they are."""
    return values


def about_z(angle: float) -> Array:
    """Return a rotation, (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotate(rng: np.random.Generator, number: int, folder: Path, record: Record) -> None:
    """The scene turns about the vertical, and all that happens with it."""
    plain = with_arm(rng, number)
    angle = float(rng.uniform(-3.0, 3.0))
    rotation = about_z(angle)
    other = plain.copy()
    flange, (phase,) = other.scenario["start"]["flange"], other.scenario["phase"]
    for table, key in ((flange, "position_m"), (flange, "direction"), (phase, "flange_shift_m")):
        if key in table:
            table[key] = (rotation @ table[key]).tolist()
    flange["roll_rad"] -= angle  # about the flange's own axis, which points down
    if "arm_base" in other.scenario:
        quaternion = [float(np.cos(angle / 2.0)), 0.0, 0.0, float(np.sin(angle / 2.0))]
        other.scenario["arm_base"]["quaternion"] = quaternion

    def turned(values: Array) -> Array:
        return values @ rotation.T

    expect(ran(other, folder / "b"), ran(plain, folder / "a"), turned, turned, MOVED_M)


def translate(rng: np.random.Generator, number: int, folder: Path, record: Record) -> None:
    """The scene moves elsewhere."""
    plain = with_arm(rng, number)
    way = rng.uniform([-0.5, -0.5, 0.0], [0.5, 0.5, 1.0])
    other = plain.copy()
    tables = [other.scenario["start"]["flange"]]
    tables += [other.scenario["arm_base"]] if "arm_base" in other.scenario else []
    for table in tables:
        table["position_m"] = (np.array(table["position_m"]) + way).tolist()
    expect(ran(other, folder / "b"), ran(plain, folder / "a"), lambda x: x + way, same, MOVED_M)


def split(rng: np.random.Generator, number: int, folder: Path, record: Record) -> None:
    """A linear phase becomes two of half its length, which meet in the middle."""
    plain = with_arm(rng, number)
    other = plain.copy()
    (phase,) = other.scenario["phase"]
    start = other.scenario["start"]
    phase.update(duration_s=phase["duration_s"] / 2.0, increments=phase["increments"] // 2)
    if "flange_shift_m" in phase:  # relative to where the flange is when a phase starts
        phase["flange_shift_m"] = [each / 2.0 for each in phase["flange_shift_m"]]
    first = {**phase, "name": "half", "pressure_Pa": (start["pressure_Pa"] + phase["pressure_Pa"]) / 2.0}
    if "cable_tension_N" in phase:
        first["cable_tension_N"] = [each / 2.0 for each in phase["cable_tension_N"]]
    other.scenario["phase"] = [first, phase]
    a, b = ran(plain, folder / "a"), ran(other, folder / "b")
    assert b.phase.max() == 1
    expect(b, a, same, same, SOLVED_M)


POWERS = {
    "_N_m3": (-3, 1), "_kg_m3": (-4, 1), "_m_s2": (1, 0), "_Pa": (-2, 1), "_kg": (-1, 1), "_N": (0, 1),
    "_m": (1, 0),
}  # fmt: skip
"""By unit, the powers of the scales of length and force; time stays, so masses are forces over lengths."""


def scaled(table: Any, length: float, force: float, key: str = "") -> Any:
    """Return tables whose values have been scaled by their units."""
    if isinstance(table, Mapping):
        return {name: scaled(each, length, force, name) for name, each in table.items()}
    if isinstance(table, list):
        return [scaled(each, length, force, key) for each in table]
    unit = next((unit for unit in POWERS if key.endswith(unit)), None)
    if unit is None:
        return table
    of_length, of_force = POWERS[unit]
    return float(table * length**of_length * force**of_force)


def scale(rng: np.random.Generator, number: int, folder: Path, record: Record) -> None:
    """All lengths and all forces scale, and the shapes with them.

    In the third pair films press on one another, and contact scales as well. What has a size of its own
    keeps it in the last two: eyelets of a cable meet; forces alone scale, and the stiffness of films that
    press on one another stays. Their differences are recorded, and are below that size.
    """
    touching, met, pressed = (number == PAIRS - left for left in (3, 2, 1))
    name = "hexagon_arm" if pressed else "square_core_cables" if met or touching else None
    plain = drawn(rng, drawn_robot(rng, name), number, gravity_m_s2=[0.0, 0.0, -9.81])
    (length,), (force,) = numbers(rng, 0.6, 1.6, 1), numbers(rng, 0.5, 2.0, 1)
    (phase,) = plain.scenario["phase"]
    if "cable_tension_N" in phase:
        phase["cable_tension_N"] = [(1.0 if met else 0.1) * each for each in phase["cable_tension_N"]]
    if met or touching:
        plain.scenario["model"] = {"published": met}
    if not (met or pressed):  # these are the defaults
        plain.scenario["contact"] = {"stiffness_N_m3": 3e8, "smoothing_m": 1e-4, "stick_m": 1e-4}
    if pressed:
        length = 1.0
        plain.scenario.update(mode="quasistatic", model={"published": False})
        phase.update(pressure_Pa=30e3, cable_tension_N=[8.0, 0.5])
    other = Scene(*(scaled(table, length, force) for table in plain))
    a, b = ran(plain, folder / "a"), ran(other, folder / "b")
    difference = float(np.abs(b.node_position - length * a.node_position).max())
    for key, value in {"length": length, "force": force, "difference_m": difference}.items():
        record(key, value)
    record("eyelets_apart_m", eyelets_apart(a))
    if touching or pressed:
        assert min(a.self_contacts.max(), b.self_contacts.max()) > 0
    assert (eyelets_apart(a) < EYELETS_MET_M) is met
    if met or pressed:
        assert difference < (EYELETS_MET_M if met else PENALTY_M)
    else:
        assert difference <= SOLVED_M
        assert np.abs(b.flange_force - force * a.flange_force).max() <= SOLVED_N
    if pressed:  # the default's stiffness, scaled: nothing differs
        other.scenario["contact"] = {"stiffness_N_m3": 3e8 * force}
    elif met:  # lengths as they are: nothing differs
        other, length = Scene(*(scaled(table, 1.0, force) for table in plain)), 1.0
    else:
        return
    c = ran(other, folder / "c")
    assert np.abs(c.node_position - length * a.node_position).max() <= SOLVED_M


def eyelets_apart(result: RunResult) -> float:
    """Return the least distance of neighbouring eyelets of a cable, infinite without any [m]."""
    ways = (np.diff(result.node_position[:, nodes], axis=1) for nodes in result.stage.cables)
    return min((float(np.linalg.norm(way, axis=2).min()) for way in ways), default=np.inf)


def permute(rng: np.random.Generator, number: int, folder: Path, record: Record) -> None:
    """Cables (0, 1), objects (2), or pressures of chambers (3: a list, or by name) come in another order.

    The last pair exchanges the pressures of two copies, half a turn about the flange's axis apart.
    """
    names = ["square_core_cables", "hexagon_arm", "square_core", "square_core", "square_core"]
    plain = drawn(rng, drawn_robot(rng, names[number]), number)
    if number == 2:
        plain.scenario.update(mode="dynamic", robot="ur5e", model={"published": True})
        plain.scenario["object"] = objects_near(plain)
    if number > 2:
        plain.robot["copies"] = {"count": 2, "radius_m": 0.05, "tilt_rad": numbers(rng, 0.0, 0.2, 1)[0]}
        plain.scenario["start"]["flange"]["direction"] = [0.0, 0.0, -1.0]
        low, high = numbers(rng, 2e3, 6e3, 1)[0], numbers(rng, 7e3, 12e3, 1)[0]
        plain.scenario["phase"][0]["pressure_Pa"] = {"copy_1": low, "copy_2": high}
    other = plain.copy()
    (phase,) = other.scenario["phase"]
    if number < 2:
        other.robot["cable"].reverse()
        phase["cable_tension_N"].reverse()
    elif number == 2:
        other.scenario["object"].reverse()
    elif number == 3:
        plain.scenario["phase"][0]["pressure_Pa"] = [low, high]
        phase["pressure_Pa"] = {"copy_2": high, "copy_1": low}
    else:
        phase["pressure_Pa"] = {"copy_1": high, "copy_2": low}
    a, b = ran(plain, folder / "a"), ran(other, folder / "b")
    if number == 2:
        assert a.contacts.max() > 0
    if number == PAIRS - 1:
        expect_exchanged(b, a)
    else:
        expect(b, a, same, same, SOLVED_M)


def objects_near(scene: Scene) -> list[Table]:
    """Return a box that the tip of a scene's robot presses on, and a ball that falls beside it."""
    x, y, z = scene.scenario["start"]["flange"]["position_m"]
    box = {"name": "box", "shape": "box", "size_m": [0.2, 0.2, 0.05], "position_m": [x, y, z - 0.0585]}
    ball = {
        "name": "ball", "shape": "sphere", "size_m": [0.02], "position_m": [x + 0.2, y, z], "mass_kg": 0.1,
    }  # fmt: skip
    return [box, ball]


def expect_exchanged(found: RunResult, expected: RunResult) -> None:
    """Assert that two copies, and the force on their flange, have changed places by half a turn about z."""
    half = about_z(np.pi)
    origin = expected.flange_position[-1]
    nodes = expected.node_position.shape[1] // 2
    turned = origin + (expected.node_position - origin) @ half.T
    turned = np.concatenate([turned[:, nodes:], turned[:, :nodes]], axis=1)
    distance = np.abs(found.node_position - turned).max()
    assert np.abs(found.node_position - expected.node_position).max() > MOVES_M
    assert distance <= MOVED_M, f"node_position: {distance:.2g} m"
    force = np.abs(found.flange_force - expected.flange_force @ half.T).max()
    assert force <= SOLVED_N, f"flange_force: {force:.2g} N"


def overridden(rng: np.random.Generator, number: int, folder: Path, record: Record) -> None:
    """Values of `--set` are those of a file, to the last bit."""
    plain = with_arm(rng, number)
    other = plain.copy()
    changes: Table = {
        "phase.load.pressure_Pa": numbers(rng, 7e3, 12e3, 1)[0],
        "start.pressure_Pa": numbers(rng, 3e3, 6e3, 1)[0],
        "solver.damping_per_s": numbers(rng, 5.0, 20.0, 1)[0],
        "soft_robot.film.thickness_m": numbers(rng, 0.9e-4, 1.3e-4, 1)[0],
        "gravity_m_s2": [*numbers(rng, -1.0, 1.0, 2), -9.0],
    }
    given, chosen = other.scenario, "published" if number % 2 else "closed"
    changes[f"model.{chosen}"] = bool(number % 2)
    given["phase"][0]["pressure_Pa"] = changes["phase.load.pressure_Pa"]
    given["start"]["pressure_Pa"] = changes["start.pressure_Pa"]
    given["solver"]["damping_per_s"] = changes["solver.damping_per_s"]
    given["gravity_m_s2"] = changes["gravity_m_s2"]
    given["model"][chosen] = bool(number % 2)
    other.robot["film"]["thickness_m"] = changes["soft_robot.film.thickness_m"]
    sets = [word for key, value in changes.items() for word in ("--set", f"{key}={written(value)}")]
    words = ["run", str(file_of(plain, folder / "a")), "--quiet", "--no-error", "--out", str(folder / "out")]
    assert main([*words, *sets]) == 0
    expect_bits(cosim.load_run(folder / "out"), ran(other, folder / "b"))


def expect_bits(found: RunResult, expected: RunResult) -> None:
    """Assert that all arrays of two runs agree in every bit, wall time aside."""
    assert found.arrays.keys() == expected.arrays.keys()
    for name, value in found.arrays.items():
        assert name == "tick_wall_s" or value.tobytes() == expected.arrays[name].tobytes(), name


def restored(rng: np.random.Generator, number: int, folder: Path, record: Record) -> None:
    """Another simulation that goes on from the middle ends where the first one did, to the last bit."""
    path = file_of(with_arm(rng, number), folder / "a")
    one, other = cosim.Simulation(path), cosim.Simulation(path)
    one.step(int(rng.integers(1, one.ticks_left)))
    saved: Any = one.save()
    if number > 1:
        saved.write(folder / "saved.npz")
        saved = folder / "saved.npz"
    other.restore(saved)
    while one.ticks_left:
        a, b = one.step(), other.step()
        for name in (
            "node_position",
            "tip_position",
            "joint_position",
            "joint_torque",
            "chamber_pressure_Pa",
        ):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), name
        assert a.wrench.force.tobytes() == b.wrench.force.tobytes()


def attached(rng: np.random.Generator, number: int, folder: Path, record: Record) -> None:
    """A soft robot on a mount in somebody's MuJoCo model does what it does on a held base.

    For odd numbers MuJoCo takes two steps a tick.
    """
    steps = 1 + number % 2
    scene = drawn(rng, drawn_robot(rng), number, mode="dynamic", phase=[])
    simulation = cosim.Simulation(file_of(scene, folder / "a"))
    mount = simulation.snapshot.world_from_flange
    x, y = mount.rotation[:, 0], mount.rotation[:, 1]
    place = f'pos="{" ".join(map(repr, mount.translation.tolist()))}"'
    axes = f'xyaxes="{" ".join(map(repr, [*x.tolist(), *y.tolist()]))}"'
    spec = mujoco.MjSpec.from_string(
        f'<mujoco><option timestep="{TICK_S / steps}"/><worldbody><body name="mount" {place} {axes}>'
        '<geom type="sphere" size="0.01"/></body></worldbody></mujoco>'
    )
    overrides: Table = {f"solver.{key}": value for key, value in FINE.items()}
    overrides["start.pressure_Pa"] = scene.scenario["start"]["pressure_Pa"]
    overrides["model.published"] = scene.scenario["model"]["published"]
    robot = folder / "a" / "drawn_robot.toml"
    soft = cosim.attach(spec, "mount", robot, tick_s=TICK_S, overrides=overrides)
    model = spec.compile()
    data = mujoco.MjData(model)
    soft.reset(model, data)
    (chamber,), cables = simulation.stage.chamber_names, simulation.stage.cable_names
    (end_Pa,), pulls = numbers(rng, 7e3, 12e3, 1), numbers(rng, 0.2, 1.5, len(cables))
    ticks, begun = int(rng.integers(20, 60)), soft.tip_position
    for tick in range(ticks):
        share = (tick + 1) / ticks
        tensions = {name: share * pull for name, pull in zip(cables, pulls, strict=True)}
        command = cosim.Command(pressure_Pa={chamber: 6e3 + share * (end_Pa - 6e3)}, cable_tension_N=tensions)
        seen = simulation.step(command)
        soft.command(command)
        soft.step(model, data, steps)
        assert np.abs(soft.film - seen.node_position).max() <= SOLVED_M
        assert np.abs(soft.wrench.force - seen.wrench.force).max() <= SOLVED_N
    assert np.linalg.norm(soft.tip_position - begun) > MOVES_M


Pair = Callable[[np.random.Generator, int, Path, Record], None]
KINDS: tuple[Pair, ...] = (rotate, translate, split, scale, permute, overridden, restored, attached)


@pytest.mark.parametrize("number", range(PAIRS))
@pytest.mark.parametrize("kind", KINDS, ids=[kind.__name__ for kind in KINDS])
def test_pairs_agree(
    kind: Pair, number: int, tmp_path: Path, record_testsuite_property: Callable[[str, object], None]
) -> None:
    """Of each kind some pairs, see there; what is drawn depends on kind and number alone."""

    def record(name: str, value: float) -> None:
        record_testsuite_property(f"{kind.__name__}-{number}.{name}", value)

    kind(np.random.default_rng([SEED, KINDS.index(kind), number]), number, tmp_path, record)
