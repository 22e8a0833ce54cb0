"""Actuators between sites, on slider-cranks and on ball and free joints: steps are MuJoCo's, derivatives are right."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.info.report import describe
from cmbrl.scene.writing.fitted_file import fitted_file

from .free_steps import assert_steps_are_mujocos, states

WORLD = """<mujoco><option timestep=".005" integrator="{integrator}"/><default><geom contype="0" mass=".7"/></default>
<worldbody><site name="w" pos=".1 .2 .3" euler="20 30 40"/>
<body name="a" pos="0 0 1"><joint name="a" axis="0 1 0"/><joint type="slide" axis="1 0 0" damping=".4"/>
<geom type="box" size=".1 .05 .03"/><site name="a" pos="0 .1 .1" euler="40 0 9"/>
<body name="b" pos=".3 0 0"><joint type="ball" name="ball"/><geom type="box" size=".1 .04 .05" pos=".1 0 0"/>
<site name="b" pos=".2 .1 0" euler="10 -50 30"/>
<body pos=".2 0 0"><joint axis="0 0 1"/><geom size=".05" pos=".1 0 0"/><site name="d" pos=".1 0 0" euler="0 9 0"/>
</body></body>
<body name="c" pos="0 .3 0"><joint axis="1 .3 0" armature=".01"/><geom type="box" size=".1 .06 .05" pos=".1 .1 0"/>
<site name="c" pos=".2 .1 0" euler="30 10 -20"/></body></body>
<body name="f" pos="1 0 1"><freejoint name="free"/><geom type="box" size=".1 .06 .05"/>
<site name="f" pos=".1 0 .1" euler="10 10 -20"/></body></worldbody><actuator>{actuators}</actuator></mujoco>"""
SERVO = 'gainprm="8" biastype="affine" biasprm=".1 -8 -.6"'
CASES = {
    "between sites": f'<general site="d" refsite="c" gear="1 .5 -.3 .2 .4 .3" {SERVO}/>',
    "to the world": f'<general site="d" refsite="w" gear="1 .5 -.3 0 0 0" {SERVO}/>'
    '<motor site="f" refsite="w" gear="1 2 3 .3 .2 .1"/>',
    "to one that carries it": f'<general site="d" refsite="a" gear="0 .5 -.3 .2 .4 .3" {SERVO} forcerange="-3 3"/>',
    "from one that it carries": f'<general site="a" refsite="d" gear="0 .5 -.3 .2 .4 .3" {SERVO}/>',
    "rotation, whose target wraps": f'<general site="d" refsite="c" gear="0 0 0 .2 .4 .3" {SERVO} ctrlrange="-9 9"/>',
    "damping of a site": '<general site="d" gear="1 2 0 .3 0 .1" biastype="affine" biasprm="0 0 -.6"/>',
    "slider-cranks": f'<general cranksite="d" slidersite="c" cranklength=".5" gear="1.5" {SERVO}/>'
    f'<general cranksite="b" slidersite="w" cranklength="3" {SERVO}/>',
    "ball servos": '<position joint="ball" gear="1 .3 .2" kp="8" kv=".5"/>'
    '<velocity joint="ball" gear="0 1 0" kv=".7"/>',
    "ball servo in the parent": '<position jointinparent="ball" gear="1 .3 .2" kp="8" kv=".5"/>'
    '<motor jointinparent="ball" gear="0 1 2"/>',
    "free joint": '<velocity joint="free" gear="1 .3 .2 .1 .3 .2" kv=".7"/>'
    '<motor jointinparent="free" gear="1 2 3 .1 .3 .2"/>'
    '<position jointinparent="free" gear="0 .1 0 1 2 3" kp="3" kv=".2"/>',
    "gain by velocity": '<general site="d" refsite="c" gear="1 .5 -.3 .2 .4 .3" gaintype="affine" gainprm="1 .3 -.1"/>',
    "a load on all dofs": '<motor joint="ball" gear="2 1 0" armature=".01" damping=".05"/>'
    f'<general jointinparent="free" gear=".5 0 0 0 0 1" {SERVO} armature=".1" damping=".2"/>',
    "cogging of what has no length": '<dcmotor site="d" gear="1 2 0 .3 0 .1" motorconst=".3" resistance="2" '
    'cogging="2 6 .4"/>',
    "through a filter": f'<general site="d" refsite="c" gear="1 .5 -.3 0 0 0" '
    f'dyntype="filterexact" dynprm=".03" {SERVO}/>',
}


def scene_of(tmp_path: Path, actuators: str, integrator: str) -> tuple[Scene, mujoco.MjModel]:
    path = tmp_path / "robot.xml"
    path.write_text(WORLD.format(integrator=integrator, actuators=actuators), encoding="utf-8")
    return Scene.from_mjcf(path), mujoco.MjModel.from_xml_path(str(path))


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "implicit", "RK4"])
@pytest.mark.parametrize("case", CASES)
def test_steps_are_those_of_mujoco(tmp_path: Path, case: str, integrator: str) -> None:
    scene, model = scene_of(tmp_path, CASES[case], integrator)
    assert_steps_are_mujocos(ComplementarityModel(scene, integrator="rk4" if integrator == "RK4" else None), model, 30)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
@pytest.mark.parametrize("case", CASES)
def test_derivatives(tmp_path: Path, case: str, integrator: str) -> None:
    scene, _ = scene_of(tmp_path, CASES[case], integrator)
    row = compare(ComplementarityModel(scene), *states(scene, 6), 30)
    assert {"q", "v", "u"} <= set(row["kinds"])
    assert row["worst"] <= 1e-6, row


def test_report_says_what_moves_along_the_line(tmp_path: Path) -> None:
    scene, _ = scene_of(tmp_path, CASES["slider-cranks"] + CASES["free joint"], "Euler")
    text = describe(scene)
    assert "a slider-crank of" in text
    assert "free.x to free.rz" in text


@pytest.mark.parametrize("case", ["between sites", "slider-cranks", "ball servo in the parent"])
def test_fitted_gains_come_back(tmp_path: Path, case: str) -> None:
    scene, _ = scene_of(tmp_path, CASES[case], "Euler")
    theta = scene.parameter_vector()
    theta[[k for k, p in enumerate(scene.parameters) if p.group in ("kp", "kd", "gear")]] *= 1.3
    written = fitted_file(scene, theta)
    assert written.missing == ()
    held = Scene.from_mjcf(written.text)
    for field in ("gain", "bias1", "bias2"):
        place = scene.layout.actuator(0, field)
        np.testing.assert_allclose(held.core.P[place], scene.physical_vector(theta)[place], rtol=1e-9)
