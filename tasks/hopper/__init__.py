"""Hopper: a one-legged planar robot; the real system is Gymnasium's Hopper-v5 (MuJoCo, 4 RK4 steps of 2 ms).

The model takes 4 leapfrog steps of 2 ms: leapfrog is of second order like the smooth part of what it stands for, and
MuJoCo's softness maps onto ours only at its own step (at 2 x 4 ms the unfitted model errs twice as much for half the
time).
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


def _mdp() -> Any:
    from cmbrl.tasks.hopper.mdp import mdp

    return mdp()


def _system() -> Any:
    from cmbrl.envs.system import MujocoSystem

    return MujocoSystem(_scene(), frame_skip=4)


TASK = Task(
    name="hopper",
    description="Hopper-v5: one leg, planar, 3 motors; episodes end when it falls",
    scene=_scene,
    control_dt=0.008,
    substeps=4,
    time_step=0.002,
    integrator="leapfrog",
    contact_gap=1e-3,
    recorder=_record,
    mdp=_mdp,
    system=_system,
)
