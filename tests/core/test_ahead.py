import threading
import time
from collections.abc import Iterator

import pytest

from mapfusion.ahead import PATIENCE_S, ahead


def test_items_come_in_order_and_the_thread_ends() -> None:
    with ahead(iter(range(50)), 3) as items:
        assert list(items) == list(range(50))
    assert not [thread for thread in threading.enumerate() if thread.name == "ahead"]


def test_no_more_is_made_ahead_than_was_asked_for() -> None:
    made, enough = [], threading.Event()

    def numbers() -> Iterator[int]:
        for number in range(100):
            made.append(number)
            if number == 4:
                enough.set()
            yield number

    with ahead(numbers(), 3) as items:
        assert next(items) == 0
        assert enough.wait(60.0)  # one taken, three waiting, one that finds no place
        assert made == [0, 1, 2, 3, 4]


def test_an_error_comes_where_its_item_would_have_come() -> None:
    def broken() -> Iterator[int]:
        yield 1
        raise ValueError("no second")

    with ahead(broken(), 3) as items:
        assert next(items) == 1
        with pytest.raises(ValueError, match="no second"):
            next(items)


def test_what_is_not_wanted_any_more_is_closed_in_its_own_thread() -> None:
    closed_by = []

    def endless() -> Iterator[int]:
        try:
            while True:
                yield 0
        finally:
            closed_by.append(threading.current_thread().name)

    with ahead(endless(), 2) as items:
        next(items)
    assert closed_by == ["ahead"]


def test_a_thread_that_is_at_a_long_item_is_not_waited_for() -> None:
    may_end = threading.Event()

    def slow() -> Iterator[int]:
        yield 0
        may_end.wait(60.0)

    with ahead(slow(), 1) as items:
        next(items)
        left_s = time.perf_counter()
    assert time.perf_counter() - left_s < PATIENCE_S + 30.0
    may_end.set()
