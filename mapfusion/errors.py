"""What goes wrong, by whose fault it is.

A caller's mistake in Python is a `ValueError`. A bad recording, configuration or output is one of the exceptions
below. Maps that do not align are neither: they are an ordinary result with a reason.
"""


class MapfusionError(Exception):
    """Root of everything that mapfusion raises on purpose. Its text is one or two lines for the user."""


class ConfigError(MapfusionError):
    """An option or a configuration file asks for something impossible."""


class LogReadError(MapfusionError):
    """A recording cannot be read. The text names the file, where in it, what is wrong and what to do."""


class MalformedMessageError(LogReadError):
    """A message cannot be decoded, or says what cannot be.

    Attributes:
        topic: Topic of the message, empty where the raiser was given the decoded message only.
        log_time_ns: When it was recorded, nanoseconds since the epoch; 0 where that is not known.
        reason: What is wrong with it, in words.
    """

    def __init__(self, topic: str, log_time_ns: int, reason: str) -> None:
        super().__init__(f"{topic!r} at {log_time_ns} ns: {reason}" if topic else reason)
        self.topic = topic
        self.log_time_ns = log_time_ns
        self.reason = reason


class LogWriteError(MapfusionError):
    """The output cannot be written. Nothing stands under its name."""


class MissionError(MapfusionError):
    """The recordings can be read, but hold no mission to fuse: no map, or one robot only."""
