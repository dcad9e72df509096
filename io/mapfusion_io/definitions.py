"""Message definitions that recordings carry, as typestores of rosbags.

rosbags turns a definition into Python source and runs it. So nothing of a definition goes there before it is known to
be made of plain identifiers and bounded sizes.
"""

from __future__ import annotations

import re
from functools import lru_cache

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import BaseDesc, FieldDesc, NameDesc, Typesdict
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

MAX_DEFINITION_BYTES = 2**20
MAX_FIXED_ELEMENTS = 4096
"""Longest array of fixed length whose elements are not plain numbers: rosbags writes a line of source for each."""
MAX_DEPTH = 32
MAX_DEFINITIONS = 64
"""Most different definitions of a recording that are parsed: each takes some ten milliseconds and 200 kB."""

_SECTION = "=" * 80 + "\n"
_TYPE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)+", re.ASCII)
_FIELD_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
_BASE_BYTES = {
    **dict.fromkeys(("bool", "byte", "char", "int8", "uint8"), 1),
    **dict.fromkeys(("int16", "uint16"), 2),
    **dict.fromkeys(("int32", "uint32", "float32", "string"), 4),
    **dict.fromkeys(("int64", "uint64", "float64"), 8),
}

_GRID_UPDATE = "std_msgs/Header header\nint32 x\nint32 y\nuint32 width\nuint32 height\nint8[] data\n"
_TF_MESSAGE = "geometry_msgs/TransformStamped[] transforms\n"


class DefinitionError(ValueError):
    """A definition that cannot be used, in words."""


@lru_cache(maxsize=MAX_DEFINITIONS)
def store_from(schema_name: str, schema_encoding: str, schema_data: bytes) -> Typestore:
    """A store with one definition and the types in it; not to be changed, since equal definitions share it.

    Args:
        schema_name: Type name in three parts.
        schema_encoding: `ros2msg`, `ros2idl` or `ros1msg`.
        schema_data: The text, with the types it needs behind it.

    Raises:
        DefinitionError: It cannot be parsed, is not whole, or asks for too much.
    """
    if len(schema_data) > MAX_DEFINITION_BYTES:
        raise DefinitionError(f"a definition of {len(schema_data)} bytes")
    try:
        text = schema_data.decode().replace("\r\n", "\n")
        types = _idl_types(text) if schema_encoding == "ros2idl" else get_types_from_msg(text, schema_name)
        store = get_typestore(Stores.EMPTY)
        known = {**store.fielddefs, **types}
        for name, (constants, fields) in types.items():
            for identifier in [*(item[0] for item in fields), *(item[0] for item in constants)]:
                _require(bool(_FIELD_NAME.fullmatch(identifier)), f"a field named {identifier!r}")
            _require(bool(_TYPE_NAME.fullmatch(name)), f"a type named {name!r}")
        _require(schema_name in types, f"no type {schema_name}")
        _least_bytes(schema_name, known, (), {})
        needed = _needed(schema_name, known)
        store.register({name: types[name] for name in types if name in needed})
        store.get_msgdef(schema_name)
    except DefinitionError:
        raise
    except (TypesysError, SyntaxError, ValueError, KeyError, TypeError, NameError, AssertionError, RecursionError) as e:
        raise DefinitionError(f"it cannot be parsed ({type(e).__name__})") from e
    return store


@lru_cache(maxsize=2)
def default_store(message_encoding: str) -> Typestore:
    """The types of ROS 1 Noetic for `ros1`, else of ROS 2 Humble, and what mapping needs beyond them.

    The layouts of these messages are the same in every ROS 2 release so far.
    """
    store = get_typestore(Stores.ROS1_NOETIC if message_encoding == "ros1" else Stores.ROS2_HUMBLE)
    for name, text in (
        ("map_msgs/msg/OccupancyGridUpdate", _GRID_UPDATE),
        ("tf/msg/tfMessage", _TF_MESSAGE),
        ("tf2_msgs/msg/TFMessage", _TF_MESSAGE),
    ):
        if name not in store.fielddefs:
            store.register(get_types_from_msg(text, name))
    return store


def _idl_types(text: str) -> Typesdict:
    """IDL as rosbag2 stores it: one file, or several behind each other with a line `IDL: name` in front of each."""
    if not text.startswith(f"{_SECTION}IDL: "):
        return get_types_from_idl(text)
    types: Typesdict = {}
    for section in text.split(_SECTION)[1:]:
        types.update(get_types_from_idl(section.partition("\n")[2]))
    return types


def _least_bytes(name: str, types: Typesdict, above: tuple[str, ...], done: dict[str, int]) -> int:
    """Fewest bytes that a message of a type takes.

    Raises:
        DefinitionError: A type is missing, contains itself, has a list of things that take no bytes (its length could
            be anything), or an array that is too long.
    """
    if name in done:
        return done[name]
    _require(name in types, f"no type {name}")
    _require(name not in above and len(above) < MAX_DEPTH, f"{name} contains itself or is nested too deep")
    total = 0
    for field, desc in types[name][1]:
        inner, num = _element(desc)
        if inner[0] == Nodetype.BASE:
            _require(inner[1][0] in _BASE_BYTES, f"field {field} of type {inner[1][0]!r}")
            size = _BASE_BYTES[inner[1][0]]
        else:
            size = _least_bytes(inner[1], types, (*above, name), done)
        if desc[0] == Nodetype.SEQUENCE:
            _require(size > 0 and num >= 0, f"field {field} is a list of nothing")
            size = 4
        elif desc[0] == Nodetype.ARRAY:
            plain = inner[0] == Nodetype.BASE and inner[1][0] != "string"
            limit = MAX_DEFINITION_BYTES if plain else MAX_FIXED_ELEMENTS
            _require(0 <= num <= limit, f"field {field} has {num} elements")
            size *= num
        total += size
    _require(total <= 2**30, f"{name} takes {total} bytes")
    done[name] = total
    return total


def _element(desc: FieldDesc) -> tuple[BaseDesc | NameDesc, int]:
    """What a field holds one or several of, and how many by its definition."""
    if desc[0] == Nodetype.ARRAY or desc[0] == Nodetype.SEQUENCE:
        return desc[1]
    return desc, 1


def _needed(name: str, types: Typesdict) -> set[str]:
    """The type and all that it is made of."""
    found, queue = {name}, [name]
    for current in queue:  # grows while it is walked
        for _, desc in types[current][1]:
            inner, _ = _element(desc)
            if inner[0] == Nodetype.NAME and inner[1] not in found:
                found.add(inner[1])
                queue.append(inner[1])
    return found


def _require(holds: bool, otherwise: str) -> None:
    if not holds:
        raise DefinitionError(otherwise)
