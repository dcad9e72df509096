"""An iterator that runs ahead of its reader in a thread of its own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from queue import Full, Queue
from threading import Event, Thread
from typing import TypeVar

ItemT = TypeVar("ItemT")

_WAIT_S = 0.1
"""How soon a thread whose items are no longer wanted notices it."""


@contextmanager
def ahead(items: Iterator[ItemT], depth: int) -> Iterator[Iterator[ItemT]]:
    """The same items in the same order, up to `depth` of them made before they are asked for.

    `items` is used, and closed, in the thread alone. What it raises is raised where its next item would have come.
    When the context ends, the thread has ended as well.
    """
    made: Queue[tuple[ItemT] | BaseException | None] = Queue(depth)
    unwanted = Event()

    def put(item: tuple[ItemT] | BaseException | None) -> None:
        while not unwanted.is_set():
            with suppress(Full):
                made.put(item, timeout=_WAIT_S)
                break

    def run() -> None:
        try:
            for item in items:
                put((item,))
                if unwanted.is_set():
                    break
        except BaseException as error:  # whatever it is, it is the reader's to handle
            put(error)
        else:
            put(None)
        finally:
            close = getattr(items, "close", None)
            if close is not None:
                close()

    def taken() -> Iterator[ItemT]:
        while (item := made.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            yield item[0]

    thread = Thread(target=run, name="ahead", daemon=True)
    thread.start()
    try:
        yield taken()
    finally:
        unwanted.set()
        thread.join()
