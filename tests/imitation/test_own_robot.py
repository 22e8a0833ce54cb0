"""Robots of a user's own, from a task file: every command finds them again, and their servos are what the file says."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl.cli import main
from cmbrl.data import Transitions
from cmbrl.envs.evaluation import evaluate_real
from cmbrl.envs.of_task import real_system, trial_process
from cmbrl.errors import UserError
from cmbrl.imitation import joints
from cmbrl.imitation.flight import flying
from cmbrl.imitation.reading import read_motion
from cmbrl.imitation.robot import Robot, imitation_task
from cmbrl.registry import load_task
from cmbrl.scene import Scene
from cmbrl.system import MujocoSystem
from tests.imitation.own_robot import ARM, CRAWLER, rocking, waving, write

SMALL = [f"--set={name}" for name in ("environments=4", "window=0.06", "actor_hidden=8", "critic_hidden=8")]


class Late(MujocoSystem):
    """Commands act five steps late."""

    def reset(self, q: np.ndarray, v: np.ndarray) -> None:
        self.waiting: list[np.ndarray] = []
        super().reset(q, v)

    def step(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self.waiting.append(u.copy())
        return super().step(self.waiting[max(0, len(self.waiting) - 6)])


@pytest.fixture(scope="module")
def crawler(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("crawler")
    write(folder, CRAWLER, ("trunk", "left", "right"), ("left", "right"))
    np.savez(folder / "m.npz", q=rocking(), rate=60.0, joint_names=["left_hip", "right_hip"])
    return folder


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("arm")
    write(folder, ARM, ("upper", "lower", "finger"), ("finger",))
    np.savez(folder / "m.npz", q=waving(), rate=60.0)
    np.savetxt(folder / "m.csv", waving(rate=30.0), delimiter=",")
    return folder


def trained(folder: Path, *more: str, motion: str = "m.npz", out: str = "run") -> int:
    given = ["--motion", str(folder / motion), "--out", str(folder / out), "--iterations", "2", "--threads", "1"]
    return main(["train", str(folder / "own.py"), *given, *SMALL, *more])


@pytest.mark.parametrize("robot", ["crawler", "arm"])
def test_every_command_finds_the_task_of_a_file_again(
    robot: str, request: pytest.FixtureRequest, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = request.getfixturevalue(robot)
    run = str(folder / "run")
    assert trained(folder) == 0
    assert trained(folder, "--resume") == 0
    told = json.loads((folder / "run/train.json").read_text())
    assert f"{told['model_return']['policy']:.4g} in the model" in capsys.readouterr().out
    assert main(["evaluate", run, "--real", "--episodes", "1", "--json"]) == 0
    real = json.loads(capsys.readouterr().out)["in"]["real"]
    assert real["mean_body_position_error_cm"] > 0
    assert np.isfinite(real["return"]["mean"])
    assert ("falls" in real) == (robot == "crawler")  # an arm cannot fall
    policy, log = str(folder / "policy.pt"), folder / "log.npz"
    assert main(["export", run, "--torchscript", policy]) == 0
    recorded = ["record", str(folder / "own.py"), "--motion", str(folder / "m.npz"), "--policy", policy]
    assert main([*recorded, "--steps", "30", "--out", str(log)]) == 0
    assert len(Transitions.load(log)) == 30


def test_a_real_system_of_ones_own_is_met_by_every_motion(arm: Path) -> None:
    """Evaluations and logs; it had no place, and one that was put into the task was lost where a motion was named."""
    task = load_task(str(arm / "own.py"))
    assert task.of_motion is not None
    robot = Robot(scene=arm / "robot.xml", tracked=("upper", "lower", "finger"), anchor="upper", ends=("finger",))
    made = []

    def late() -> MujocoSystem:
        made.append(Late(robot.scene, 5))
        return made[-1]

    own = imitation_task("own", "an arm with late commands", robot, system=late)
    assert own.of_motion is not None
    plain, delayed = (
        evaluate_real(lambda o: torch.zeros(len(o), 3), trial_process(each), real_system(each), 1)
        for each in (task.of_motion(arm / "m.npz"), own.of_motion(arm / "m.npz"))
    )
    assert len(made) == 1
    assert delayed.info["body_position_error_cm"][0] > 1.1 * plain.info["body_position_error_cm"][0]
    assert len(own.of_motion(arm / "m.npz").record(10)) == 10
    assert len(made) == 2
    with pytest.raises(UserError, match="leave one out"):
        imitation_task("own", "two robots", robot, change=lambda model: None, system=late)


@pytest.mark.parametrize(
    ("names", "told"),
    [
        ({}, "8 columns, but crawler has 10 .* Joints without a servo, as 'spin', may be missing in an npz"),
        ({"joint_names": ["left_hip"]}, "has no joint 'right_hip' of crawler: .* keeps still needs a column, too"),
    ],
)
def test_a_motion_of_some_joints_is_refused_with_a_remedy(
    crawler: Path, tmp_path: Path, names: dict[str, list[str]], told: str
) -> None:
    np.savez(tmp_path / "m.npz", q=rocking()[:, :8], rate=60.0, **names)
    with pytest.raises(UserError, match=told):
        read_motion(tmp_path / "m.npz", Scene.from_mjcf(crawler / "robot.xml"), 0.02)


def test_no_motion_of_its_own_is_one_line(arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    assert main(["train", str(arm / "own.py"), "--out", str(out)]) == 2
    assert "name a file (--motion FILE)" in capsys.readouterr().err
    assert not out.exists()


def test_csv_and_npz_of_a_fixed_root_are_the_same(arm: Path) -> None:
    task = load_task(str(arm / "own.py"))
    assert task.of_motion is not None
    both = [task.of_motion(arm / f"m.{kind}").reference for kind in ("npz", "csv")]
    npz, csv = (of() for of in both if of is not None)
    np.testing.assert_allclose(npz, csv, atol=2e-3)


def test_servos_that_follow_the_reference_hold_it(arm: Path, crawler: Path) -> None:
    """An action of 0 aims at the reference: through gears, tendons, and servos in another order than the joints."""
    for folder in (arm, crawler):
        task = load_task(str(folder / "own.py"))
        assert task.of_motion is not None
        task = task.of_motion(folder / "m.npz")
        assert task.trial is not None
        assert task.system is not None
        trial, robot = task.trial(), task.system()
        q, v = trial.reset(1, torch.Generator().manual_seed(0))
        robot.reset(trial.robot(q)[0].numpy(), v[0].numpy())
        for _ in range(35):
            q_from, v_from, u = trial.act(q, v, torch.zeros(1, trial.actions, dtype=torch.float64))
            moved = robot.step(u[0].numpy())
            q = torch.cat([torch.from_numpy(moved[0])[None], q_from[:, len(moved[0]) :]], dim=1)
            v = torch.from_numpy(moved[1])[None]
        with torch.no_grad():
            told = trial.info(q_from, v_from, u, q, v)
        assert float(told["body_position_error_cm"]) < 4.0


def test_reach_is_the_torque_limit_wherever_the_file_has_it(crawler: Path, arm: Path) -> None:
    scene = Scene.from_mjcf(crawler / "robot.xml")
    right, left = joints.reach(scene, 0.75)
    assert left == pytest.approx(0.75 * 3 / 20)  # limited at the joint
    assert right == pytest.approx(0.4)  # not limited at all
    assert joints.reach(Scene.from_mjcf(arm / "robot.xml"), 0.75)[2] == pytest.approx(
        0.2 * 4 / 200
    )  # its targets' range


def test_links_that_are_near_each_other_are_no_floor(crawler: Path) -> None:
    scene = Scene.from_mjcf(crawler / "robot.xml")
    q = np.tile(scene.q0, (2, 1))
    q[1, 2] += 0.2
    assert flying(scene, q).tolist() == [False, True]


def test_numbers_of_the_reward_shrink_with_the_robot(crawler: Path) -> None:
    scene = Scene.from_mjcf(crawler / "robot.xml")
    assert joints.size(scene, "trunk") == pytest.approx(0.09 / joints.SIZE, rel=0.01)
    assert joints.size(load_task("g1").load_scene(), "torso_link") == 1.0
