"""Cube toss: a real acrylic cube thrown onto a board; the real system is a motion-capture log (148 Hz).

Velocities in the log are backward differences, as in a semi-implicit step: q' = q + h v'. ``TASK`` has the cube as
published, with sharp corners and hard contact; ``ROUNDED`` has the shape and softness that explain the tosses best.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from cmbrl.registry import Task

DT = 1.0 / 148.0


def _record(**arguments: Any) -> Any:
    from cmbrl.tasks.cube_toss.real import record

    return record(**arguments)


TASK = Task(
    name="cube_toss",
    description="real tosses of a 10 cm cube (ContactNets): a log, given by --data or CMBRL_DATA; no control",
    scene=Path(__file__).with_name("scene.xml"),
    control_dt=DT,
    substeps=1,
    time_step=DT,
    contact_law="rigid",
    smoothing_speed=3e-5,
    contact_gap=2e-3,
    behaviours=("log",),
    takes_log=True,
    recorder=_record,
)

ROUNDED = replace(
    TASK,
    name="cube_rounded",
    description="the same tosses; the cube with rounded edges and soft contact",
    scene=Path(__file__).with_name("rounded.xml"),
    contact_law="mujoco",
    smoothing_speed=3e-4,
)
