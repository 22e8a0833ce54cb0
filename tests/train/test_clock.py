"""The time of a run in parts."""

from __future__ import annotations

import time

import pytest

from cmbrl.train.running.clock import RunClock


def test_a_run_that_is_continued_counts_what_its_parts_took_and_not_what_lay_between(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wall, processor = 5.0, 2.0
    monkeypatch.setattr(time, "monotonic", lambda: wall)
    monkeypatch.setattr(time, "process_time", lambda: processor)
    clock = RunClock(seconds=100.0, processor_seconds=70.0)
    wall, processor = 8.0, 3.0
    clock.go_on()
    wall, processor = 12.0, 3.5
    assert clock.read() == clock.told() == {"seconds": 104.0, "processor_seconds": 70.5}
    assert (clock.seconds, clock.processor_seconds) == (104.0, 70.5)


def test_waiting_takes_no_processor_time() -> None:
    clock = RunClock()
    time.sleep(0.2)
    told = clock.read()
    assert told["processor_seconds"] < 0.15 < 0.2 <= told["seconds"]
