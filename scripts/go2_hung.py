"""A Unitree Go2 that is fitted while it hangs and then walks: a task file whose real system is MuJoCo with other legs.

export GO2=FOLDER/unitree_go2/robot.xml                # of MuJoCo Menagerie, with a floor; its actuators are motors
cmbrl convert $GO2 hung.xml --hold joint0              # the same robot, held by its trunk
python scripts/go2_hung.py hung.xml log.npz            # 20 s of its encoders, by targets at 250 Hz
cmbrl fit hung.xml --data log.npz --out fit
cmbrl train scripts/go2_hung.py --algorithm shac --model fit --iterations 400 --out run      # or --model nominal
cmbrl evaluate run --real --episodes 5
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.scene.drives import Drive, driven_model
from cmbrl.walking import Walker, walking_task

LEGS, JOINTS = ("FL", "FR", "RL", "RR"), {"hip": 0.0, "thigh": 0.9, "calf": -1.8}  # rad, when it stands
KP, KD = 30.0, 1.0  # of the robot's driver
DRIVES = (Drive("*", "position", kp=KP, kd=KD),)


def change(model: Any) -> None:
    """Legs that are not those of the file, in a robot that hangs and in one that walks."""
    rng = np.random.default_rng(7)
    for leg in LEGS:
        for joint in JOINTS:
            dof = model.joint(f"{leg}_{joint}_joint").dofadr[0]
            model.dof_damping[dof] = rng.uniform(0.1, 0.6)
            model.dof_frictionloss[dof] = rng.uniform(0.5, 1.2)
            model.dof_armature[dof] = rng.uniform(0.015, 0.03)
        for link in ("thigh", "calf"):
            body, factor = model.body(f"{leg}_{link}").id, rng.uniform(1.0, 1.3)
            model.body_mass[body] *= factor
            model.body_inertia[body] *= factor


def record(scene: str, out: str) -> None:
    """Encoders (noise .2 mrad, steps of .38 mrad) under sums of sines of .3 to 4 Hz, every 4 ms."""
    import mujoco

    model = driven_model(mujoco.MjModel.from_xml_path(scene), DRIVES, scene)
    change(model)
    data, rng, dt = mujoco.MjData(model), np.random.default_rng(3), 0.004
    names = [model.joint(k).name for k in range(model.njnt)]
    rest = np.array([JOINTS[name.split("_")[1]] for name in names])
    frequency, phase = rng.uniform(0.3, 4.0, (12, 4)), rng.uniform(0.0, 2.0 * np.pi, (12, 4))
    size, time = rng.uniform(0.05, 0.25, (12, 4)) / np.sqrt(frequency), dt * np.arange(5000)
    waves = np.sin(2.0 * np.pi * frequency * time[:, None, None] + phase) - np.sin(phase)
    target = rest + (size * waves).sum(2) * np.minimum(1.0, 2.0 * time)[:, None]
    order = [names.index(f"{model.actuator(k).name}_joint") for k in range(model.nu)]
    position = np.zeros_like(target)
    data.qpos[:] = rest
    for row, given in enumerate(target):
        position[row] = data.qpos
        data.ctrl[:] = given[order]
        mujoco.mj_step(model, data, round(dt / model.opt.timestep))
    position = 3.8e-4 * np.round((position + rng.normal(0.0, 2e-4, position.shape)) / 3.8e-4)
    np.savez(
        out, time=time, joint_position=position, commanded_position=target, joint_names=np.array(names), kp=KP, kd=KD
    )


POSTURE = {f"{leg}_{joint}_joint": angle for leg in LEGS for joint, angle in JOINTS.items()}
WALKER = Walker(scene=Path(os.environ.get("GO2", "robot.xml")).resolve(), posture=POSTURE, drives=DRIVES)
TASK = walking_task("go2_hung", "Go2 with other legs than its file's", WALKER, change=change)

if __name__ == "__main__":
    record(*sys.argv[1:])
