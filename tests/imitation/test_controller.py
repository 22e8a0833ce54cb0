"""What `cmbrl export --controller` writes is enough to act by a policy without cmbrl: numpy and a robot's state."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from cmbrl.cli.main import main
from cmbrl.envs.of_task import task_for, trial_process
from cmbrl.train.policies.file import load_policy

from . import own_robot

ROBOTS = {
    "crawler": (own_robot.CRAWLER, ("trunk", "left", "right"), ("left", "right"), own_robot.rocking),
    "arm": (own_robot.ARM, ("lower", "finger"), ("finger",), own_robot.waving),
}
NAMES = {"crawler": ["left_hip", "right_hip"], "arm": ["shoulder", "elbow", "grip"]}


def observed(held: dict[str, np.ndarray], frame: int, action: np.ndarray, data: mujoco.MjData) -> np.ndarray:
    """As a controller would, from what was exported and what the robot tells."""
    n = len(held["joint_names"])
    body = data.body(str(held["anchor"]))
    turn = body.xmat.reshape(3, 3).T
    place, rotation = held["reference_anchor_position"][frame], held["reference_anchor_rotation"][frame]
    parts = {
        "reference_joint_positions": held["reference_q"][frame, -n:],
        "reference_joint_velocities": held["reference_v"][frame, -n:],
        "reference_anchor_position_in_anchor": turn @ (place - body.xpos),
        "reference_anchor_rotation_in_anchor_by_rows_of_two_columns": (turn @ rotation)[:, :2].ravel(),
        "root_linear_velocity_in_root": turn @ data.qvel[:3],  # the anchor is the root here
        "root_angular_velocity_in_root": data.qvel[3:6],
        "joint_positions_minus_posture": data.qpos[-n:] - held["posture"],
        "joint_velocities": data.qvel[-n:],
        "last_action": action,
    }
    found = [parts[name] for name in held["observation_parts"]]
    assert [len(part) for part in found] == held["observation_sizes"].tolist()
    return np.concatenate(found)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_controller_of_numpy_sees_and_commands_what_the_task_does(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, tracked, ends, moving = ROBOTS[name]
    robot, file = own_robot.write(tmp_path, text, tracked, ends)
    np.savez(tmp_path / "m.npz", q=moving(), rate=60.0, joint_names=NAMES[name])
    small = ["--iterations", "1", "--set", "environments=4", "--set", "window=0.08", "--threads", "1"]
    motion = str(tmp_path / "m.npz")
    assert main(["train", str(file), "--motion", motion, *small, "--out", str(tmp_path / "run")]) == 0
    assert main(["export", str(tmp_path / "run"), "--controller", str(tmp_path / "c.npz")]) == 0
    assert "c.npz: observations are " in capsys.readouterr().out
    with np.load(tmp_path / "c.npz") as held:
        arrays = dict(held)
    task = task_for(str(file), motion)
    mdp = trial_process(task)
    policy = load_policy(tmp_path / "run").policy
    q, v = mdp.reset(3, torch.Generator().manual_seed(0))
    nu = mdp.actions
    for action in (torch.zeros(3, nu), torch.linspace(-1, 1, 3 * nu).reshape(3, nu)):
        q, v, u = mdp.act(q, v, action.double())  # the second time in the next frame, after an action
        model = mujoco.MjModel.from_xml_path(str(robot))
        data = mujoco.MjData(model)
        for row in range(3):
            data.qpos[:], data.qvel[:] = mdp.robot(q)[row].numpy(), v[row].numpy()
            mujoco.mj_forward(model, data)
            frame = int(q[row, -1 - nu])
            seen = observed(arrays, frame, action[row].numpy(), data)
            np.testing.assert_allclose(seen, mdp.observe(q, v)[row].numpy(), atol=1e-9)
            targets = arrays["targets"][frame] + arrays["action_scale"] * action[row].numpy()
            np.testing.assert_allclose(arrays["control_per_target"] * targets, u[row].numpy(), atol=1e-12)
    assert arrays["actuator_names"].tolist() == list(task.load_scene().actuator_names)
    assert policy.architecture.observations == arrays["observation_sizes"].sum()
    assert arrays["dt"] == 0.02


def test_a_task_that_does_not_tell_is_refused_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    small = ["--iterations", "1", "--set", "environments=4", "--set", "horizon=4", "--threads", "1"]
    assert main(["train", "hopper", "--algorithm", "shac", *small, "--out", str(tmp_path / "run")]) == 0
    files = [f"--torchscript={tmp_path / 'p.pt'}", f"--controller={tmp_path / 'c.npz'}"]
    assert main(["export", str(tmp_path / "run"), *files]) == 2
    assert "does not tell" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.pt")) + list(tmp_path.glob("*.npz"))
