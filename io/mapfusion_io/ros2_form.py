"""What a recorded channel looks like in a ROS 2 recording: its type, and its messages as CDR."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from rosbags.interfaces.typing import Fielddefs
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_typestore
from rosbags.typesys.store import Typestore

from mapfusion_io.definitions import DefinitionError, default_store, store_from
from mapfusion_io.encode import MessageType
from mapfusion_io.frame_edits import FrameEdits
from mapfusion_io.interfaces import Channel

_RENAMED_TYPES = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
"""Types of ROS 1 that ROS 2 has under another name, fields alike."""

_HEADER = "std_msgs/msg/Header"
_MESSAGE_ERRORS = (SerdeError, struct.error, ValueError, IndexError, OverflowError, MemoryError, AssertionError)
_LANGUAGES = ("ros1msg", "ros2msg", "ros2idl", "")


class NoRos2FormError(Exception):
    """A channel or a message that cannot stand in a ROS 2 recording. Its text is the reason."""


@dataclass(frozen=True, slots=True, eq=False)
class Ros2Form:
    """A channel in a ROS 2 recording.

    Attributes:
        kind: The type; its definition is the recorded one, where that is ROS 2's.
        recorded_as_ros1: Whether its messages are still to be brought from ROS 1's serialisation to CDR.
        store: Knows the type and all types within, and no others but times and durations.
    """

    kind: MessageType
    recorded_as_ros1: bool
    store: Typestore

    def cdr(self, data: bytes | memoryview, edits: FrameEdits | None) -> bytes | memoryview:
        """The message as CDR, edited; CDR in which nothing changes is given back as it is.

        Raises:
            NoRos2FormError: The message does not fit its type.
        """
        name = self.kind.name
        try:
            cdr = self.store.ros1_to_cdr(data, name) if self.recorded_as_ros1 else data
            if edits is None:
                return cdr
            message = self.store.deserialize_cdr(cdr, name)
            return self.store.serialize_cdr(message, name) if edits.apply(message, name) else cdr
        except _MESSAGE_ERRORS as error:
            raise NoRos2FormError("malformed message") from error

    def fields(self) -> dict[str, Fielddefs]:
        """The fields of the type and of all types within, by type name."""
        return {name: fields for name, (_, fields) in self.store.fielddefs.items()}


def ros2_form(channel: Channel) -> Ros2Form:
    """The form of a channel recorded in CDR, or in ROS 1's serialisation.

    A channel without a definition (rosbag2 wrote none before ROS 2 Iron) has Humble's, or Noetic's for ROS 1.

    Raises:
        NoRos2FormError: It has no such form.
    """
    name = _RENAMED_TYPES.get(channel.schema_name, channel.schema_name)
    as_ros1 = channel.message_encoding == "ros1"
    if not as_ros1 and channel.message_encoding != "cdr":
        raise NoRos2FormError(f"messages in {channel.message_encoding or 'no known encoding'}")
    if channel.schema_encoding not in _LANGUAGES:
        raise NoRos2FormError(f"definition in {channel.schema_encoding}")
    try:
        store = _recorded_store(channel)
        encoding, definition = channel.schema_encoding, channel.schema_data
        if as_ros1:
            store = _ros2_store(store, channel.schema_name, name)
        if as_ros1 or not definition:
            encoding, definition = "ros2msg", store.generate_msgdef(name, ros_version=2)[0].encode()
        kind = MessageType(name, encoding, definition, store.hash_rihs01(name))
    except (DefinitionError, TypesysError, KeyError) as error:
        raise NoRos2FormError("no usable definition of the type") from error
    return Ros2Form(kind, as_ros1, store)


def _recorded_store(channel: Channel) -> Typestore:
    """The channel's type and all types within, as recorded or else as the ROS release that wrote no definitions."""
    if channel.schema_data:
        return store_from(channel.schema_name, channel.schema_encoding, channel.schema_data)
    text, _ = default_store(channel.message_encoding).generate_msgdef(channel.schema_name, ros_version=2)
    return store_from(channel.schema_name, "ros2msg", text.encode())


def _ros2_store(ros1: Typestore, recorded_name: str, name: str) -> Typestore:
    """ROS 1's types with ROS 2's header, which has no `seq`, and with its lower case field names."""
    store = get_typestore(Stores.EMPTY)
    types = {
        (name if within == recorded_name else within): (constants, [(field.lower(), kind) for field, kind in fields])
        for within, (constants, fields) in ros1.fielddefs.items()
        if within not in store.fielddefs
    }
    if _HEADER in types:
        types[_HEADER] = default_store("cdr").fielddefs[_HEADER]
    store.register(types)
    return store
