"""Reader of ROS bags: folders of rosbag2, and single .mcap, .db3 and .bag files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.data.importing.recording import Recording, Table, need
from cmbrl.data.importing.ros_messages import READERS
from cmbrl.errors import UserError
from cmbrl.text import shortened

_GAINS = re.compile(r".*\.(?P<gain>kp|kd)\.(?P<joint>.+)")  #: columns of gains, by joint
_AHEAD = re.compile(r"motor_cmd\.tau\b")  #: columns of torques ahead of a servo, which count where they are not all 0
LATE = 3600.0  #: [s] a header's stamp further away from the time of recording is no stamp


def read_rosbag(path: Path, joints: tuple[str, ...]) -> list[Recording]:
    """Each topic of a known type is a table: joints, trajectories, arrays of numbers, poses, odometry, IMU.

    Columns are called TOPIC.QUANTITY.JOINT; times are the headers' stamps, else those of recording. Gains that commands
    bring are constants, NaN where they change.
    """
    highlevel = need("rosbags.highlevel", path)
    typesys = need("rosbags.typesys", path)
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    samples: dict[str, list[tuple[float, dict[str, float]]]] = {}
    try:
        with highlevel.AnyReader([path], default_typestore=store) as reader:
            known = [one for one in reader.connections if one.msgtype in READERS and _defined(reader, one.msgtype)]
            for connection, nanoseconds, raw in reader.messages(connections=known) if known else ():
                message = reader.deserialize(raw, connection.msgtype)
                topic = connection.topic.strip("/").replace("/", ".")
                values = dict(READERS[connection.msgtype](message, joints))
                samples.setdefault(topic, []).append((_stamp(message, nanoseconds * 1e-9), values))
            topics = sorted(f"{one.topic} ({one.msgtype})" for one in reader.connections)
    except Exception as error:  # the library raises kinds of its own for each storage, and struct and database errors
        raise UserError(f"{path}: not readable as a ROS bag ({shortened(repr(error), 200)})") from None
    tables = tuple(_table(topic, rows) for topic, rows in samples.items() if len(rows) > 1)
    if not tables:
        told = ", ".join(sorted(READERS))
        lost = [name for name in topics if any(f"({kind})" in name for kind in READERS)]
        has = ", ".join(topics) or "none"
        if lost:
            has += ", whose types it does not define: convert it to MCAP by `ros2 bag convert` where they are installed"
        raise UserError(f"{path}: no topic of a known type; it has {has}; known: {told}")
    gains = dict(_gains(tables))
    left = [{name: x for name, x in table.columns.items() if not _GAINS.fullmatch(name)} for table in tables]
    return [Recording(str(path), tuple(Table(x, table.time) for x, table in zip(left, tables, strict=True)), gains)]


def _defined(reader: Any, kind: str) -> bool:
    return kind in reader.typestore.types or kind in reader.typestore.fielddefs


def _gains(tables: tuple[Table, ...]) -> Iterator[tuple[str, np.ndarray]]:
    for table in tables:
        for column, values in table.columns.items():
            if gain := _GAINS.fullmatch(column):
                held = np.ptp(values) <= 1e-6 * np.abs(values).max()
                yield f"{gain['gain']}.{gain['joint']}", np.array(values[0] if held else np.nan)


def _table(topic: str, rows: list[tuple[float, dict[str, float]]]) -> Table:
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
