"""Hopper: a one-legged planar robot; the real system is Gymnasium's Hopper-v5 (MuJoCo, 4 RK4 steps of 2 ms).

The model takes 2 leapfrog steps of 4 ms: leapfrog is of second order like the smooth part of what it stands for, and
contact with a time constant of 20 ms does not resolve finer steps.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cmbrl.registry import Task


def _scene() -> Path:
    from cmbrl.data.recorder import gymnasium_asset

    return gymnasium_asset("hopper.xml")


def _record(**arguments: Any) -> Any:
    from cmbrl.data.recorder import record_gymnasium

    return record_gymnasium("Hopper-v5", **arguments)


TASK = Task(
    name="hopper",
    description="Hopper-v5: one leg, planar, 3 motors; episodes end when it falls",
    scene=_scene,
    control_dt=0.008,
    substeps=2,
    time_step=0.004,
    integrator="leapfrog",
    contact_gap=1e-3,
    recorder=_record,
)
