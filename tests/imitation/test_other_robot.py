"""A quadruped imitates by a configuration alone: the same task class as the humanoid's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl.envs.evaluation import evaluate_real
from cmbrl.envs.of_task import decision_process, real_system, trial_process
from cmbrl.imitation.motion import Motion
from cmbrl.imitation.robot import Robot, imitation_task
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.registry import Task
from cmbrl.scene import Scene
from cmbrl.train.shac import SHAC, SHACConfig

FILE = Path(__file__).parents[3] / "shared/models/menagerie/anybotics_anymal_c/robot.xml"
pytestmark = pytest.mark.skipif(not FILE.exists(), reason="needs ../shared/models/menagerie")
LEGS = ("LF", "RF", "LH", "RH")
STANCE = {f"{leg}_{joint}": angle * (1 if leg.endswith("F") else -1) for leg in LEGS
          for joint, angle in (("HFE", 0.4), ("KFE", -0.8))}  # fmt: skip
ANYMAL = Robot(
    scene=FILE,
    tracked=("base", *(f"{leg}_SHANK" for leg in LEGS)),
    anchor="base",
    ends=tuple(f"{leg}_SHANK" for leg in LEGS),
    posture=STANCE,
)


def bow(scene: Scene) -> Motion:
    """Two seconds of bending all legs a little and stretching them again."""
    time = np.arange(101) / 50.0
    q = np.tile(scene.q0, (101, 1))
    for joint, angle in STANCE.items():
        q[:, 6 + scene.joint_names.index(joint)] = angle * (1.0 + 0.2 * (0.5 - 0.5 * np.cos(np.pi * time)))
    q[:, 2] -= scene.gaps(q).min(axis=1)
    return Motion.of_frames(scene, q, 50.0, 0.02, "bow")


@pytest.fixture(scope="module")
def task() -> Task:
    return imitation_task("anymal", "ANYmal that bows", ANYMAL, bow, substeps=10)


def test_it_learns_and_is_tried_in_mujoco(task: Task) -> None:
    mdp = decision_process(task)
    assert mdp.observations == 5 * 12 + 15
    model = ComplementarityModel(task.load_scene(), **task.model_options())
    settings = {"environments": 8, "window": 0.08, "actor_hidden": (16,), "critic_hidden": (16,)}
    trainer = SHAC(mdp, model, SHACConfig(iterations=3, **settings), 0)  # type: ignore[arg-type]
    for _ in range(3):
        metrics = trainer.update()
        assert np.isfinite(metrics["gradient_norm"])
        assert metrics["gradient_norm"] > 0
    with torch.no_grad():
        tried = evaluate_real(trainer.policy, trial_process(task), real_system(task), 2, 0)
    assert tried.lengths.min() > 10
    assert np.isfinite(tried.info["body_position_error_cm"]).all()
