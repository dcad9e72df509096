"""From the bytes of a message to an object, by the definition that the recording carries."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, NamedTuple

from rosbags.serde import SerdeError
from rosbags.typesys.store import Typestore

from mapfusion.errors import LogReadError, MalformedMessageError
from mapfusion_io.definitions import MAX_DEFINITIONS, DefinitionError, default_store, store_from
from mapfusion_io.interfaces import Channel, RawMessage
from mapfusion_io.read_errors import printable

__all__ = ["Decoder", "MalformedMessageError"]

_DEFINITION_ENCODINGS = frozenset({"ros2msg", "ros2idl", "ros1msg"})
_MESSAGE_ENCODINGS = frozenset({"cdr", "ros1"})
_LARGE_BYTES = 65_536


class _Type(NamedTuple):
    deserialize: Callable[[bytes | memoryview, str], object]
    name: str


class Decoder:
    """Decodes messages of any recording; what a channel's definition says is worked out once."""

    def __init__(self) -> None:
        self._types: dict[Channel, _Type | str] = {}
        self._definitions: set[tuple[str, str, bytes]] = set()
        self._replaced: dict[tuple[str, str], str] = {}

    @property
    def warnings(self) -> tuple[str, ...]:
        """Which definitions gave way to the usual ones so far, and why; one topic of each."""
        return tuple(
            f"{topic}: type {name}: {problem}; the usual one is taken"
            for (name, problem), topic in self._replaced.items()
        )

    def supported(self, channel: Channel) -> str | None:
        """Why messages of a channel cannot be decoded, in words; None where they can."""
        found = self._type_of(channel)
        return found if isinstance(found, str) else None

    def decode(self, raw: RawMessage) -> Any:
        """The message as rosbags gives it; arrays of numbers are read-only views of its bytes.

        Raises:
            MalformedMessageError: The bytes are not such a message.
            LogReadError: No message of this channel can be decoded; `supported` says why.
        """
        channel = raw.channel
        found = self._types.get(channel)
        if found is None or isinstance(found, str):
            found = self._require_type(channel)
        data = raw.data
        if len(data) > _LARGE_BYTES:
            data = memoryview(data)  # rosbags cuts off the first bytes, which would copy the rest
        try:
            return found.deserialize(data, found.name)
        except (SerdeError, struct.error, ValueError, IndexError, OverflowError, MemoryError, RecursionError) as error:
            reason = f"its bytes are no {printable(found.name)}"
            raise MalformedMessageError(channel.topic, raw.log_time_ns, reason) from error

    def _require_type(self, channel: Channel) -> _Type:
        found = self._type_of(channel)
        if isinstance(found, str):
            raise LogReadError(f"{printable(channel.topic)}: {found}")
        return found

    def _type_of(self, channel: Channel) -> _Type | str:
        """How to decode a channel's messages, or why that is not possible."""
        if channel not in self._types:
            self._types[channel] = self._find_type(channel)
        return self._types[channel]

    def _find_type(self, channel: Channel) -> _Type | str:
        """The channel's own definition comes first; one that cannot be used gives way to the usual one of its name."""
        name = printable(channel.schema_name)
        if channel.message_encoding not in _MESSAGE_ENCODINGS:
            return (
                f"messages in {printable(channel.message_encoding) or 'no'} encoding, only cdr and ros1 can be decoded"
            )
        problem = "the recording holds no definition of it"
        if channel.schema_data and channel.schema_encoding in _DEFINITION_ENCODINGS:
            try:
                store = self._store(channel)
                return _with_store(store, channel)
            except DefinitionError as error:
                problem = printable(f"its definition cannot be used: {error}")
        elif channel.schema_data:
            problem = f"its definition is in {printable(channel.schema_encoding)!r}, which is not known"
        store = default_store(channel.message_encoding)
        if channel.schema_name not in store.fielddefs:
            return f"type {name!r}: {problem}"
        if channel.schema_data:
            self._replaced.setdefault((name, problem), printable(channel.topic))
        return _with_store(store, channel)

    def _store(self, channel: Channel) -> Typestore:
        """Raises:
        DefinitionError: The definition cannot be used, or too many others were used before.
        """
        definition = channel.schema_name, channel.schema_encoding, channel.schema_data
        if definition not in self._definitions and len(self._definitions) >= MAX_DEFINITIONS:
            raise DefinitionError(f"more than {MAX_DEFINITIONS} definitions")
        self._definitions.add(definition)
        return store_from(*definition)


def _with_store(store: Typestore, channel: Channel) -> _Type:
    deserialize = store.deserialize_ros1 if channel.message_encoding == "ros1" else store.deserialize_cdr
    return _Type(deserialize, channel.schema_name)
