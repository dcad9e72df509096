"""An iterator that runs ahead of its reader in a thread of its own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from threading import Thread
from typing import TypeVar

ItemT = TypeVar("ItemT")

PATIENCE_S = 0.5
"""So long a thread whose items are no longer wanted is waited for; one that is at a long item is left to end alone."""


@contextmanager
def ahead(items: Iterator[ItemT], depth: int) -> Iterator[Iterator[ItemT]]:
    """The same items in the same order, up to `depth` of them made before they are asked for.

    `items` is used, and closed, in the thread alone. What it raises is raised where its next item would have come.
    """
    # Simple queues hold no lock that an exception from a signal's handler could leave taken.
    made: SimpleQueue[tuple[ItemT] | BaseException | None] = SimpleQueue()
    places: SimpleQueue[None] = SimpleQueue()
    for _ in range(depth):
        places.put(None)
    is_wanted = True

    def run() -> None:
        try:
            for item in items:
                places.get()
                if not is_wanted:
                    break
                made.put((item,))
        except BaseException as error:  # whatever it is, it is the reader's to handle
            made.put(error)
        else:
            made.put(None)
        finally:
            close = getattr(items, "close", None)
            if close is not None:
                close()

    def taken() -> Iterator[ItemT]:
        while (item := made.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            places.put(None)
            yield item[0]

    thread = Thread(target=run, name="ahead", daemon=True)
    thread.start()
    try:
        yield taken()
    finally:
        is_wanted = False
        places.put(None)
        thread.join(PATIENCE_S)
