"""Other frame names and other stamps in any ROS 2 message."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys.base import normalize_fieldname
from rosbags.typesys.store import Typestore

FrameNames = Callable[[str], str]
"""The new name of a frame, given its old name without a leading slash."""

_HEADER, _TRANSFORMS = "std_msgs/msg/Header", "tf2_msgs/msg/TFMessage"
_FRAME_FIELDS = ("frame_id", "child_frame_id")

_Plan = tuple[tuple[str, str, bool], ...]


class FrameEdits:
    """Renames the frames of messages and shifts their header stamps, in place.

    Frames are the text fields named `frame_id` and `child_frame_id`, wherever they stand in a message. Empty frames
    and stamps of zero mean something else and stay. A frame has one parent: transforms to others may be cut off.

    Args:
        store: Knows the types of the messages.
        rename: New names of frames; a leading slash, which ROS 2 does not have, is dropped before and for good.
        shift_ns: Added to the stamps.
        hung: New names of frames that have a parent already: transforms that give them another one are cut off.

    Attributes:
        num_cut: Messages of which transforms were cut off so far.
        num_emptied: Those of them of which nothing is left.
    """

    def __init__(self, store: Typestore, rename: FrameNames, shift_ns: int, hung: frozenset[str] = frozenset()) -> None:
        self._store = store
        self._rename = rename
        self._shift_ns = shift_ns
        self._hung = hung
        self.num_cut = self.num_emptied = 0
        self._plans: dict[str, _Plan] = {}

    def apply(self, message: Any, type_name: str) -> bool:
        """Edits a deserialised message and tells whether that changed anything."""
        changed = type_name == _HEADER and self._shift(message.stamp)
        for field, nested, is_many in self._plan(type_name):
            value = getattr(message, field)
            if not nested:
                changed |= self._rename_field(message, field, value)
            else:
                for part in value if is_many else (value,):
                    changed |= self.apply(part, nested)
        return self._cut(message) or changed if type_name == _TRANSFORMS and self._hung else changed

    def _cut(self, message: Any) -> bool:
        kept = [transform for transform in message.transforms if transform.child_frame_id not in self._hung]
        is_cut = len(kept) < len(message.transforms)
        self.num_cut += is_cut
        self.num_emptied += is_cut and not kept
        message.transforms = kept
        return is_cut

    def _rename_field(self, message: Any, field: str, frame: str) -> bool:
        if not frame:
            return False
        renamed = self._rename(frame.lstrip("/"))
        setattr(message, field, renamed)
        return renamed != frame

    def _shift(self, stamp: Any) -> bool:
        if not self._shift_ns or not (stamp.sec or stamp.nanosec):
            return False
        stamp.sec, stamp.nanosec = divmod(stamp.sec * 10**9 + stamp.nanosec + self._shift_ns, 10**9)
        return True

    def _plan(self, type_name: str) -> _Plan:
        """What there is to do in a type: (field, its message type or '' for a frame name, whether it is an array)."""
        if type_name not in self._plans:
            self._plans[type_name] = tuple(self._fields(type_name))
        return self._plans[type_name]

    def _fields(self, type_name: str) -> list[tuple[str, str, bool]]:
        found = []
        for name, desc in self._store.fielddefs[type_name][1]:
            inner = desc[1][0] if desc[0] == Nodetype.ARRAY or desc[0] == Nodetype.SEQUENCE else desc
            is_many = inner is not desc
            field = normalize_fieldname(name)
            if inner[0] == Nodetype.NAME:
                if self._plan(inner[1]):
                    found.append((field, inner[1], is_many))
            elif name in _FRAME_FIELDS and inner[1][0] == "string" and not is_many:
                found.append((field, "", False))
        return found
