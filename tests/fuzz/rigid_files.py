"""Mutated files of arms, cells, bodies and objects: URDF, MJCF, arm.toml, scenarios, OBJ and STL."""

from __future__ import annotations

import re
import shutil
import struct
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Final, final

from tests.fuzz.rigid_sources import sources
from tests.fuzz.tables import broken, mutated, mutations_of, toml_text

_VALUES: Final = (
    "0", "-1", "1", "2", "1e30", "-1e30", "1e300", "1e400", "inf", "-inf", "nan", "", " ", "x", "1e-30",
    "1e-300", "100", "1 2", "0 0 0", "world", "root", "hand", "true", "false", "100000", "2147483647",
    "4294967296", "-5", "0.5", "1e6", "../../x", "/dev/zero", "/etc/passwd", "box.obj", "box.stl",
    "cell.xml", "arm.urdf", "arm.xml", "a" * 3000, "\u00e4\U0001f916", "&amp;&lt;", "&#10;", "&e;", "mesh",
    "plane", "hfield", "ball", "free", "slide", "continuous", "prismatic", "package://x/y.stl",
    "file://box.stl",
)  # fmt: skip
_LARGEST: Final = 1_000_000  # bytes of a file that is mutated further
_NOT_FINITE: Final = re.compile(r'"[^"]*\b(?:nan|inf)\b[^"]*"')
_ELEMENTS: Final = """\
<include file="cell.xml"/>
<include file="arm.xml"/>
<include file="part.xml"/>
<include file="none.xml"/>
<include file="/dev/zero"/>
<include/>
<body><freejoint/><geom size="1"/></body>
<replicate count="100000"><body><geom size="0.1"/></body></replicate>
<replicate count="400"><replicate count="400"><geom size="0.1"/></replicate></replicate>
<replicate count="30" offset="0.5 0 0"><geom size="0.1" pos="0 0 3"/></replicate>
<composite type="cable" count="3000 1 1" curve="s" size="1"><geom type="capsule" size="0.01"/></composite>
<flexcomp name="f" type="grid" count="100 100 100" spacing="1 1 1" mass="1"/>
<flexcomp name="f" type="grid" count="3 3 3" spacing="0.1 0.1 0.1" mass="1"/>
<geom type="mesh" mesh="none"/>
<geom type="sdf" mesh="m"/>
<joint type="ball"/>
<joint type="hinge"/>
<camera name="c" fovy="nan"/>
<light pos="inf 0 0"/>
<site pos="nan 0 0"/>
<frame euler="nan 0 0"/>
<geom size="1e200" mass="1e300"/>
<geom type="box" size="1e-200 1 1"/>
<geom fromto="0 0 0 0 0 0" type="capsule" size="1"/>
<body pos="nan 0 0"><geom size="0.1"/></body>
<body mocap="true"><geom size="0.1" pos="0 0 5"/></body>
<link name="l"/>
<joint name="j" type="fixed"><parent link="hand"/><child link="root"/></joint>
<link name="l"><visual><geometry><mesh filename="none.stl"/></geometry></visual></link>
<mujoco><compiler inertiafromgeom="true" boundmass="1e300"/></mujoco>
<mujoco/>
<worldbody/>
<gazebo><a><b/></a></gazebo>
<attach model="m" body="base" prefix="p"/>
<!-- -->
<![CDATA[x]]>
<?xml version='1.0' encoding='utf-16'?>
<plugin plugin='mujoco.pid'/>
<geom type='box' size='1 1'/>
""".splitlines()
_SECTIONS: Final = """\
<asset><hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/></asset>
<asset><texture name="u" type="2d" builtin="flat" width="90000" height="90000"/></asset>
<asset><mesh name="b" builtin="supersphere" params="3000 1 1"/></asset>
<asset><mesh name="n" file="none.obj"/></asset>
<asset><mesh name="n" file="tube.toml"/></asset>
<asset><texture name="p" type="2d" file="box.obj"/></asset>
<asset><hfield name="p" file="box.stl" size="1 1 1 1"/></asset>
<asset><mesh name="n" vertex="0 0 0 1 0 0 0 nan 0 0 0 1"/></asset>
<asset><model name="m" file="cell.xml"/></asset>
<asset><model name="m" file="part.xml"/></asset>
<asset><mesh name="n" vertex="0 0 0 1 0 0 0 1 0 0 0 1" face="0 1 9"/></asset>
<extension><plugin plugin="none"/></extension>
<size memory="100G"/>
<size njmax="-5" nconmax="9999999"/>
<option timestep="nan"/>
<statistic extent="nan"/>
<visual><map force="nan"/></visual>
<compiler eulerseq="abc"/>
<compiler angle="x"/>
<compiler strippath="true" meshdir="/none"/>
<compiler balanceinertia="true" settotalmass="1e300"/>
<compiler autolimits="false"/>
<default><geom size="nan"/></default>
<default class="main"><default class="main"/></default>
<keyframe><key qpos="nan"/></keyframe>
<custom><numeric name="n" size="2000000000"/></custom>
<custom><text name="t" data="nan"/></custom>
<contact><exclude body1="table" body2="none"/></contact>
<equality><weld body1="table" body2="post"/></equality>
<tendon><spatial><site site="none"/></spatial></tendon>
<sensor><rangefinder site="none"/></sensor>
<deformable><flex name="f" dim="2"/></deformable>
<deformable><skin name="s" file="box.obj"/></deformable>
<equality><joint joint1="j1"/></equality>
""".splitlines()


@final
@dataclass(frozen=True)
class RigidCase:
    """Files of which one has been mutated.

    Args:
        source: which set of files it was made from.
        changes: in words.
        files: contents by name.
        checked: name of the file that is checked.
        refused: whether it must be: a number of an MJCF is not finite.
    """

    source: str
    changes: str
    files: Mapping[str, bytes]
    checked: str
    refused: bool = False

    def write(self, folder: Path) -> Path:
        """Write the files into a folder in place of all that is there; return the checked one's path."""
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for name, data in self.files.items():
            (folder / name).write_bytes(data)
        return folder / self.checked


def rigid_case(seed: int) -> RigidCase:
    """Return the mutated files of a seed."""
    rng = Random(seed)
    name, checked, files = rng.choice(sources())
    target = rng.choice([file for file in files if file != "part.xml" or rng.random() < 0.3])
    data = files[target]
    changed, done = data, list[str]()
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        if len(changed) < _LARGEST:
            changed, what = _mutated(target, changed, rng)
            done.append(what)
    text = changed.decode("utf-8", "replace")
    refused = target in ("cell.xml", "arm.xml", "part.xml") and _has_bad_number(text)
    return RigidCase(name, f"{target}: {'; '.join(done)}", {**files, target: changed}, checked, refused)


def unchanged() -> Iterator[RigidCase]:
    """Yield the files as they are."""
    for name, checked, files in sources():
        yield RigidCase(name, "none", files, checked)


def _mutated(name: str, data: bytes, rng: Random) -> tuple[bytes, str]:
    """Return a file's contents with one mutation, and what it is."""
    if not data or (name.endswith(".stl") and rng.random() < 0.8):
        return _damaged_bytes(data, rng)
    text = data.decode("utf-8", "replace")
    if rng.random() < 0.08:
        text, what = broken(text, rng)
    elif name.endswith(".toml"):
        text, what = _toml(text, rng)
    elif name.endswith((".urdf", ".xml")):
        text, what = rng.choice(_XML)(text, rng)
    else:
        text, what = _mesh(text, rng)
    return text.encode("utf-8", "surrogatepass"), what


def _toml(text: str, rng: Random) -> tuple[str, str]:
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError):  # already broken
        return broken(text, rng)
    if not table:
        return text, "none"
    changed, done = mutated(table, mutations_of(table, rng))
    return toml_text(changed), "; ".join(done)


def _place(pattern: str, text: str, rng: Random) -> re.Match[str] | None:
    found = list(re.finditer(pattern, text))
    return rng.choice(found) if found else None


def _replaced(pattern: str, new: Callable[[str, Random], str]) -> Callable[[str, Random], tuple[str, str]]:
    """Return a mutation that puts something in the place of one match of a pattern."""

    def mutation(text: str, rng: Random) -> tuple[str, str]:
        found = _place(pattern, text, rng)
        if found is None:
            return text, "none"
        put = new(found.group(), rng)
        return text[: found.start()] + put + text[found.end() :], f"{found.group()!r:.60} becomes {put!r:.90}"

    return mutation


def _one_word(value: str, rng: Random) -> str:
    words = value.strip('"').split() or [""]
    words[rng.randrange(len(words))] = rng.choice(_VALUES)
    return f'"{" ".join(words)}"'


def _repeated(element: str, rng: Random) -> str:
    """Return an element many times, each with a name of its own or with the same one."""
    count = rng.choice((2, 2, 30, 5000, 20_000))
    if rng.random() < 0.5:
        return count * element
    return "".join(element.replace('name="', f'name="{k}_') for k in range(count))


def _nested(element: str, rng: Random) -> str:
    depth = rng.choice((2, 60, 250, 400, 1000, 5000, 100_000))
    outer = rng.choice(("body", "frame", "link", "default", "x", 'replicate count="2"'))
    return f"{depth * f'<{outer}>'}{element}{depth * f'</{outer.split()[0]}>'}"


def _chained(_tag: str, rng: Random) -> str:
    """Return a long chain of links, for the end of a URDF."""
    count = rng.choice((9, 120, 480, 600, 20_000))
    joints = (
        f'<link name="c{k}"/><joint name="d{k}" type="fixed"><parent link="{f"c{k - 1}" if k else "hand"}"/>'
        f'<child link="c{k}"/></joint>'
        for k in range(count)
    )
    return f"{''.join(joints)}</robot>"


_TAGGED, _OPENED, _TEXT, _ATTRIBUTE = r"<[^<>/!?]+/>", r"<\w[^<>]*(?<!/)>", r'"[^"]*"', r' [\w:]+="[^"]*"'
_XML: Final = (
    _replaced(_TEXT, lambda _old, rng: f'"{rng.choice(_VALUES)}"'),
    *3 * (_replaced(_TEXT, _one_word),),
    _replaced(_TAGGED, lambda _old, _rng: ""),
    _replaced(_TAGGED, _repeated),
    _replaced(_TAGGED, _nested),
    _replaced(_ATTRIBUTE, lambda _old, _rng: ""),
    _replaced(_ATTRIBUTE, lambda old, _rng: 2 * old),
    _replaced(_ATTRIBUTE, lambda old, rng: old.replace("=", rng.choice(("s=", "_=", "2=")), 1)),
    _replaced(_OPENED, lambda old, rng: old + rng.choice(_ELEMENTS)),
    _replaced(_OPENED, lambda old, rng: old + rng.choice(_ELEMENTS)),
    _replaced(r"</\w+>\s*\Z", lambda old, rng: rng.choice(_SECTIONS) + old),
    _replaced(r"</\w+>\s*\Z", lambda old, rng: rng.choice(_SECTIONS) + old),
    _replaced(r"</robot>", _chained),
    _replaced(r"\A", lambda _old, _rng: '<!DOCTYPE a [<!ENTITY e "ee"><!ENTITY f "&e;&e;">]>'),
)  # fmt: skip


def _has_bad_number(text: str) -> bool:
    """Return whether an attribute consists of numbers of which one is not finite."""
    for found in _NOT_FINITE.findall(text):
        try:
            [float(word) for word in found.strip('"').split()]
        except ValueError:
            continue
        return True
    return False


def _mesh(text: str, rng: Random) -> tuple[str, str]:
    """Return a text of a mesh with other words or lines."""
    lines = text.splitlines()
    at = rng.randrange(len(lines))
    words = lines[at].split() or [""]
    match rng.choice(("word", "word", "word", "delete", "double", "swap", "many", "all")):
        case "word":
            words[rng.randrange(len(words))] = rng.choice(_VALUES)
            lines[at] = " ".join(words)
        case "delete":
            del lines[at]
        case "double":
            lines.insert(rng.randrange(len(lines)), lines[at])
        case "swap":
            rng.shuffle(words)
            lines[at] = " ".join(words)
        case "many":
            lines = lines * rng.choice((2, 300, 3000) if len(lines) < 1000 else (2,))
        case _:
            factor = rng.choice((1e-30, 1e-9, 1e-3, 0.0, -1.0, 1e3, 1e9, 1e30, 1e200))
            lines = [_scaled(line, factor) for line in lines]
    return "\n".join(lines) + "\n", f"line {at}: {lines[min(at, len(lines) - 1)] if lines else ''!r:.60}"


def _scaled(line: str, factor: float) -> str:
    word, *rest = line.split() or [""]
    try:
        return " ".join((word, *(repr(float(x) * factor) for x in rest))) if word == "v" else line
    except ValueError:
        return line


def _damaged_bytes(data: bytes, rng: Random) -> tuple[bytes, str]:
    """Return the bytes of a binary STL with other numbers, another count, or another length."""
    changed, at = bytearray(data or b"x"), rng.randrange(len(data or b"x"))
    match rng.choice(("bits", "float", "float", "count", "cut", "longer")):
        case "bits":
            changed[at] ^= 1 << rng.randrange(8)
        case "float":
            number = rng.choice((float("nan"), float("inf"), 0.0, 1e30, -1e-30, 1e38, 0.5))
            at = 96 + 50 * rng.randrange(12) + 4 * rng.randrange(9)
            changed[at : at + 4] = struct.pack("<f", number)
        case "count":
            changed[80:84] = struct.pack("<I", rng.choice((0, 1, 11, 13, 10**6, 2**32 - 1)))
        case "cut":
            del changed[at:]
        case _:
            changed += bytes(rng.choice((1, 50, 10**5)))
    return bytes(changed), f"bytes from {at}"
