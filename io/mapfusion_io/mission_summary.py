"""A mission and what came of it as plain data, the same in the output, in `--json` and in tests."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from mapfusion.result import PairFusion
from mapfusion.steps import Placement
from mapfusion.summary import PairSummary, RobotSummary, Summary
from mapfusion.transform import SE2
from mapfusion_io.grid_stream import MissionRobot
from mapfusion_io.interfaces import Loss
from mapfusion_io.mission import Mission
from mapfusion_io.robots import PassedOver
from mapfusion_io.topic_names import group_name

Document = dict[str, Any]


def mission_document(mission: Mission, losses: Sequence[Loss]) -> Document:
    """What was found in the recordings: inputs, robots, what was passed over, losses, warnings."""
    return {
        "inputs": [
            {
                "name": survey.recording.path.name,
                "container": survey.recording.container,
                "size_bytes": survey.size_bytes,
                "messages": sum(topic.count for topic in survey.topics.values()),
                "integrity_verifiable": survey.recording.integrity_verifiable,
            }
            for survey in mission.surveys
        ],
        "first_stamp_ns": mission.first_ns,
        "last_stamp_ns": mission.last_ns,
        "robots": {robot.name: _robot(robot) for robot in mission.robots},
        "passed_over": [_passed_over(item) for item in mission.passed_over],
        "losses": [_loss(loss) for loss in losses],
        "warnings": list(mission.warnings),
    }


def summary_document(mission: Mission, summary: Summary, losses: Sequence[Loss], world_frame: str) -> Document:
    """The same and what the replay came to: snapshots, groups, placements, pairs."""
    document = mission_document(mission, losses)
    for name, robot in document["robots"].items():
        robot.update(_outcome(summary.robots.get(name, RobotSummary())))
    return document | steps_document(summary, world_frame)


def steps_document(summary: Summary, world_frame: str) -> Document:
    """What the steps of a replay came to, whatever they were made from."""
    return {
        "snapshots": summary.num_snapshots,
        "groups": [
            {"number": number, "frame": group_name(world_frame, number), "robots": list(members)}
            for number, members in summary.groups.items()
        ],
        "changes": [{"stamp_ns": stamp_ns, "what": what} for stamp_ns, what in summary.changes],
        "pairs": [pair_document(pair) for pair in summary.pairs_in_order],
    }


def metadata_record(
    mission: Mission, losses: Sequence[Loss], version: str, options: Mapping[str, object]
) -> dict[str, str]:
    """Content of the metadata record `mapfusion`: how the output came to be, without paths, clocks or run times."""
    document = mission_document(mission, losses)
    return {
        "version": version,
        "options": _json(options),
        "inputs": _json(document["inputs"]),
        "losses": _json(document["losses"]),
    }


def pair_document(pair: PairSummary) -> Document:
    """A pair under the names of PairFusion's fields."""
    return {
        "a": pair.a,
        "b": pair.b,
        "verdict": pair.verdict,
        "placed": pair.placed,
        "looks": pair.num_looks,
        "accepted_looks": pair.num_accepted,
        "joined_stamp_ns": pair.joined_ns,
        **fusion_document(pair.fusion),
        "reason": pair.reason,
    }


def fusion_document(fusion: PairFusion) -> Document:
    """A verdict with its evidence."""
    return {
        "accepted": fusion.accepted,
        "reason": fusion.reason,
        "gate": fusion.gate,
        "confidence": fusion.confidence,
        "mae": fusion.mae,
        "overlap_ratio": fusion.overlap_ratio,
        "overlap_cells": fusion.overlap_cells,
        "keypoints_a": fusion.num_keypoints_target,
        "keypoints_b": fusion.num_keypoints_source,
        "matches": fusion.num_matches,
        "inliers": fusion.num_inliers,
        "scale": fusion.scale,
        "T_a_b": _pose(fusion.T_target_source),
        "rival_T_a_b": _pose(fusion.rival),
        "covariance": None if fusion.covariance is None else fusion.covariance.ravel().tolist(),
        "resolution_m": round(fusion.resolution_m, 9),
        "evidence": dict(fusion.evidence),
    }


def _robot(robot: MissionRobot) -> Document:
    grids = robot.found.topic
    last = grids.last_grid
    return {
        "recording": robot.found.survey.recording.path.name,
        "map_topic": grids.topic,
        "map_frame": robot.found.map_frame,
        "maps": len(grids.stamps_ns),
        "map_updates": 0 if robot.updates is None else len(robot.updates.stamps_ns),
        "duplicate_stamps": len(grids.stamps_ns) - len(set(grids.stamps_ns)),
        "zero_stamps": grids.num_zero_stamps,
        "last_map": None
        if last is None
        else {"width": last.width, "height": last.height, "resolution_m": round(last.resolution_m, 9)},
        "pose_source": robot.poses.origin if robot.poses.source is not None else None,
        "no_pose_because": None if robot.poses.source is not None else robot.poses.origin,
    }


def _outcome(robot: RobotSummary) -> Document:
    placement: Placement | None = robot.placement
    return {
        "group": None if placement is None else placement.group,
        "T_group_map": None if placement is None else _pose(placement.T_group_map),
        "poses": robot.num_poses,
        "missing_poses": robot.num_missing_poses,
    }


def _pose(pose: SE2 | None) -> Document | None:
    if pose is None:
        return None
    return {"x_m": pose.x_m, "y_m": pose.y_m, "yaw_deg": math.degrees(pose.yaw_rad)}


def _passed_over(item: PassedOver) -> Document:
    return {
        "recording": item.source,
        "topic": item.topic,
        "type": item.schema_name,
        "messages": item.count,
        "reason": item.reason,
    }


def _loss(loss: Loss) -> Document:
    return {
        "recording": loss.source,
        "kind": loss.kind,
        "where": loss.where,
        "topic": loss.topic,
        "messages": loss.count,
        "detail": loss.detail,
    }


def _json(value: object) -> str:
    return json.dumps(value, sort_keys=True, allow_nan=False)
