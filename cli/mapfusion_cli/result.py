"""The result of a replay in words for a person, and as JSON for a program."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

from mapfusion.summary import PairSummary
from mapfusion_cli.printing import one_line
from mapfusion_cli.replay_job import Done
from mapfusion_io.interfaces import Loss
from mapfusion_io.read_errors import printable

LONGEST_CELL = 160
"""Characters in a column of a table."""


def result_json(done: Done) -> str:
    """The document of the output's summary.json with run times and the output's path."""
    document = {
        **done.document,
        "output": str(done.output),
        "left_out": list(done.left_out),
        "elapsed_s": dict(done.elapsed_s),
    }
    return json.dumps(document, indent=2, sort_keys=True, allow_nan=False)


def result_text(done: Done, *, verbose: bool) -> str:
    """Groups, pairs, what was lost, and what to do next."""
    summary, mission = done.summary, done.mission
    lines = [
        f"{done.output}: {len(mission.robots)} robots, {summary.num_snapshots} snapshots over "
        f"{(summary.last_ns - summary.first_ns) * 1e-9:.1f} s",
        "",
        *_groups(done),
        "",
        *_pairs(summary.pairs_in_order),
        *_advice(done),
        *(f"warning: {warning}" for warning in done.warnings),
        *_missing_poses(done),
        *losses_text(done.losses),
        *_unverifiable(done),
        *(f"not copied: {item}" for item in done.left_out),
    ]
    maps = [item for item in mission.passed_over if verbose or item.schema_name == "nav_msgs/msg/OccupancyGrid"]
    lines += [f"passed over: {item.source} {item.topic}: {item.reason}" for item in maps]
    return "\n".join(map(one_line, lines))


def losses_text(losses: Sequence[Loss]) -> list[str]:
    """One line for each loss: where, what kind, how many messages."""
    return [
        f"lost: {loss.source}: {loss.kind} at {loss.where}"
        f"{'' if loss.count is None else f', {loss.count} messages'}"
        f"{f' of {loss.topic}' if loss.topic and loss.topic != loss.where else ''}"
        f"{f' ({loss.detail})' if loss.detail else ''}"
        for loss in losses
    ]


def table(rows: Sequence[Sequence[str]], *, indent: str = "  ") -> list[str]:
    """Rows as lines with columns of one width; the last column is not padded."""
    rows = [[printable(cell) for cell in row] for row in rows]
    rows = [[cell if len(cell) <= LONGEST_CELL else cell[: LONGEST_CELL - 3] + "..." for cell in row] for row in rows]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        (indent + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))).rstrip()
        for row in rows
    ]


def _groups(done: Done) -> list[str]:
    groups = done.summary.groups
    placed = {robot for members in groups.values() for robot in members}
    lines = []
    for entry in done.document["groups"]:  # type: ignore[attr-defined]
        lines.append(f"group {entry['number']} in frame {entry['frame']}: {', '.join(entry['robots'])}")
    alone = [robot.name for robot in done.mission.robots if robot.name not in placed]
    if alone:
        lines.append(f"in no group: {', '.join(alone)}")
    return lines


def _pairs(pairs: Sequence[PairSummary]) -> list[str]:
    if not pairs:
        return ["no pair of robots was looked at: none that may be joined had maps at the same time", ""]
    rows = [("a", "b", "verdict", "MAE", "overlap", "confidence", "inliers", "x m", "y m", "yaw deg", "reason")]
    for pair in pairs:
        fusion, T = pair.fusion, pair.fusion.T_target_source
        show_T = T is not None and pair.verdict == "joined"
        rows.append(
            (
                pair.a,
                pair.b,
                pair.verdict,
                "-" if fusion.mae is None else f"{fusion.mae:.1f}",
                f"{fusion.overlap_ratio:.2f}",
                f"{fusion.confidence:.3f}",
                str(fusion.num_inliers),
                f"{T.x_m + 0.0:.2f}" if T is not None and show_T else "-",
                f"{T.y_m:.2f}" if T is not None and show_T else "-",
                f"{math.degrees(T.yaw_rad):.1f}" if T is not None and show_T else "-",
                pair.reason,
            )
        )
    return [*table(rows), ""]


def _advice(done: Done) -> list[str]:
    """What came closest and what to try, where nothing was joined."""
    if done.summary.groups:
        return []
    miss = done.summary.nearest_miss
    nearest = "" if miss is None else f"; {miss.a} and {miss.b} came closest: {miss.reason}"
    return [
        f"nothing was joined{nearest}",
        "try: maps that share more of the place (at least a few rooms seen by both), `mapfusion info` to see whether "
        "the right map topics are used, --align-start for recordings of different times",
    ]


def _missing_poses(done: Done) -> list[str]:
    lines = []
    for robot in done.mission.robots:
        outcome = done.summary.robots.get(robot.name)
        if outcome is None or not outcome.num_missing_poses:
            continue
        why = robot.poses.origin if robot.poses.source is None else f"{robot.poses.origin} does not reach there"
        if outcome.num_missing_poses > 1 or robot.poses.source is None:  # the last stamp is always some other robot's
            lines.append(f"no pose of {robot.name} in {outcome.num_missing_poses} snapshots: {why}")
    return lines


def _unverifiable(done: Done) -> list[str]:
    names = [survey.recording.path.name for survey in done.mission.surveys if not survey.recording.integrity_verifiable]
    return [f"integrity not verifiable (no checksums inside): {', '.join(names)}"] if names else []
