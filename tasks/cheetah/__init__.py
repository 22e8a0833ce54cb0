"""Half-cheetah: a planar runner; the real system is Gymnasium's HalfCheetah-v5 (MuJoCo, 5 Euler steps of 10 ms).

10 ms is far from converged in the real system itself, so the model takes the very same steps. Random actions never end
an episode; recorded ones are cut at 200 control steps (10 s), so that small logs can be split by episode too.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cmbrl.registry import Task

EPISODE_STEPS = 200


def _scene() -> Path:
    from cmbrl.data.recorder import gymnasium_asset

    return gymnasium_asset("half_cheetah.xml")


def _record(**arguments: Any) -> Any:
    from cmbrl.data.recorder import record_gymnasium

    return record_gymnasium("HalfCheetah-v5", episode_steps=EPISODE_STEPS, **arguments)


def _mdp() -> Any:
    from cmbrl.tasks.cheetah.mdp import mdp

    return mdp()


def _system() -> Any:
    from cmbrl.envs.system import MujocoSystem

    return MujocoSystem(_scene(), frame_skip=5)


TASK = Task(
    name="cheetah",
    description="HalfCheetah-v5: two legs, planar, 6 motors; episodes of 200 control steps",
    scene=_scene,
    control_dt=0.05,
    substeps=5,
    time_step=0.01,
    recorder=_record,
    mdp=_mdp,
    system=_system,
)
