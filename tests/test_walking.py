"""Walking tasks of a user's own robot: start, commands, reward, what is refused; and from a file to a policy."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import torch

from cmbrl import Scene, UserError
from cmbrl.cli import main
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.named import nominal_model
from cmbrl.models.native_step.stepper import SplitStepper
from cmbrl.models.source import load_source
from cmbrl.scene.drives import Drive
from cmbrl.train.recipe import configure
from cmbrl.train.shac import SHAC
from cmbrl.walking import Walker, Walking, walking_task

LEG = """
<body name="{name}" pos="{x} {y} 0">
  <joint name="{name}_hip" type="hinge" axis="0 1 0" damping="0.5" armature="0.01"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.3"/>
  <body pos="0 0 -0.2">
    <joint name="{name}_knee" type="hinge" axis="0 1 0" damping="0.5" armature="0.01"/>
    <geom name="{name}_foot" type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.2"/>
  </body>
</body>"""
LEGS = {"fl": (0.2, 0.1), "fr": (0.2, -0.1), "rl": (-0.2, 0.1), "rr": (-0.2, -0.1)}
POSTURE = {f"{leg}_{joint}": x for leg in LEGS for joint, x in (("hip", 0.6), ("knee", -1.2))}
FLOOR = '<geom name="floor" type="plane" size="0 0 1"/>'


def robot(floor=FLOOR, root="<freejoint/>", actuators=None):
    legs = "".join(LEG.format(name=name, x=x, y=y) for name, (x, y) in LEGS.items())
    if actuators is None:
        actuators = "".join(f'<position joint="{name}" kp="60" ctrlrange="-1.5 1.5"/>' for name in POSTURE)
    return f"""
<mujoco model="dog"><option timestep="0.004"/><worldbody>{floor}<body name="trunk" pos="0 0 0.6">{root}
<geom type="box" size="0.25 0.1 0.05" mass="5"/>{legs}</body></worldbody><actuator>{actuators}</actuator></mujoco>"""


def walking(tmp_path, xml=None, **settings):
    path = tmp_path / "dog.xml"
    path.write_text(robot() if xml is None else xml)
    walker = Walker(scene=path, **({"posture": POSTURE} | settings))
    return Walking(walker, Scene.from_mjcf(path), 0.02)


def test_what_a_controller_is_told_makes_the_observations_and_commands(tmp_path):
    made = walking(tmp_path)
    told, mdp = made.controller(), made.process()
    q, v = mdp.reset(3, torch.Generator().manual_seed(0))
    q[:, 3:7] = torch.nn.functional.normalize(torch.randn(3, 4, dtype=torch.float64), dim=1)
    action = torch.rand(3, mdp.actions, dtype=torch.float64) * 2 - 1
    _, _, u = mdp.act(q, v, action)
    for k in range(3):
        w, x, y, z = q[k, 3:7].tolist()
        turn = np.array(  # of the world into the root
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
                [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
                [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        parts = {
            "root_height": q[k, 2:3].numpy(),
            "vertical_in_root": turn[:, 2],
            "root_linear_velocity_in_root": turn @ v[k, :3].numpy(),
            "root_angular_velocity_in_root": v[k, 3:6].numpy(),
            "joint_positions_minus_posture": q[k, 7:].numpy() - told["posture"],
            "joint_velocities_times_a_tenth": 0.1 * v[k, 6:].numpy(),
        }
        seen = [parts[name] for name in told["observation_parts"]]
        assert [len(part) for part in seen] == told["observation_sizes"].tolist()
        assert np.allclose(np.concatenate(seen), mdp.observe(q, v)[k].numpy(), atol=1e-12)
        asked = np.clip(told["home"] + told["action_scale"] * action[k].numpy(), *told["control_range"].T)
        assert np.allclose(asked, u[k].numpy(), atol=1e-12)
    assert told["joint_names"].tolist() == list(told["observed_positions"]) == list(made.scene.joint_names[1:])


def test_it_starts_in_its_posture_with_its_feet_on_the_floor(tmp_path):
    made = walking(tmp_path)
    assert made.height == pytest.approx(0.4 * math.cos(0.6) + 0.02)
    q, v = made.process().reset(50, torch.Generator().manual_seed(0))
    assert (q[:, 7:] - made.q0[7:]).abs().max() <= 0.1
    scene = Scene.from_mjcf(tmp_path / "dog.xml")
    assert np.allclose(scene.gaps(q.numpy())[:, scene.core.con_plane >= 0].min(axis=1), 0.0, atol=1e-12)
    assert v.std() == pytest.approx(0.1, rel=0.2)


def keyed():
    bent = " ".join(str(x) for x in POSTURE.values())
    key = f'<keyframe><key name="home" qpos="0 0 0.3 1 0 0 0 {bent}"/></keyframe></mujoco>'
    return robot().replace("</mujoco>", key)


def test_a_keyframe_is_a_posture(tmp_path):
    made, same = walking(tmp_path, keyed(), posture="home"), walking(tmp_path)
    assert torch.equal(made.q0[7:], same.q0[7:])
    assert made.height == pytest.approx(same.height)  # on the floor, however high the keyframe is
    assert torch.equal(made.home, same.home)


def test_commands_of_servos_and_motors(tmp_path):
    def asked(actuators, reach):
        """Controls of no action, and what an action of 1 adds."""
        made = walking(tmp_path, robot(actuators="".join(actuators.format(name) for name in POSTURE)), reach=reach)
        q, v = made.process().reset(2, torch.Generator().manual_seed(0))
        still, full = made.act(q, v, torch.tensor([[0.0] * 8, [1.0] * 8], dtype=torch.float64))[2].numpy()
        return still, full - still

    angles = np.array([*POSTURE.values()])
    still, more = asked('<position joint="{}" kp="60"/>', 0.4)
    assert np.allclose(more, 0.4)
    torques = 60.0 * (still - angles)
    assert np.allclose(torques[[0, 1, 4, 5]], torques[[2, 3, 6, 7]])  # left and right
    geared, more = asked('<general joint="{}" gear="-3" gainprm="5" biastype="affine" biasprm="0 -60"/>', 0.4)
    assert np.allclose(geared, -36.0 * angles - torques / 15.0)  # 5 u + 60 * 3 q is the force before the gear
    assert np.allclose(more, -36.0 * 0.4)
    motors, more = asked('<motor joint="{}" ctrlrange="-20 20"/>', 0.5)
    assert np.allclose(motors, torques)
    assert np.allclose(more, 10.0)


WHEEL = """<body name="{0}_wheel" pos="0 0 -0.2"><joint name="{0}_wheel" axis="0 1 0"{1}/>
<geom type="cylinder" size="0.05 0.02" euler="90 0 0" mass="0.3"/></body>"""


def wheeled(servo, limits=""):
    """The robot with wheels for feet, under servos of velocities."""
    xml = robot().replace("</actuator>", "".join(servo.format(name) for name in LEGS) + "</actuator>")
    for name, (x, y) in LEGS.items():
        leg = LEG.format(name=name, x=x, y=y)
        xml = xml.replace(leg, leg.replace("</body>", WHEEL.format(name, limits) + "</body>", 1))
    return xml


def test_wheels_are_asked_for_all_of_their_speeds_and_their_angles_are_not_observed(tmp_path):
    servo = '<velocity joint="{}_wheel" kv="2" ctrlrange="-20 20"/>'
    made = walking(tmp_path, wheeled(servo))
    torch.testing.assert_close(made.scale, torch.tensor([0.4] * 8 + [20.0] * 4, dtype=torch.float64))
    q, v = made.process().reset(4, torch.Generator().manual_seed(0))
    rolled, wheels = q.clone(), [6 + made.scene.joint_names.index(f"{name}_wheel") for name in LEGS]
    rolled[:, wheels] += 100.0
    seen = made.observe(q, v)
    assert seen.shape[1] == made.process().observations == 10 + 8 + 12
    assert torch.equal(seen, made.observe(rolled, v))
    limited = walking(tmp_path, wheeled(servo, ' limited="true" range="-90 90"'))
    assert limited.process().observations == 10 + 12 + 12


def test_a_servo_of_velocities_without_a_range_is_refused_with_a_remedy(tmp_path):
    with pytest.raises(UserError, match=r"dog: fl_wheel takes speeds, .*: give its <velocity> a range, as ctrlrange="):
        walking(tmp_path, wheeled('<velocity name="{0}_wheel" joint="{0}_wheel" kv="2"/>'))


@pytest.mark.parametrize(
    "actuator", ['<position joint="{}" kp="15" kv="1"/>', '<position joint="{}" kp="300" kv="2"/>']
)
def test_no_action_holds_the_posture_in_mujoco(tmp_path, actuator):
    path = tmp_path / "dog.xml"
    path.write_text(robot(actuators="".join(actuator.format(name) for name in POSTURE)))
    task = walking_task("dog", "stands", Walker(scene=path, posture=POSTURE))
    process, real = task.mdp(), task.system()
    made = walking(tmp_path, path.read_text())
    real.reset(made.q0.numpy(), np.zeros(14))
    held = process.act(made.q0[None], torch.zeros(1, 14), torch.zeros(1, 8, dtype=torch.float64))[2][0].numpy()
    for _ in range(50):
        q, _ = real.step(held)
    assert np.abs(q[7:] - made.q0[7:].numpy()).max() < 0.01  # without the weight's share soft servos sag by 0.1 rad


@pytest.mark.parametrize(
    ("actuator", "limits", "expected"),
    [
        ('<motor joint="{}" gear="2" forcerange="-15 15"/>', "", 15.0),
        ('<motor joint="{}" gear="2"/>', 'actuatorfrcrange="-24 24"', 12.0),
        ('<motor joint="{}" gear="2" ctrlrange="-5 5" forcerange="-15 15"/>', "", 5.0),
        ('<motor joint="{}" gear="40"/>', "", 1.0),
    ],
)
def test_motors_without_a_range_of_controls_take_what_their_force_allows(tmp_path, actuator, limits, expected):
    xml = robot(actuators="".join(actuator.format(name) for name in POSTURE))
    xml = xml.replace('type="hinge"', f'type="hinge" {limits}')
    made = walking(tmp_path, xml, reach=0.5)
    assert np.allclose(made.scale, 0.5 * expected)


@pytest.mark.parametrize(
    ("actuator", "posture", "says"),
    [
        (
            '<position joint="{}" kp="0.6" ctrlrange="-0.8 0.8"/>',
            POSTURE,
            r"knee .* give 1.95 N m .* 1.2 \(7 more",
        ),
        ('<position joint="{}" kp="60" forcerange="-1 1"/>', POSTURE, "allow is -?1 "),
        ('<motor joint="{}" ctrlrange="-1 1"/>', POSTURE, "has to give"),
        ('<position joint="{}" kp="60" ctrlrange="-0.5 0.5"/>', POSTURE, "has to give"),
        ('<position joint="{}" kp="60"/>', dict.fromkeys(POSTURE, 0.6), "centre of mass is .* mm beside the feet"),
    ],
)
def test_a_posture_in_which_a_robot_cannot_rest_is_told(tmp_path, actuator, posture, says):
    xml = robot(actuators="".join(actuator.format(name) for name in POSTURE))
    with pytest.warns(UserWarning, match=f"dog cannot rest in its posture: .*{says}.*: choose another posture"):
        walking(tmp_path, xml, posture=posture)


def test_motors_whose_driver_takes_targets(tmp_path):
    file = tmp_path / "dog.xml"
    file.write_text(robot(actuators="".join(f'<motor name="{name}" joint="{name}"/>' for name in POSTURE)))
    drives = (Drive("*", "position", kp=60.0, kd=2.0), Drive("?l_hip", "position", kp=80.0))
    task = walking_task("dog", "walks", Walker(scene=file, posture=POSTURE, drives=drives))
    targets = task.mdp().act(*task.mdp().reset(1, torch.Generator()), torch.zeros(1, 8))[2]
    assert np.allclose(targets, [*POSTURE.values()], atol=0.05)
    gains = {"fl_hip": 80.0, "rl_hip": 80.0}
    expected = [gains.get(name, 60.0) for name in POSTURE]
    assert np.allclose(task.system().model.actuator_gainprm[:, 0], expected)
    scene = task.load_scene()
    assert [p.nominal for p in scene.parameters if p.group == "kp"] == expected


def test_a_task_is_fitted_under_its_drives(tmp_path):
    (tmp_path / "dog.xml").write_text(robot(actuators="".join(f'<motor joint="{name}"/>' for name in POSTURE)))
    (tmp_path / "dog.py").write_text(
        "from pathlib import Path\nfrom cmbrl.scene.drives import Drive\n"
        "from cmbrl.walking import Walker, walking_task\n"
        "WALKER = Walker(scene=Path(__file__).with_name('dog.xml'), drives=(Drive('*', 'position', kp=60.0),))\n"
        "TASK = walking_task('dog', 'walks', WALKER)\n"
    )
    source = load_source(str(tmp_path / "dog.py"))  # of fit, check, error, excite and info
    assert source.scene.drives == source.task.drives
    assert [p.nominal for p in source.scene.parameters if p.group == "kp"] == [60.0] * 8


def test_the_reward_is_best_upright_at_the_wanted_speed_whatever_the_heading(tmp_path):
    made = walking(tmp_path, speed=(0.6, 0.2, 0.3))
    q = made.q0[None].clone()
    v = torch.zeros(1, 14, dtype=torch.float64)
    v[0, [0, 1, 5]] = torch.tensor([0.6, 0.2, 0.3], dtype=torch.float64)
    still, action = torch.zeros_like(v), torch.zeros(1, 8, dtype=torch.float64)
    process = made.process()
    best = process.reward(q, v, action, q, v)
    assert best.item() == pytest.approx(1.5 - 0.01 / math.hypot(0.6, 0.2))
    assert process.reward(q, still, action, q, still) < best
    turned, moved = q.clone(), v.clone()
    angle = 2.0
    turned[0, 3:7] = torch.tensor([math.cos(angle / 2), 0, 0, math.sin(angle / 2)])
    c, s = math.cos(angle), math.sin(angle)
    moved[0, :2] = torch.tensor([c * 0.6 - s * 0.2, s * 0.6 + c * 0.2])
    assert torch.allclose(process.reward(turned, moved, action, turned, moved), best)
    assert torch.allclose(process.observe(turned, moved), process.observe(q, v))
    tilted = q.clone()
    tilted[0, 3:7] = torch.tensor([math.cos(0.6), math.sin(0.6), 0, 0])  # 1.2 rad
    low = q.clone()
    low[0, 2] *= 0.49
    assert [bool(process.terminated(x, v)) for x in (q, turned, tilted, low)] == [False, False, True, True]


def test_in_training_a_step_of_a_fall_is_worth_more_than_its_end(tmp_path):
    made = walking(tmp_path)
    process = made.process()
    q, v = made.q0[None].clone(), torch.zeros(1, 14, dtype=torch.float64)
    q[0, 2] *= 0.6
    q[0, 3:7] = torch.tensor([math.cos(0.5), 0, math.sin(0.5), 0])  # 1 rad ahead
    v[0, :3], v[0, 6:] = torch.tensor([1.0, 0.0, -1.0]), 5.0
    action = torch.ones(1, 8, dtype=torch.float64)
    reward = process.reward(q, -v, action, q, v)
    assert not process.terminated(q, v)
    assert reward < 0 < reward + process.shaping(q, v)


def test_derivatives_of_reward_and_observation_are_those_of_finite_differences(tmp_path):
    process = walking(tmp_path).process()
    generator = torch.Generator().manual_seed(3)
    q, v = process.reset(2, generator)
    inputs = [torch.randn(2, 8, generator=generator, dtype=torch.float64), q, v]
    inputs = [x.requires_grad_() for x in inputs]
    assert torch.autograd.gradcheck(lambda a, q1, v1: process.reward(q, v, a, q1, v1), inputs)
    assert torch.autograd.gradcheck(process.observe, inputs[1:])


@pytest.mark.parametrize(
    ("xml", "posture", "says"),
    [
        (robot(floor=""), {}, "walking needs a floor"),
        (robot(root=""), {}, "walking needs a free root"),
        (robot(actuators=""), {}, "walking needs actuators"),
        (robot(), {"fl_nee": 1.0}, "has no joint 'fl_nee': did you mean 'fl_knee'"),
        (keyed(), "hime", "no keyframe 'hime'; did you mean 'home'"),
        (robot(), "home", "no keyframe 'home'; it has none"),
    ],
)
def test_what_cannot_walk_is_refused_with_a_remedy(tmp_path, xml, posture, says):
    with pytest.raises(UserError, match=says):
        walking(tmp_path, xml, posture=posture)


@pytest.mark.parametrize(
    ("numbers", "says"),
    [
        ({"speed": (0.8,)}, "speed has 1 numbers: give ahead"),
        ({"speed": (0.8, 0.0, math.nan)}, "speed"),
        ({"posture": {"fl_hip": math.nan}}, "posture of fl_hip"),
        ({"posture": 3}, "posture = 3: give positions by joint, or the name of a keyframe"),
        ({"reach": 0.0}, "reach"),
    ],
)
def test_numbers_that_make_no_walk_are_refused(tmp_path, numbers, says):
    with pytest.raises(UserError, match=says):
        Walker(scene=tmp_path / "dog.xml", **numbers)


def test_a_robot_that_stands_above_its_root_is_refused(tmp_path):
    under = '<mujoco><worldbody><geom type="plane" size="0 0 1"/><body><freejoint/><geom pos="0 0 2" size="0.1"/>'
    under += '<body pos="0 0 2"><joint name="j"/><geom size="0.1" pos="0.3 0 0"/></body></body></worldbody>'
    under += '<actuator><position joint="j"/></actuator></mujoco>'
    with pytest.raises(UserError, match=r"the root is 1.9 m under the floor when it stands: change its posture"):
        walking(tmp_path, under, posture={})


def test_a_control_step_that_is_no_multiple_of_the_files_is_refused(tmp_path):
    path = tmp_path / "dog.xml"
    path.write_text(robot())
    task = walking_task("dog", "walks", Walker(scene=path), control_dt=0.01, substeps=2)
    with pytest.raises(UserError, match=r"control_dt = 0.01 s is no multiple of the file's step of 0.004 s"):
        task.system()


@pytest.mark.parametrize(("solref", "step"), [("0.02 1", 4.0), ("0.001 1", 1.0)])
def test_soles_too_stiff_for_the_models_steps_meet_the_files_in_half_of_the_training(tmp_path, solref, step):
    path = tmp_path / "dog.xml"
    path.write_text(robot(FLOOR.replace("/>", f' solref="{solref}" priority="1"/>')).replace("0.004", "0.001"))
    task = walking_task("dog", "walks", Walker(scene=path, posture=POSTURE))
    assert configure("loop", task).other == "auto"
    config = configure("shac", task, {"environments": 4, "horizon": 2})
    trainer = SHAC(task.mdp(), nominal_model(task, threads=1), config)
    both = trainer.moving
    assert isinstance(both, ComplementarityModel)
    split = both.stepper
    assert isinstance(split, SplitStepper)
    assert split.share == 0.5
    assert [round(1e3 * s.options["h"], 9) for s in (split.own, split.other)] == [4.0, step]
    assert math.isfinite(trainer.update()["gradient_norm"])


def test_from_a_file_that_defines_a_task_to_a_policy_in_mujoco(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("cmbrl.walking.EPISODE", 1.0)
    (tmp_path / "dog.xml").write_text(robot())
    (tmp_path / "dog.py").write_text(
        "from pathlib import Path\nfrom cmbrl.walking import Walker, walking_task\n"
        "WALKER = Walker(scene=Path(__file__).with_name('dog.xml'),"
        f" posture={POSTURE!r})\nTASK = walking_task('dog', 'walks', WALKER)\n"
    )
    sizes = ["--set", "environments=16", "--threads", "1"]
    train = ["train", "dog.py", "--algorithm", "shac", "--model", "nominal", "--iterations", "2", "--out", "run"]
    assert main([*train, *sizes]) == 0
    monkeypatch.chdir("/")  # the policy knows where its task is
    capsys.readouterr()
    assert main(["evaluate", str(tmp_path / "run"), "--real", "--json", "--episodes", "2"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["task"] == str(tmp_path / "dog.py")
    assert main(["record", str(tmp_path / "dog.py"), "--steps", "20", "--out", str(tmp_path / "log.npz")]) == 0
