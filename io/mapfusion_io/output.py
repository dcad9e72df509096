"""A fused mission as one MCAP."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

from mapfusion.errors import LogWriteError
from mapfusion.grid import OccupancyGrid
from mapfusion.steps import FusionStep
from mapfusion.summary import Summary
from mapfusion.transform import SE2
from mapfusion.version import __version__
from mapfusion_io import encode
from mapfusion_io.atomic import AtomicFile
from mapfusion_io.attachments import map_yaml, summary_json, trinary_pgm
from mapfusion_io.encode import Encoder
from mapfusion_io.input_copy import InputCopy
from mapfusion_io.mission_summary import steps_document
from mapfusion_io.pair_report import groups_status, pair_status
from mapfusion_io.topic_names import DIAGNOSTICS_TOPIC, TF_TOPIC, group_name, topic_names
from mapfusion_io.topic_writer import LATCHED, STREAMED, Compression, OutgoingMessage, TopicWriter


class MissionWriter:
    """Writes the steps of a mission and, at its end, a summary.

    The file stands under its name when the `with` block was left without an exception after `finish`; otherwise
    nothing does.

    Args:
        path: The output.
        world_frame: Frame of group 1; group k has `_k` after it.
        compression: Of the chunks.
        force: Replace a file that already has the name.
        inputs: Copies of the recordings' channels that are to stand beside the results.

    Raises:
        LogWriteError: The output cannot be written.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        world_frame: str = "world",
        compression: Compression = "zstd",
        force: bool = False,
        inputs: InputCopy | None = None,
    ) -> None:
        self._file = AtomicFile(Path(path), force=force)
        self._topics: Mapping[str, str] = {}
        self._world_frame = world_frame
        self._compression: Compression = compression
        self._inputs = inputs
        self._encoder = Encoder()
        self._types = {name: self._encoder.message_type(name) for name in encode.TYPES}
        self._last_map: OccupancyGrid | None = None
        self._log_time_ns = 0
        self._summary = Summary()
        self._shown: set[str] = set()
        self._finished = False

    def __enter__(self) -> Self:
        self._file.__enter__()
        try:
            self._out = TopicWriter(self._file, self._compression)
        except BaseException:
            self._file.discard()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None and self._finished:
            self._file.commit()
        else:
            self._file.discard()

    def write(self, step: FusionStep) -> None:
        """Appends a snapshot's results, and before them what the recordings held up to its time.

        Raises:
            LogReadError: A recording that is copied cannot be read.
            LogWriteError: The output cannot be written, or the snapshot's time lies outside what its format holds.
        """
        self._log_time_ns = step.stamp_ns
        if not (0 <= self._log_time_ns < 2**63 and -(2**31) <= step.stamp_ns // 10**9 < 2**31):
            raise LogWriteError(f"a snapshot at {step.stamp_ns / 1e9} s cannot be written: ROS times end in 2038")
        self._topics = topic_names(step.map_frames)
        self._summary.add(step)
        self._copy_inputs(self._log_time_ns)
        self._write_transforms(step)  # before what needs them
        self._write_maps(step)
        self._write_poses(step)
        self._write_pairs(step)
        self._write_paths(step)

    def copy_rest(self) -> None:
        """Copies what the recordings hold after the last snapshot. From here on their losses are known."""
        self._copy_inputs(None)

    def finish(self, summary: Mapping[str, object] | None = None, metadata: Mapping[str, str] | None = None) -> None:
        """Completes the content, with `summary` as the attachment summary.json and `metadata` as the record mapfusion.

        Without them the summary is that of the steps, and the record tells the version.

        Raises:
            LogReadError: A recording that is copied cannot be read.
            LogWriteError: The output cannot be written.
        """
        self.copy_rest()
        if self._last_map is not None:
            self._out.attach("map.pgm", "image/x-portable-graymap", trinary_pgm(self._last_map), self._log_time_ns)
            self._out.attach("map.yaml", "application/yaml", map_yaml(self._last_map, "map.pgm"), self._log_time_ns)
        content = steps_document(self._summary, self._world_frame) if summary is None else summary
        self._out.attach("summary.json", "application/json", summary_json(content), self._log_time_ns)
        self._out.add_metadata("mapfusion", metadata or {"version": __version__})
        self._out.finish()
        self._finished = True

    def _write_transforms(self, step: FusionStep) -> None:
        transforms = [
            (self._frame(placement.group), step.map_frames[robot], placement.T_group_map)
            for robot, placement in step.placements.items()
        ]
        if transforms:
            self._put(TF_TOPIC, encode.TF_MESSAGE, self._encoder.transforms(transforms, step.stamp_ns), STREAMED)

    def _write_maps(self, step: FusionStep) -> None:
        for group, grid in sorted(step.maps.items()):
            data = self._encoder.occupancy_grid(grid, self._frame(group), step.stamp_ns)
            self._put(f"{group_name('/fused', group)}/map", encode.OCCUPANCY_GRID, data, LATCHED)
        self._last_map = step.maps.get(1, self._last_map)

    def _write_poses(self, step: FusionStep) -> None:
        for robot, pose in step.poses.items():
            self._write_pose(step, robot, pose, step.stamp_ns)
        for robot, path in step.paths.items():
            if f"{self._root(step, robot)}/pose" not in self._shown:  # joined after its last pose
                self._write_pose(step, robot, SE2(*path.poses[-1].tolist()), int(path.stamps_ns[-1]))

    def _write_pose(self, step: FusionStep, robot: str, pose: SE2, stamp_ns: int) -> None:
        topic = f"{self._root(step, robot)}/pose"
        data = self._encoder.pose(pose, self._frame(step.placements[robot].group), stamp_ns)
        self._put(topic, encode.POSE_STAMPED, data, STREAMED)
        self._shown.add(topic)

    def _write_pairs(self, step: FusionStep) -> None:
        statuses = [pair_status(report) for report in step.pairs]
        if step.changes:
            statuses.append(groups_status(step))
        if statuses:
            data = self._encoder.diagnostics(statuses, step.stamp_ns)
            self._put(DIAGNOSTICS_TOPIC, encode.DIAGNOSTIC_ARRAY, data, STREAMED)
        for report in step.pairs:
            topic = f"/fused/pairs/{self._topics[report.a]}/{self._topics[report.b]}"
            data = self._encoder.pair(report, step.map_frames[report.a], step.stamp_ns)
            self._put(topic, encode.PAIR_FUSION, data, STREAMED)

    def _write_paths(self, step: FusionStep) -> None:
        for robot, path in step.paths.items():
            data = self._encoder.path(path, self._frame(step.placements[robot].group), step.stamp_ns)
            self._put(f"{self._root(step, robot)}/path", encode.PATH, data, LATCHED)

    def _copy_inputs(self, until_ns: int | None) -> None:
        for message in self._inputs.until(until_ns) if self._inputs else ():
            self._out.write(message)

    def _put(self, topic: str, type_name: str, data: bytes, qos: str) -> None:
        time_ns = self._log_time_ns
        self._out.write(OutgoingMessage(topic, self._types[type_name], qos, data, time_ns, time_ns))

    def _frame(self, group: int) -> str:
        return group_name(self._world_frame, group)

    def _root(self, step: FusionStep, robot: str) -> str:
        return f"{group_name('/fused', step.placements[robot].group)}/{self._topics[robot]}"


create_output = MissionWriter
"""The name under which other programs know it."""
