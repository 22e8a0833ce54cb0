"""Equality constraints and tendons: steps are MuJoCo's, derivatives the step's, and mechanisms hold together."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.bench.states import Ranges, random_states
from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.contact import Barrier, Exact, Gaussian
from cmbrl.contact.smoothing import Smoothing
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.step_settings import INTEGRATORS
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

from .test_adjoint import mismatch_at

OPTION = (
    '<option timestep="0.002" integrator="{}" tolerance="1e-14" iterations="300" ls_tolerance="1e-14" '
    'ls_iterations="100" cone="elliptic"/>'
)
HARD = 'solref=".004 1" solimp=".99 .999 .001"'
SOFT = 'solref=".02 .7" solimp=".8 .95 .01"'  # so soft that the impedance changes with the residual
PLANAR, SPATIAL = ["0 1 0"], ["0 1 0", "1 0 1", "0 0 1"]
MENAGERIE = Path(__file__).parents[3] / "shared/models/menagerie"  # beside the checkout, as G1
TIED = ("agility_cassie", "aloha", "franka_emika_panda", "pal_talos", "toddlerbot_2xc", "robotiq_2f85_v4")


def arm(axes: list[str], links: int, name: str = "a", site: str = "") -> str:
    """Bars on hinges, without contact; ``site`` goes to the second one."""
    out = ""
    for k in reversed(range(links)):
        out = (
            f'<body name="{name}{k}" pos="{".3 .05 0" if k else "0 0 0"}"><joint name="{name}{k}" '
            f'axis="{axes[k % len(axes)]}"/><geom type="capsule" fromto="0 0 0 .3 .05 0" size=".03" mass=".5" '
            f'contype="0" conaffinity="0"/><site name="{name}{k}" pos=".1 {-0.05 * k} .12"/>'
            f"{site if k == 1 else ''}{out}</body>"
        )
    return out


FREE = (
    '<body name="f" pos=".5 .2 .1" quat="1 .3 .2 -.4"><freejoint/><geom size=".05" mass=".3" contype="0" '
    'conaffinity="0"/><site name="t" pos=".1 .1 .1" quat="1 .5 .1 -.2"/></body>'
)
FRAME = '<site name="s" pos=".1 .2 .1" quat="1 .2 .1 .4"/>'
SPREAD = '<joint joint="a0" coef="1.5"/><joint joint="a1" coef="-.5"/><joint joint="{}" coef=".4"/>'


HUNG = '<site name="w" pos=".2 0 .5"/>'


def string(attributes: str, *path: str) -> str:
    """A tendon through sites; a number in its path is a pulley's divisor."""
    points = "".join(f'<pulley divisor="{x}"/>' if x.isdigit() else f'<site site="{x}"/>' for x in path)
    return f'<tendon><spatial name="t" {attributes}>{points}</spatial></tendon>'


def tendon(attributes: str, last: str = "a2") -> str:
    return f'<tendon><fixed name="t" {attributes}>{SPREAD.format(last)}</fixed></tendon>'


def equality(*rows: str) -> str:
    return f"<equality>{''.join(rows)}</equality>"


CASES = {  # world, rest
    "mimic": (
        arm(PLANAR, 3),
        equality(f'<joint joint1="a0" joint2="a1" polycoef=".1 .8 .2 -.1 .05" {SOFT}/>'),
    ),
    "mimic of two arms, and a fixed joint": (
        arm(SPATIAL, 3) + arm(SPATIAL, 2, "b"),
        equality(f'<joint joint1="a0" joint2="b1" polycoef=".1 .8 .2" {SOFT}/>', '<joint joint1="a2" polycoef=".3"/>'),
    ),
    "hard mimic": (
        arm(SPATIAL, 3),
        equality('<joint joint1="a0" joint2="a2" solimp=".9999 .9999 .001"/>'),
    ),
    "planar connect": (
        arm(PLANAR, 4),
        equality(
            f'<connect body1="a3" body2="a0" anchor=".1 0 .2" {SOFT}/>', '<connect body1="a2" anchor="0 .02 .1"/>'
        ),
    ),
    "connect": (
        arm(SPATIAL, 4) + FREE,
        equality(
            f'<connect body1="a3" body2="f" anchor=".1 0 .2" {SOFT}/>',
            f'<connect body1="a2" body2="a0" anchor="0 .02 .1" {SOFT}/><connect body1="f" anchor=".1 .2 .3"/>',
        ),
    ),
    "planar weld": (
        arm(PLANAR, 4),
        equality(
            f'<weld body1="a3" body2="a1" anchor=".1 0 .2" torquescale=".7" {SOFT}/>',
            f'<weld body1="a2" relpose=".1 -.1 .3 1 0 .3 0" {SOFT}/>',
        ),
    ),
    "weld": (
        arm(SPATIAL, 4) + FREE,
        equality(
            f'<weld body1="a3" body2="f" anchor=".1 0 .2" torquescale=".7" {SOFT}/>',
            f'<weld body1="f" relpose=".1 .2 .3 1 .2 .3 .4" {SOFT}/><weld body1="a0" body2="a3" {SOFT}/>',
        ),
    ),
    "sites": (
        arm(SPATIAL, 3, site=FRAME) + FREE,
        equality(f'<weld site1="s" site2="t" {SOFT}/><connect site1="t" site2="s" {SOFT}/>'),
    ),
    "tendon spring": (
        arm(SPATIAL, 3),
        tendon('stiffness="3" damping=".2" springlength="-.1 .2" armature=".02"'),
    ),
    "tendon limit": (
        arm(SPATIAL, 2) + arm(SPATIAL, 1, "b"),
        tendon('stiffness="2" springlength=".15" limited="true" range="-.4 .5" solreflimit=".03 .8"', "b0"),
    ),
    "tendon equality": (
        arm(SPATIAL, 2) + arm(SPATIAL, 2, "b"),
        tendon("", "b0").replace("</tendon>", '<fixed name="r"><joint joint="b1" coef="2"/></fixed></tendon>')
        + equality(f'<tendon tendon1="r" tendon2="t" polycoef=".1 .5 .2" {SOFT}/>'),
    ),
    "tendon held": (arm(PLANAR, 3), tendon("") + equality('<tendon tendon1="t" polycoef=".2"/>')),
    "tendon actuators": (
        arm(PLANAR, 3),
        tendon("")
        + '<actuator><position tendon="t" kp="5" kv=".3" gear="2"/><motor tendon="t"/>'
        + '<position tendon="t" kp="9" forcerange="-1 1"/></actuator>',
    ),
    "string": (
        HUNG + arm(PLANAR, 3),
        string(
            'stiffness="30" springlength=".3 .4" limited="true" range=".2 .6" solreflimit=".03 .8"', "w", "a1", "a2"
        ),
    ),
    "tied strings": (
        HUNG + arm(SPATIAL, 4),
        string("", "w", "a1", "a2").replace(
            "</tendon>", '<fixed name="r"><joint joint="a3" coef="2"/></fixed></tendon>'
        )
        + equality(
            f'<tendon tendon1="t" tendon2="r" polycoef=".1 .5 .2" {SOFT}/>',
            f'<tendon tendon1="r" tendon2="t" polycoef=".1 .5 .2" {SOFT}/>',
        ),
    ),
    "string over a pulley": (
        HUNG + arm(SPATIAL, 4) + FREE,
        string('limited="true" range=".2 1.2"', "w", "a1", "t", "2", "a0", "a3", "w")
        + '<actuator><position tendon="t" kp="5"/><motor tendon="t" gear="2"/></actuator>',
    ),
}


def write(folder: Path, world: str, rest: str, integrator: str = "implicitfast") -> Path:
    file = folder / "scene.xml"
    text = f"<mujoco>{OPTION.format(integrator)}<worldbody>{world}</worldbody>{rest}</mujoco>"
    file.write_text(text, encoding="utf-8")
    return file


def states_of(scene: Scene, count: int, spread: float, speed: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    q = scene.integrate(np.tile(scene.q0, (count, 1)), spread * rng.normal(size=(count, scene.nv)))
    return q, speed * rng.normal(size=(count, scene.nv)), rng.normal(size=(count, scene.nu))


def errors(scene: Scene, file: Path, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Largest differences (B,) of the next velocity from MuJoCo's, relative to the fastest coordinate (at least 1)."""
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    step = ComplementarityModel(scene, smoothing=Exact()).predict(q, v, u)
    assert (step.status == SolverStatus.CONVERGED).all()
    out = []
    for k in range(len(q)):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = q[k], v[k], u[k]
        mujoco.mj_step(model, data)
        out.append(np.abs(step.v_next[k] - data.qvel).max() / max(1.0, np.abs(data.qvel).max()))
    return np.array(out)


def looks_ahead() -> bool:
    """Whether this MuJoCo's connects and welds look at how their Jacobian changes, as ours do; found by trying."""
    body = '<body name="{}"><joint axis="0 1 0"/><geom size=".1" pos="{} 0 0"/></body>'
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{body.format('a', '.5')}</worldbody>"
        '<equality><connect body1="a" anchor="1 0 0"/></equality></mujoco>'
    )
    data = mujoco.MjData(model)
    data.qvel[:] = 1.0
    mujoco.mj_forward(model, data)
    return bool(np.abs(data.efc_aref[:3] + data.efc_KBIP[:3, 1] * data.efc_vel[:3]).max() > 0.5)


def skip_if_another_law(rest: str) -> None:
    if ("<connect" in rest or "<weld" in rest) and not looks_ahead():
        pytest.skip("this version of MuJoCo does not look at how the Jacobian of a connect changes")


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("spread", [0.02, 0.5])
def test_a_step_is_mujocos(name: str, spread: float, tmp_path: Path) -> None:
    """Near the constraint, and far from it."""
    skip_if_another_law(CASES[name][1])
    file = write(tmp_path, *CASES[name])
    scene = Scene.from_mjcf(file)
    assert scene.planar == ("0 1 0" in CASES[name][0] and "1 0 1" not in CASES[name][0])
    assert errors(scene, file, *states_of(scene, 24, spread)).max() < 1e-8


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
def test_damped_tendons_and_gains(integrator: str, tmp_path: Path) -> None:
    """Damping of tendons is explicit in MuJoCo's Euler, implicit in its implicit integrators."""
    rest = tendon('damping=".5" armature=".01"') + '<actuator><velocity tendon="t" kv=".3"/></actuator>'
    file = write(tmp_path, arm(SPATIAL, 3), rest, integrator)
    scene = Scene.from_mjcf(file)
    assert errors(scene, file, *states_of(scene, 24, 0.5)).max() < 1e-10


@pytest.mark.parametrize("rest", [tendon('frictionloss=".3"'), string('frictionloss=".3"', "w", "a1", "a2")])
def test_friction_of_a_tendon(rest: str, tmp_path: Path) -> None:
    file = write(tmp_path, HUNG + arm(PLANAR, 3), rest)
    scene = Scene.from_mjcf(file)
    assert errors(scene, file, *states_of(scene, 24, 0.5, 0.1)).max() < 1e-4  # dry friction yields a little


@pytest.mark.parametrize("robot", TIED)
def test_robots_of_menagerie(robot: str, tmp_path: Path) -> None:
    """Closed legs, grippers, tendons between fingers; without what is modelled in another way."""
    skip_if_another_law("<connect")
    if not (MENAGERIE / robot).exists():
        pytest.skip("no MuJoCo Menagerie at ../shared/models/menagerie")
    folder = tmp_path / robot
    shutil.copytree(MENAGERIE / robot, folder)
    file = folder / "robot.xml"
    file.chmod(0o644)
    off = '<option integrator="Euler" viscosity="0" density="0"><flag contact="disable" actuation="disable" '
    off += 'damper="disable" limit="disable" '
    off += 'frictionloss="disable"/></option></mujoco>'
    text = file.read_text(encoding="utf-8")
    file.write_text(text[: text.rindex("</mujoco>")] + off, encoding="utf-8")
    scene = Scene.from_mjcf(file, ignore="joint_force_range")  # without actuation there is none
    assert scene.core.ntie
    q, v, _ = states_of(scene, 8, 0.02, 0.3)
    found = errors(scene, file, q, v, np.zeros((8, scene.nu)))
    assert np.median(found) < 1e-6, found


@pytest.mark.parametrize("name", CASES)
def test_derivatives(name: str, tmp_path: Path) -> None:
    scene = Scene.from_mjcf(write(tmp_path, *CASES[name]))
    model = ComplementarityModel(scene, smoothing=Barrier(1e-4), path_tolerance=1e-12)
    q, v, u = states_of(scene, 8, 0.3)
    found = compare(model, q, v, u, 20)
    assert found["median"] < 1e-6, found
    assert found["worst"] < 1e-4, found
    assert found["unsolved"] == 0
    assert mismatch_at(model, q, v, u, np.random.default_rng(0)) < 1e-10


def everything(axes: list[str]) -> tuple[str, str]:
    """A linkage over the floor with limits, dry friction, a mimic, a weld, a connect, and a tendon that does it all."""
    out = ""
    for k in reversed(range(4)):
        touches = int(k == 1)
        out = (
            f'<body pos="{".3 0 0" if k else "0 0 .4"}" name="l{k}"><joint name="a{k}" axis="{axes[k % len(axes)]}" '
            f'range="-30 30" limited="{"true" if k == 1 else "false"}" damping=".02" '
            f'frictionloss="{0.05 if k == 2 else 0}"/><geom type="capsule" fromto=".05 0 0 .25 0 .03" size=".05" '
            f'mass=".5" contype="{touches}" conaffinity="{touches}"/>{out}</body>'
        )
    root = "<freejoint/>"
    if len(axes) == 1:
        root = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>'
    world = (
        f'<geom type="plane" size="3 3 .1" friction=".6"/>{out}'
        f'<body name="f" pos=".9 0 .2">{root}<geom size=".1" mass=".4"/></body>'
    )
    pulls = 'stiffness="3" springlength="-.1 .1" damping=".1" limited="true" range="-.2 .3" frictionloss=".05"'
    rest = (
        f'<tendon><fixed name="t" {pulls} armature=".01"><joint joint="a0" coef="1.5"/><joint joint="a3" coef="-.5"/>'
        "</fixed></tendon>"
        + equality(
            f'<weld body1="l3" body2="f" anchor="0 0 0" torquescale=".3" {SOFT}/>',
            f'<connect body1="l2" anchor=".1 0 -.2" {SOFT}/><joint joint1="a1" joint2="a3" polycoef="0 .6 .1"/>',
        )
        + '<actuator><position tendon="t" kp="4" kv=".2"/><motor joint="a0"/></actuator>'
        + '<contact><exclude body1="l3" body2="f"/></contact>'
    )
    return world, rest


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("smoothing", [Barrier(1e-4), Gaussian(0.01, floor=1e-6)], ids=["kappa", "gaussian"])
@pytest.mark.parametrize("axes", [PLANAR, ["0 1 0", "0 1 0", "1 1 0"]], ids=["planar", "spatial"])
@pytest.mark.parametrize("law", ["mujoco", "rigid"])
def test_derivatives_with_contacts(
    law: str, axes: list[str], smoothing: Smoothing, integrator: str, tmp_path: Path
) -> None:
    scene = Scene.from_mjcf(write(tmp_path, *everything(axes)), contact_law=law)
    assert scene.planar == (len(axes) == 1)
    model = ComplementarityModel(scene, smoothing=smoothing, integrator=integrator, path_tolerance=1e-12)
    q, v, u = random_states(scene, 6, np.random.default_rng(0), Ranges(gap=(-0.005, 0.005), speed=1.0))
    found = compare(model, q, v, u, 30)
    assert found["median"] < 1e-6, found
    assert found["worst"] < 1e-4, found
    assert found["unsolved"] == 0
    assert mismatch_at(model, q, v, u, np.random.default_rng(0)) < 1e-7


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("spatial", [False, True], ids=["planar", "spatial"])
def test_derivatives_of_bounces(spatial: bool, integrator: str, tmp_path: Path) -> None:
    """Of two rods that a connect ties: impacts act late, with the mass matrix that holds the tie."""
    planar = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>'
    rods = "".join(
        f'<body name="b{k}" pos="{0.3 * k} 0 {0.3 + 0.1 * k}">{"<freejoint/>" if spatial else planar}'
        f'<geom type="capsule" fromto="-.1 0 0 .1 0 .02" size=".04" mass="{0.4 + k}"/>'
        f'<site name="b{k}" pos="{0.1 - 0.05 * k} 0 .03"/></body>'
        for k in range(2)
    )
    rest = equality(f'<connect body1="b0" body2="b1" anchor=".15 0 .05" {SOFT}/>')
    rest += string('damping=".5" stiffness="20" springlength=".1"', "b0", "b1")
    file = write(tmp_path, f'<geom type="plane" size="3 3 .1" friction=".6"/>{rods}', rest)
    scene = Scene.from_mjcf(file, contact_law="rigid")
    theta = scene.parameter_vector()
    theta[[p.group == "restitution" for p in scene.parameters]] = 0.5
    model = ComplementarityModel(scene, smoothing=Barrier(1e-4), integrator=integrator, parameters=theta)
    model = model.with_settings(path_tolerance=1e-12)
    q, v, u = random_states(scene, 12, np.random.default_rng(0), Ranges(gap=(0.001, 0.005), speed=6.0))
    found = compare(model, q, v, u, 30)
    assert found["median"] < 1e-6, found
    assert found["worst"] < 1e-4, found
    assert mismatch_at(model, q, v, u, np.random.default_rng(0)) < 1e-6


# Mechanisms


def roll(scene: Scene, steps: int, u: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """States after each of ``steps`` steps under the constant control u, from rest at q0."""
    model = ComplementarityModel(scene, smoothing=Exact())
    q, v = scene.q0[None], np.zeros((1, scene.nv))
    for _ in range(steps):
        r = model.predict(q, v, u[None])
        assert r.status[0] == SolverStatus.CONVERGED
        q, v = r.q_next, r.v_next
        yield q[0], v[0]


def mujocos_end(file: Path, steps: int, u: np.ndarray) -> np.ndarray:
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    data.ctrl[:] = u
    for _ in range(steps):
        mujoco.mj_step(model, data)
    return np.array(data.qpos)


def test_four_bar_linkage(tmp_path: Path) -> None:
    """A crank and a rocker, joined by a connect, that a motor turns: the joint stays shut, and all is as in MuJoCo."""
    skip_if_another_law("<connect")
    bar = (
        '<body name="{}" pos="{}"><joint name="{}" axis="0 1 0"/>'
        '<geom type="capsule" fromto="0 0 0 {}" size=".01" mass=".2" contype="0"/>{}</body>'
    )
    coupler = bar.format("coupler", "0 0 .1", "c", ".3 0 .2", "")
    world = bar.format("crank", "0 0 0", "crank", "0 0 .1", coupler) + bar.format("rocker", ".3 0 0", "r", "0 0 .3", "")
    rest = equality(f'<connect body1="coupler" body2="rocker" anchor=".3 0 .2" {HARD}/>')
    rest += '<actuator><motor joint="crank"/></actuator>'
    file = write(tmp_path, world, rest)
    scene, u = Scene.from_mjcf(file), np.array([0.3])
    assert scene.planar
    ends = list(roll(scene, 100, u))
    assert abs(ends[-1][0][0]) > 0.5  # the crank has turned
    pos, rot = scene.body_poses(np.array([q for q, _ in ends]))
    away = pos[:, 1] + rot[:, 1] @ [0.3, 0.2] - pos[:, 2] - rot[:, 2] @ [0.0, 0.3]
    assert np.linalg.norm(away, axis=1).max() < 1e-3
    np.testing.assert_allclose(ends[-1][0], mujocos_end(file, 100, u), atol=1e-9)


def test_hanging_chain_of_connects(tmp_path: Path) -> None:
    """30 free rods, tied to each other and to the world, let go level: joints stay shut, no energy appears."""
    n, length = 30, 0.1
    rods = "".join(
        f'<body name="r{k}" pos="{(k + 0.5) * length} 0 0"><freejoint/><geom type="capsule" size=".01" mass=".1" '
        f'fromto="{-0.5 * length} 0 0 {0.5 * length} 0 0" contype="0"/></body>'
        for k in range(n)
    )
    ties = "".join(f'<connect body1="r{k}" body2="r{k - 1}" anchor="{-0.5 * length} 0 0" {HARD}/>' for k in range(1, n))
    file = write(tmp_path, rods, equality(f'<connect body1="r0" anchor="{-0.5 * length} 0 0" {HARD}/>', ties))
    scene = Scene.from_mjcf(file)
    model = ComplementarityModel(scene)
    ends = list(roll(scene, 300, np.zeros(0)))
    q, v = (np.array(part) for part in zip(*ends, strict=True))
    pos, rot = scene.body_poses(q)
    half = np.array([0.5 * length, 0.0, 0.0])
    left, right = pos - rot @ half, pos + rot @ half
    gaps = np.linalg.norm(left[:, 1:] - right[:, :-1], axis=2).max(), np.linalg.norm(left[:, 0], axis=1).max()
    assert max(gaps) < 0.004  # the softness of MuJoCo's defaults under the pull of all rods
    M = model.smooth_dynamics(q, v)["M"]
    energy = 0.5 * np.einsum("bi,bij,bj->b", v, M, v) + 9.81 * 0.1 * pos[:, :, 2].sum(axis=1)
    assert pos[-1, -1, 2] < -0.8  # it has fallen
    assert energy.max() < 0.05  # of 44 J to fall
    assert energy.min() > -4.5


def test_mimic_gripper_holds_a_ball(tmp_path: Path) -> None:
    """A motor closes one finger, the other follows by a joint equality; a ball between them stays in the air."""
    finger = (
        '<body name="{0}" pos="{1} 0 .3"><joint name="{0}" type="slide" axis="{2} 0 0" damping="1"/>'
        '<geom type="box" size=".01 .05 .05" mass=".1" friction="1" contype="2" conaffinity="0"/></body>'
    )
    ball = (
        '<body pos="0 0 .3"><freejoint/><geom size=".03" mass=".02" friction="1" conaffinity="2" contype="0"/></body>'
    )
    rest = equality('<joint joint1="left" joint2="right"/>') + '<actuator><motor joint="right"/></actuator>'
    world = finger.format("left", "-.045", "1") + finger.format("right", ".045", "-1") + ball
    scene = Scene.from_mjcf(write(tmp_path, world, rest))
    q = np.array([q for q, _ in roll(scene, 500, np.array([4.0]))])
    assert np.abs(q[:, 0] - q[:, 1]).max() < 2e-3
    assert 0.003 < q[-1, 0] < 0.007  # shut on the ball
    assert abs(q[-1, 4] - 0.3) < 0.01


def test_weld_holds_a_body(tmp_path: Path) -> None:
    skip_if_another_law("<weld")
    geom = '<geom type="box" size=".1 .2 .05" mass="2"/>'
    body = f'<body name="f" pos=".1 .2 .3" quat="1 .2 .3 .4"><freejoint/>{geom}</body>'
    file = write(tmp_path, body, equality(f'<weld body1="f" {HARD}/>'))
    scene = Scene.from_mjcf(file)
    end = list(roll(scene, 300, np.zeros(0)))[-1][0]
    assert np.abs(end[:3] - scene.q0[:3]).max() < 1e-4
    np.testing.assert_allclose(end, mujocos_end(file, 300, np.zeros(0)), atol=1e-9)


def test_tendon_shares_its_pull_between_fingers(tmp_path: Path) -> None:
    """One tendon over two fingers: when the first is at its limit the other goes on, as in an underactuated hand."""
    finger = (
        '<body pos="0 {1} 0"><joint name="{0}" axis="0 1 0" range="-1 {2}" limited="true" armature=".01"/>'
        '<geom type="capsule" fromto="0 0 0 .1 0 0" size=".01" mass=".05" contype="0"/></body>'
    )
    rest = (
        '<tendon><fixed name="t"><joint joint="x" coef=".02"/><joint joint="y" coef=".02"/></fixed></tendon>'
        '<actuator><position tendon="t" kp="200" kv="30"/></actuator>'
    )
    world = finger.format("x", "0", "0.2") + finger.format("y", ".1", "1.5")
    text = "<compiler angle='radian'/>" + OPTION.format("implicitfast").replace("/>", ' gravity="0 0 0"/>')
    file = tmp_path / "scene.xml"
    file.write_text(f"<mujoco>{text}<worldbody>{world}</worldbody>{rest}</mujoco>", encoding="utf-8")
    scene, u = Scene.from_mjcf(file), np.array([0.02])
    q = np.array([q for q, _ in roll(scene, 3000, u)])
    early = q[: np.argmax(q[:, 0] > 0.15)]
    assert np.abs(early[:, 0] - early[:, 1]).max() < 1e-6  # they share it
    assert q[:, 0].max() < 0.21
    assert abs(q[-1].sum() - 1.0) < 0.05  # length 0.02
    assert q[-1, 1] > 0.7


def test_limits_of_a_tendon(tmp_path: Path) -> None:
    """Two joints fall until their sum is at its limit, though neither has one of its own."""
    sum_of_both = '<joint joint="a0" coef="1"/><joint joint="a1" coef="1"/>'
    rest = f'<tendon><fixed name="t" limited="true" range="-2 .5" solreflimit=".004 1">{sum_of_both}'
    scene = Scene.from_mjcf(write(tmp_path, arm(PLANAR, 2), rest + "</fixed></tendon>"))
    assert scene.line_names[scene.core.lim_line[0]] == "t"
    q = np.array([q for q, _ in roll(scene, 600, np.zeros(0))])
    assert 0.5 < q.sum(axis=1).max() < 0.53
    assert q[:, 0].max() > 0.7


@pytest.mark.parametrize("name", CASES)
def test_wild_states_are_solved_or_flagged(name: str, tmp_path: Path) -> None:
    scene = Scene.from_mjcf(write(tmp_path, *CASES[name]))
    model = ComplementarityModel(scene)
    for spread, speed in ((3.0, 30.0), (1.0, 1e4), (100.0, 1.0)):
        r = model.predict(*states_of(scene, 40, spread, speed), jacobian=True)
        solved = r.status != SolverStatus.FAILED
        assert solved.mean() > 0.9
        assert r.jacobian is not None
        for values in (r.q_next, r.v_next, r.jacobian):
            assert np.isfinite(values[solved]).all()
