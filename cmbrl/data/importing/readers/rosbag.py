"""Reader of ROS bags: folders of rosbag2, and single .mcap, .db3 and .bag files."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.data.importing.readers import trajectories
from cmbrl.data.importing.readers.ros_messages import FRAMES, PLANS, READERS, frames
from cmbrl.data.importing.recording import Recording, Table, need
from cmbrl.errors import UserError
from cmbrl.text import shortened

_GAINS = re.compile(r".*\.(?P<gain>kp|kd)\.(?P<joint>.+)")  #: columns of gains, by joint
_AHEAD = re.compile(r"motor_cmd\.tau\b")  #: columns of torques ahead of a servo, which count where they are not all 0
LATE = 3600.0  #: [s] a header's stamp further away from the time of recording is no stamp
_KNOWN = {*READERS, FRAMES}
_OF_ROS = ("/rosout", "/parameter_events", "/robot_description", "/diagnostics")  #: topics that tell nothing of motion

Rows = list[tuple[float, dict[str, float]]]


def read_rosbag(path: Path, joints: tuple[str, ...]) -> list[Recording]:
    """Each topic of a known type is a table: joints, trajectories, numbers and arrays of them, poses, odometry, IMU.

    Columns are called TOPIC.QUANTITY.JOINT; times are the headers' stamps, else those of recording. Gains that commands
    bring are constants, NaN where they change.
    """
    highlevel = need("rosbags.highlevel", path)
    typesys = need("rosbags.typesys", path)
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    samples: dict[str, Rows] = {}
    plans: dict[str, list[trajectories.Plan]] = {}
    try:
        with highlevel.AnyReader([path], default_typestore=store) as reader:
            known = [one for one in reader.connections if one.msgtype in _KNOWN and _defined(reader, one.msgtype)]
            for connection, nanoseconds, raw in reader.messages(connections=known) if known else ():
                message = reader.deserialize(raw, connection.msgtype)
                topic = connection.topic.strip("/").replace("/", ".")
                for time, values in _read(message, connection.msgtype, nanoseconds * 1e-9, joints):
                    samples.setdefault(topic, []).append((time, dict(values)))
                    if connection.msgtype == PLANS and (plan := trajectories.Plan.of(message, time)):
                        plans.setdefault(topic, []).append(plan)
            topics = sorted(f"{one.topic} ({one.msgtype})" for one in reader.connections)
    except Exception as error:  # the library raises kinds of its own for each storage, and struct and database errors
        raise UserError(f"{path}: not readable as a ROS bag ({shortened(repr(error), 200)})") from None
    for topic, own in plans.items():
        if not trajectories.streamed(own):
            told = trajectories.followed(sorted(own, key=lambda plan: plan.start))
            samples[topic] = [(time, {f"command.{name}": x for name, x in row.items()}) for time, row in told]
    tables = tuple(table for topic, rows in samples.items() for table in _tables(topic, rows))
    if not tables:
        told_types = ", ".join(sorted(_KNOWN))
        lost = [name for name in topics if any(f"({kind})" in name for kind in _KNOWN)]
        has = ", ".join(topics) or "none"
        if lost:
            has += ", whose types it does not define: convert it to MCAP by `ros2 bag convert` where they are installed"
        raise UserError(f"{path}: no topic of a known type; it has {has}; known: {told_types}")
    gains = dict(_gains(tables))
    left = [{name: x for name, x in table.columns.items() if not _GAINS.fullmatch(name)} for table in tables]
    found = tuple(Table(x, table.time) for x, table in zip(left, tables, strict=True))
    return [Recording(str(path), found, gains, unread=_unread(topics))]


def _unread(topics: Iterable[str]) -> tuple[str, ...]:
    """Topics, with their types, that may tell of the robot and are of no known type."""
    return tuple(
        name for name in topics if not name.startswith(_OF_ROS) and name.partition("(")[2].rstrip(")") not in _KNOWN
    )


def _read(
    message: Any, kind: str, recorded: float, joints: tuple[str, ...]
) -> Iterator[tuple[float, Mapping[str, float]]]:
    """Times and values of a message; the frames of one of transforms have a time each."""
    if kind != FRAMES:
        yield _stamp(message, recorded), dict(READERS[kind](message, joints))
        return
    for transform, values in frames(message):
        yield _stamp(transform, recorded), dict(values)


def _defined(reader: Any, kind: str) -> bool:
    return kind in reader.typestore.types or kind in reader.typestore.fielddefs


def _gains(tables: tuple[Table, ...]) -> Iterator[tuple[str, np.ndarray]]:
    for table in tables:
        for column, values in table.columns.items():
            if gain := _GAINS.fullmatch(column):
                held = np.ptp(values) <= 1e-6 * np.abs(values).max()
                yield f"{gain['gain']}.{gain['joint']}", np.array(values[0] if held else np.nan)


def _tables(topic: str, rows: Rows) -> Iterator[Table]:
    """A table of a topic, or one for each of the nodes that share it and tell other joints."""
    parts: dict[frozenset[str], Rows] = {}
    for time, values in rows:
        parts.setdefault(frozenset(values), []).append((time, values))
    if sum(map(len, parts)) > len(frozenset().union(*parts)):  # one node, whose messages are not all whole
        parts = {frozenset().union(*parts): rows}
    yield from (_table(topic, part) for part in parts.values() if len(part) > 1)


def _table(topic: str, rows: Rows) -> Table:
    names = list(dict.fromkeys(name for _, values in rows for name in values))
    columns = {name: np.array([values.get(name, np.nan) for _, values in rows]) for name in names}
    told = {f"{topic}.{name}": x for name, x in columns.items() if x.any() or not _AHEAD.match(name)}
    return Table(told, np.array([time for time, _ in rows]))


def _stamp(message: Any, recorded: float) -> float:
    """The time [s] in a message's header, or that of its recording."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None:
        return recorded
    told = stamp.sec + 1e-9 * stamp.nanosec
    return told if told > 0 and abs(told - recorded) < LATE else recorded
