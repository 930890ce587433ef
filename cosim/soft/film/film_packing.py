"""Packs a body's films, hinges, cables, beams, chambers and masses into the arrays that kernels take."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate, pairwise
from typing import Any, Final

import numpy as np

from cosim.base.frames import IntArray
from cosim.soft.beams.node_turns import BeamArrays
from cosim.soft.beams.ring_kernels import REMEMBERED
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.element import Element
from cosim.soft.elements.hinge import Hinges
from cosim.soft.elements.membrane import Membranes
from cosim.soft.film.film_arrays import FilmArrays, FilmBeams, FilmSlots
from cosim.soft.film.film_terms import term_calls
from cosim.soft.linear.pattern import BlockPattern

_TAKEN: Final[tuple[type, ...]] = (Membranes, Hinges, Cable)
"""What the kernel knows besides rings of beams; a body with anything else is summed term by term."""


def film_arrays(body: SoftBody, apart: IntArray) -> FilmArrays | None:
    """Return a body's arrays; None where it has more than the kernel knows, or loads without a potential.

    Args:
        body: to be packed.
        apart: (k + 1,), where the nodes of its parts begin, see `ranges_apart`; what is not listed part by
            part is one.
    """
    known = all(isinstance(element, _TAKEN) or _beams_of(element) for element in body.elements)
    frictionless = all(cable.friction_coefficient == 0.0 for cable in body.cables)
    if not known or not frictionless or (body.caps and not body.closed):
        return None
    triangles, shapes, areas, drawn, stiffness, laws, fractions, forces = zip(
        *(film.arrays for film in body.membranes), strict=True
    )
    hinges, cables, bent = body.hinges, body.cables, len(body.hinges.coupled)
    angles = body.memory_places[body.elements.index(hinges)]
    gas, caps = zip(*body.enclosures, strict=True)
    rings = [ring for those in caps for ring in those]
    no_pairs, none, beams = np.zeros((0, 2), np.int64), np.zeros(0, np.int64), _film_beams(body, apart)
    segments = np.concatenate([no_pairs, *(cable.segments for cable in cables)])
    listed = hinges.coupled[:, None], segments[:, None]  # row by row
    rows = triangles, *listed, _rings(beams), gas
    return FilmArrays(
        np.array(term_calls(beams=len(beams.groups) > 0)),
        np.concatenate(triangles), np.concatenate(shapes), np.concatenate(areas), np.concatenate(drawn),
        np.array(stiffness), np.array(laws), np.array(fractions), np.concatenate(forces),
        np.stack([_firsts(triangles), _firsts(drawn), _firsts(forces)], axis=1),
        hinges.coupled, hinges.stiffness[:bent], hinges.rest_angle[:bent],
        np.array([hinges.fold_barrier_rad]), np.array([angles.start, angles.start + bent]), segments,
        np.repeat(np.arange(len(cables)), [len(cable.segments) for cable in cables]),
        np.concatenate([np.zeros(0), *(cable.tension_ratio(body.positions) for cable in cables)]),
        beams, np.concatenate(gas), np.concatenate([none, *rings]), _firsts(rings),
        np.stack([_firsts(gas), _firsts(caps)], axis=1), body.node_mass, _parts(rows, apart),
        _no_slots(len(rings)), np.zeros((0, 3, 3)),
    )  # fmt: skip


def film_slots(film: FilmArrays, pattern: BlockPattern) -> FilmSlots:
    """Return where pairs of a film's nodes are in a pattern."""
    rings = [film.rings[a:b] for a, b in zip(film.caps[:-1], film.caps[1:], strict=True)]
    caps, none = [pattern.slots(ring[None, :])[0] for ring in rings], np.zeros(0, np.int64)
    return FilmSlots(
        pattern.slots(film.triangles), pattern.slots(film.hinges), pattern.slots(film.segments),
        pattern.slots(film.gas_triangles), np.concatenate([none, *caps]), _firsts(caps),
        np.concatenate([none, *(pattern.slots(ring).ravel() for ring in _rings(film.beams))]),
        np.flatnonzero(pattern.row == pattern.column),
    )  # fmt: skip


def _no_slots(caps: int) -> FilmSlots:
    table, none = np.zeros((0, 0), np.int64), np.zeros(0, np.int64)
    return FilmSlots(table, table, table, table, none, np.zeros(caps + 1, np.int64), none, none)


def _parts(rows: Sequence[Sequence[IntArray] | IntArray], apart: IntArray) -> IntArray:
    """Return where nodes and each of some kinds of rows begin in each part; one part where they are mixed.

    Args:
        rows: nodes of each film, hinge, segment, group of rings of beams and chamber, kind by kind.
        apart: (k + 1,), where the nodes of parts begin.
    """
    columns, mixed = [apart], False
    for entries in rows:
        first, last = (np.searchsorted(apart, nodes, side="right") - 1 for nodes in _extremes(entries))
        mixed = mixed or bool((first != last).any() or (np.diff(first) < 0).any())
        column = np.searchsorted(first, np.arange(len(apart)))
        column[-1] = len(first)
        columns.append(column)
    table = np.stack(columns, axis=1)
    return np.ascontiguousarray(table[[0, -1]] if mixed else table)


def _extremes(entries: Sequence[IntArray] | IntArray) -> tuple[IntArray, IntArray]:
    """Return the lowest and the highest node of each of some entries; of none: 0."""
    if isinstance(entries, np.ndarray):
        return entries.min(axis=(1, 2)), entries.max(axis=(1, 2))
    found = [(np.min(nodes), np.max(nodes)) if np.size(nodes) else (0, 0) for nodes in entries]
    lowest, highest = np.array(found, np.int64).reshape(-1, 2).T
    return lowest, highest


def _beams_of(element: Element) -> BeamArrays | None:
    """Return an element's beams; None where it has none. Its class is known to bodies with beams alone."""
    arrays = getattr(element, "arrays", None)
    return arrays if isinstance(arrays, BeamArrays) else None


def _film_beams(body: SoftBody, apart: IntArray) -> FilmBeams:
    """Return the rings of beams of a body, those of each element part by part."""
    groups, found = list[tuple[int, int, int, int, int]](), list[BeamArrays]()
    begin, slot = 0, 0
    for element, place in zip(body.elements, body.memory_places, strict=True):
        beams = _beams_of(element)
        if beams is None:
            continue
        count, nodes = beams.rings.shape
        part = np.searchsorted(apart, beams.rings.min(axis=1), side="right")
        ends = [0, *(1 + np.flatnonzero(np.diff(part))).tolist(), count]
        for a, b in pairwise(ends):
            groups.append((begin + a * nodes, b - a, nodes, place.start + REMEMBERED * a * nodes, slot))
            slot += (b - a) * nodes * (nodes + 1) // 2
            found.append(beams)
        begin += count * nodes
    whole = list({id(beams): beams for beams in found}.values())
    return FilmBeams(
        np.array(groups, np.int64).reshape(-1, 5),
        np.concatenate([np.zeros(0, np.int64), *(np.ravel(beams.rings) for beams in whole)]),
        np.concatenate([np.zeros(0), *(np.ravel(beams.directors) for beams in whole)]),
        np.concatenate([np.zeros(0), *(np.ravel(beams.lengths) for beams in whole)]),
        np.array([beams.rigidities for beams in found]).reshape(-1, 4),
    )


def _rings(beams: FilmBeams) -> list[IntArray]:
    """Return the nodes (f, m) of each group of rings."""
    return [
        beams.rings[begin : begin + count * nodes].reshape(count, nodes)
        for begin, count, nodes, *_ in beams.groups.tolist()
    ]


def _firsts(parts: Sequence[Any]) -> IntArray:
    """Return where each of some lists begins if they follow each other, and where the last one ends."""
    return np.array([0, *accumulate(len(part) for part in parts)], dtype=np.int64)
