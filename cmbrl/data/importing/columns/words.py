"""Words of which names of columns are made: quantities, clocks, poses, and what says nothing."""

from __future__ import annotations

import re

WORDS = {
    "torque": {"torque", "torques", "tau", "effort", "efforts", "force", "moment", "moments"},
    "command": {
        "command", "commands", "commanded", "cmd", "target", "targets", "des", "desired", "setpoint", "reference",
        "ref", "goal", "action", "actions",
    },
    "velocity": {"velocity", "velocities", "vel", "qd", "dq", "qdot", "qvel", "speed", "rate"},
    "control": {"control", "ctrl", "u"},
    "position": {
        "position", "positions", "pos", "q", "angle", "angles", "qpos", "measured", "meas", "encoder", "enc", "dof",
        "actual", "feedback", "fb", "present", "theta",
    },
}  # fmt: skip
PLAIN = {
    "joint", "joints", "state", "states", "observation", "observations", "motor", "robot", "data", "logs",
    "lowstate", "lf", "",
}  # fmt: skip
OTHER = {
    "acc", "accel", "acceleration", "temp", "temperature", "current", "voltage", "error", "err", "status", "std", "min",
    "max", "kp", "kd", "gain", "rewards", "infos", "tcp",
}  # fmt: skip
TIMES = {"time", "t", "timestamp", "timestamps", "times", "stamp", "_time"}
CLOCKS = {"%time": 1e-9, "__time": 1.0}  #: of ``rostopic echo -p`` and of PlotJuggler
POSES = {"q": {"quat", "quaternion", "orientation", "rotation"}, "": {"pos", "position", "translation"}}  #: of a base
OF_BODIES = {
    "pose",
    "position",
    "orientation",
    "rotation",
    "quat",
    "quaternion",
    "velocity",
    "twist",
    "linear",
    "angular",
}
YIELDS = {"imu", "feedback"}  #: what these tell counts where no other column does
UNNAMED = re.compile(r"(?P<array>.+?)\.?\[\d+\]")  #: a column of an array whose columns have no names
EPISODES = {"episode", "episode_index", "episode_id", "trial", "toss", "trajectory"}
