"""Split damping: a step finds its impulses as MuJoCo does, with the damping of the start; its derivatives are exact."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.bench.states import Ranges, random_states
from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.contact import Barrier, Exact, Gaussian
from cmbrl.contact.smoothing import Smoothing
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

from .test_adjoint import mismatch_at

OPTION = (
    '<option timestep=".004" integrator="{integrator}" cone="elliptic" tolerance="1e-14" iterations="300" '
    'ls_tolerance="1e-14" ls_iterations="100" {option}/><compiler angle="radian"/>'
)
LEG = """<body name="{name}" pos="{x} 0 0"><joint name="{name}" axis="0 1 0" damping="1.5" armature=".01" range="-.8 .8"
frictionloss=".2" {joint}/><geom type="capsule" size=".03" fromto="0 0 0 0 0 -.2" mass=".4" contype="0"/>
<site name="{name}" pos=".02 0 -.1"/><body name="{name}_shin" pos="0 0 -.2"><joint name="{name}_knee" axis="{axis}"
damping="2" range="-1 1"/><geom name="{name}_foot" size=".03" pos="0 0 -.2" mass=".2"/>
<site name="{name}_foot" pos=".05 0 -.1"/></body></body>"""
FLOOR = '<geom type="plane" size="3 3 .1"/>'
TRUNK = '<geom type="box" size=".15 .1 .03" mass="2" contype="0" conaffinity="0"/><site name="trunk" pos="0 .1 .05"/>'
SERVO = """<actuator><position joint="left_knee" kp="20" kv="1"/><velocity joint="right_knee" kv="3"/>
<motor joint="left" gear="4"/></actuator>"""
STRING = """<tendon><spatial name="t" damping="3" stiffness="20" springlength=".1" frictionloss=".1">
<site site="trunk"/><site site="left_foot"/></spatial><fixed name="f" damping=".8" range="-.3 .3">
<joint joint="left" coef="1"/><joint joint="right" coef="-.5"/></fixed></tendon>"""
TIES = """<equality><joint joint1="right_knee" joint2="left_knee" polycoef="0 .8 .1" solref=".02 1"/>
<connect body1="right_shin" body2="trunk" anchor=".05 0 .1" solref=".03 1"/></equality>"""
BALL = """<body name="tail" pos="-.2 0 .05"><joint name="tail" type="ball" damping=".2"/>
<geom type="capsule" size=".02 .1" pos="-.1 0 0" mass=".3" contype="0" conaffinity="0"/></body>"""


def robot(axis: str, root: str = "<freejoint/>", more: str = "", joint: str = "") -> str:
    legs = "".join(LEG.format(name=name, x=x, axis=axis, joint=joint) for name, x in (("left", 0.1), ("right", -0.1)))
    return f'{FLOOR}<body name="trunk" pos="0 0 .42">{root}{TRUNK}{legs}{more}</body>'


PLANAR = """<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<joint name="p" axis="0 1 0"/>"""
CASES = {  # world, rest, attributes of the option
    "planar": (robot("0 1 0", PLANAR), SERVO, ""),
    "servos": (robot("1 0 0"), SERVO, ""),
    "tendons": (robot("1 0 0"), SERVO + STRING, ""),
    "ties": (robot("0 1 0"), SERVO + TIES, ""),
    "ball joint in a fluid": (robot("1 0 0", more=BALL), SERVO, 'density="30" viscosity=".05" wind=".5 0 0"'),
    "powers": (robot("1 0 0", joint='damping="1.5 .4 .1"').replace('damping="1.5" ', ""), SERVO, ""),
}
INTEGRATORS = ("Euler", "implicitfast")


def write(folder: Path, case: str, integrator: str, condim: int = 3) -> Path:
    world, rest, option = CASES[case]
    file = folder / "robot.xml"
    text = OPTION.format(integrator=integrator, option=option) + f'<default><geom condim="{condim}"/></default>'
    file.write_text(f"<mujoco>{text}<worldbody>{world}</worldbody>{rest}</mujoco>", encoding="utf-8")
    return file


def states(scene: Scene, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return random_states(scene, count, np.random.default_rng(seed), Ranges(gap=(-0.004, 0.002), speed=1.0))


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("case", CASES)
def test_a_step_is_mujocos(case: str, integrator: str, tmp_path: Path) -> None:
    """In contact, at limits, with dry friction and ties; damping that is coupled is off by far more.

    Without friction of contacts, whose law is another one than MuJoCo's.
    """
    file = write(tmp_path, case, integrator, condim=1)
    scene, theirs = Scene.from_mjcf(file), mujoco.MjModel.from_xml_path(str(file))
    q, v, u = states(scene, 60)
    data, expected, touching = mujoco.MjData(theirs), np.empty_like(v), 0
    for k in range(len(q)):
        mujoco.mj_resetData(theirs, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = q[k], v[k], u[k]
        mujoco.mj_step(theirs, data)
        expected[k] = data.qvel
        touching += data.ncon > 0
    assert touching > 20
    errors = {}
    for damping in ("coupled", "split"):
        r = ComplementarityModel(scene, damping=damping, smoothing=Exact(1e-7)).predict(q, v, u)
        size = np.linalg.norm(expected - v, axis=1)
        errors[damping] = float(np.median(np.linalg.norm(r.v_next - expected, axis=1) / size))
    assert errors["split"] < 1e-4, errors
    assert errors["coupled"] > 30 * errors["split"], errors


@pytest.mark.parametrize("smoothing", [Barrier(1e-4), Gaussian(length=0.01, floor=1e-6)])
@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("case", CASES)
def test_derivatives_are_those_of_the_step(case: str, integrator: str, smoothing: Smoothing, tmp_path: Path) -> None:
    """Columns of state, control and parameters against differences, over three substeps too; and their transpose."""
    scene = Scene.from_mjcf(write(tmp_path, case, integrator))
    for substeps, stepping in ((1, "semi-implicit"), (3, "midpoint")):
        model = ComplementarityModel(
            scene, substeps, damping="split", smoothing=smoothing, path_tolerance=1e-12, integrator=stepping
        )
        q, v, u = states(scene, 6, 1)
        row = compare(model, q, v, u, 60)
        assert {"q", "v", "u", "damping", "mass", "kd"} <= set(row["kinds"])
        assert row["median"] <= 1e-6, row
        assert row["worst"] <= 1e-4, row
        assert row["across_kinks"] + row["vague"] <= 0.1 * row["columns"], row
        assert mismatch_at(model, q, v, u, np.random.default_rng(2)) < 1e-9


def test_long_steps_and_other_laws_are_coupled(tmp_path: Path) -> None:
    """A saved model keeps its choice, and one of an older version is coupled."""
    file = write(tmp_path, "planar", "Euler")
    scene = Scene.from_mjcf(file)
    model = ComplementarityModel(scene)
    assert model.damping == "split"
    assert model.with_settings(time_step=0.01).damping == "coupled"
    assert model.with_settings(time_step=0.01).with_settings(time_step=0.002).damping == "split"
    assert ComplementarityModel(Scene.from_mjcf(file, contact_law="rigid")).damping == "coupled"
    assert ComplementarityModel.from_config(scene, model.to_config()).damping == "split"
    old = {name: value for name, value in model.to_config().items() if name != "damping"}
    assert ComplementarityModel.from_config(scene, old).damping == "coupled"
    strong = file.read_text()
    file.write_text(strong.replace('damping="1.5"', 'damping="1e4"'))
    assert ComplementarityModel(Scene.from_mjcf(file)).damping == "split"
    assert ComplementarityModel(Scene.from_mjcf(file), look_ahead=True).damping == "coupled"
    file.write_text(strong.replace("Euler", "RK4"))
    assert ComplementarityModel(Scene.from_mjcf(file)).damping == "coupled"


def test_what_does_not_go_together_is_refused(tmp_path: Path) -> None:
    file = write(tmp_path, "planar", "Euler")
    with pytest.raises(UserError, match="rigid contacts"):
        ComplementarityModel(Scene.from_mjcf(file, contact_law="rigid"), damping="split")
    with pytest.raises(UserError, match="implicit springs"):
        ComplementarityModel(Scene.from_mjcf(file), damping="split", implicit_springs=True)
    with pytest.raises(UserError, match="damping"):
        ComplementarityModel(Scene.from_mjcf(file), damping="explicit")
