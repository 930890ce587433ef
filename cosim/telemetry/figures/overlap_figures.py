"""Overlaps of films with one another, with links, and with films of other arms."""

from collections.abc import Mapping, Sequence
from typing import Any

from cosim.soft.solve.branching import FilmOverlap


def joined_overlaps(
    before: list[dict[str, Any]], phase: str, time_s: float, overlaps: Sequence[FilmOverlap]
) -> list[dict[str, Any]]:
    """Return the overlaps of a run after a further check: the deepest of each phase and link, and its start.

    Args:
        before: rows of the summary before the check.
        phase: name of the phase.
        time_s: of the check.
        overlaps: at that time.
    """
    joined = list(before)
    for overlap in overlaps:
        what = phase, overlap.link, overlap.arm
        same = [k for k, row in enumerate(joined) if (row["phase"], row["link"], row["arm"]) == what]
        row = {"phase": phase, "since_s": time_s, "time_s": time_s} | vars(overlap)
        if not same:
            joined.append(row)
        elif overlap.depth_m > joined[same[0]]["depth_m"]:
            joined[same[0]] = row | {"since_s": joined[same[0]]["since_s"]}
    return joined


def overlap_lines(overlaps: list[dict[str, Any]]) -> list[str]:
    """Return a sentence on the overlap of films, and one on the overlap with each link or arm.

    Args:
        overlaps: of the summary.
    """
    lines = []
    for link, arm in dict.fromkeys(map(_link_and_arm, overlaps)):
        rows = [row for row in overlaps if _link_and_arm(row) == (link, arm)]
        deepest = max(rows, key=lambda row: float(row["depth_m"]))
        what, most, remedy = f"the film is in link '{link}' of the arm", "up to", ""
        if arm is not None:
            what, most = f"the film passes through that of arm '{arm}'", "at least"
            remedy = "; films of different arms do not touch: keep them apart"
        elif link is None:
            what = "films pass through one another"
            remedy = '; with contact.self_contact = "auto" they press on one another'
        lines.append(
            f"{what} from {rows[0]['since_s']:.4g} s on, by {most} {1e3 * deepest['depth_m']:.2g} mm "
            f"at {deepest['time_s']:.4g} s (phase '{deepest['phase']}', {deepest['place']}){remedy}"
        )
    return lines


def _link_and_arm(row: Mapping[str, Any]) -> tuple[str | None, str | None]:
    """Return the link, or the arm whose film, a film overlaps; None for both in older runs."""
    return row.get("link"), row.get("arm")


def overlap_warnings(overlaps: list[dict[str, Any]]) -> list[str]:
    """Return a warning for each arm with whose film a film overlaps; see `overlap_lines`."""
    return overlap_lines([row for row in overlaps if row.get("arm") is not None])
