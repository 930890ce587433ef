"""Runs the reference scenario, writes it for robots, reads it back with other libraries, and plays it back.

    python benchmarks/round_trip.py [--set KEY=VALUE ...]

A rim that phase "lift" holds is let go: no robot does that. Prints what joints lose on the way, how far
joints and tip of the played run are from the first one, and the torque by which a controller is wrong with
one payload, and with one told every 0.5 s.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

import cosim
from cosim.base.frames import Array
from cosim.config.toml.reading import parse_assignment
from cosim.results.ros_bag import write_bag

_SCENARIO: Final = "ur5e_hexagon_arm"
_LET_GO: Final[dict[str, Any]] = {"phase.lift.clamp": []}


def from_yaml(path: Path) -> Array:
    """Return the joints (n, 6) of a JointTrajectory."""
    points = yaml.safe_load(path.read_text(encoding="utf-8"))["points"]
    return np.array([point["positions"] for point in points])


def from_script(path: Path) -> Array:
    """Return the joints (n, 6) of every servoj in URScript."""
    rows = re.findall(r"servoj\(\[([^]]*)\]", path.read_text(encoding="utf-8"))
    return np.array([[float(angle) for angle in row.split(",")] for row in rows])


def from_mcap(path: Path) -> Array:
    """Return the joints (n, 6) that were asked for, of a bag's file, read by `mcap`."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [said.position for *_, said in reader.iter_decoded_messages(topics=["/joint_targets"])]
    return np.array(found)


def from_rosbags(path: Path) -> Array:
    """Return the joints (n, 6) that were asked for, of a bag, read by `rosbags`."""
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        wanted = [one for one in reader.connections if one.topic == "/joint_targets"]
        read: list[Any] = [reader.deserialize(raw, one.msgtype) for one, _, raw in reader.messages(wanted)]
        return np.array([said.position for said in read])


def played(result: cosim.RunResult, table: cosim.JointTable, overrides: dict[str, Any]) -> None:
    """Print how far a replay of a table is from the run that it came from."""
    kept = {key: value for key, value in overrides.items() if not key.startswith("phase.")}
    found = cosim.replay(_SCENARIO, table, overrides=kept)
    again, begin_s = found.result, found.begin_s
    at = np.minimum(result.time_s, table.time_s[-1])

    def apart(name: str) -> Array:
        columns = getattr(again, name).T
        replayed = np.column_stack([np.interp(at + begin_s, again.time_s, column) for column in columns])
        return np.asarray(np.abs(replayed - getattr(result, name)))

    tip = 1e3 * np.linalg.norm(apart("tip_position"), axis=1)
    print(
        f"played back: joints within {apart('joint_position').max():.1e} rad, tip within {tip.max():.3f} mm, "
        f"at the end {tip[-1]:.3f} mm"
    )


def main() -> None:
    """Run, write, read, play, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--set", dest="assignments", metavar="KEY=VALUE", action="append", default=[])
    overrides = {**_LET_GO, **dict(map(parse_assignment, parser.parse_args().assignments))}
    with TemporaryDirectory() as folder:
        result = cosim.run(_SCENARIO, overrides=overrides, error=False, out=folder)
        table = cosim.run_path(result, rate_Hz=1.0 / result.stage.tick_s)
        bag = Path(folder) / "bag"
        write_bag(result, bag)
        for name, read in (("way.yaml", from_yaml), ("way.script", from_script)):
            table.write(Path(folder) / name)
            print(f"{name}: joints within {np.abs(read(Path(folder) / name) - table.joints).max():.1e} rad")
        for name, joints in (("mcap", from_mcap(bag / "bag.mcap")), ("rosbags", from_rosbags(bag))):
            apart = np.abs(joints - result.joint_target).max()
            print(f"bag, read by {name}: joints within {apart:.1e} rad")
        print(cosim.payload_torque(folder))
        played(result, table, overrides)


if __name__ == "__main__":
    main()
