"""The hopper with a payload, weak motors and a slippery foot in Drake, for docs/results/robots.md: a task file.

cmbrl record scripts/drake_hopper.py --steps 1000 --out train.npz
cmbrl fit scripts/drake_hopper.py --data train.npz --out runs/fit
cmbrl train scripts/drake_hopper.py --algorithm loop --set rounds=3 --set policies=1 --iterations 4500 --out runs/loop
cmbrl evaluate runs/loop --real
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from cmbrl.data.transitions import Transitions
from cmbrl.envs.drake import DrakeSystem
from cmbrl.envs.mujoco_recording import record_mujoco
from cmbrl.tasks.hopper import TASK as HOPPER
from cmbrl.tasks.hopper.mdp import mdp
from cmbrl.tasks.hopper_payload.real import system as changed


def system() -> DrakeSystem:
    return DrakeSystem(changed(HOPPER.scene_path))


def record(**arguments: Any) -> Transitions:
    return record_mujoco("drake_hopper", mdp(), system, **arguments)


TASK = replace(
    HOPPER, name="drake_hopper", description="the hopper with a payload, in Drake", system=system, recorder=record
)
