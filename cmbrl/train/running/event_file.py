"""A run's metrics for TensorBoard: an event file, written row by row.

TensorBoard's own writer has a thread, which prints a traceback when the disk is full and does not survive a fork.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any


class EventFile:
    """A new event file in ``folder``; TensorBoard forgets what earlier files there say of ``purge_step`` and later.

    Needs tensorboard. Raises OSError where the disk does.
    """

    def __init__(self, folder: Path, purge_step: int | None = None) -> None:
        from tensorboard.compat.proto import event_pb2, summary_pb2
        from tensorboard.summary.writer.record_writer import RecordWriter

        self._event, self._summary = event_pb2.Event, summary_pb2.Summary
        start = time.time()
        name = f"events.out.tfevents.{int(start):010d}.{socket.gethostname()}.{os.getpid()}.{time.monotonic_ns()}"
        self._file = (folder / name).open("xb", buffering=0)
        self._writer = RecordWriter(self._file)  # type: ignore[no-untyped-call]
        self._add(file_version="brain.Event:2")
        if purge_step is not None:
            self._add(step=purge_step, session_log=event_pb2.SessionLog(status=event_pb2.SessionLog.START))

    def add(self, step: int, scalars: Mapping[str, float]) -> None:
        """Writes ``scalars`` of one step."""
        values = [self._summary.Value(tag=name, simple_value=value) for name, value in scalars.items()]
        self._add(step=step, summary=self._summary(value=values))

    def close(self) -> None:
        self._file.close()

    def _add(self, **content: Any) -> None:
        event = self._event(wall_time=time.time(), **content)
        self._writer.write(event.SerializeToString())  # type: ignore[no-untyped-call]
