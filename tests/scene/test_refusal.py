"""Elements that are not modelled: refused in one line that names kind and element, or left out on demand and stated."""

from __future__ import annotations

import os
import re
from pathlib import Path

import mujoco
import pytest

from cmbrl.errors import UserError
from cmbrl.scene import Scene
from cmbrl.scene.info.report import describe
from cmbrl.scene.source.support import KINDS

from .conftest import GYMNASIUM, Load, worst_step

SITES = '<site name="s1"/><body name="m"><joint name="h"/><geom name="g" size=".1"/><site name="s2"/></body>'
BALL_JOINT = '<body><joint name="b" type="ball" {}/><geom size=".1"/></body>'
HINGE = '<body name="m" {}><joint name="h" {}/><geom name="g" size=".1"/></body>'
FAR = '<body><joint name="h" axis="0 1 0"/><joint axis="1 0 0"/><geom size=".1" pos=".3 0 0"/></body>'
FLOOR = '<geom name="f" type="plane" size="1 1 1"/>'
SLEEP = '<option><flag sleep="enable"/></option>'
DROP = '<body pos="0 0 1"><freejoint/><geom name="g" {}/></body>'


def actuator(tag: str, attributes: str) -> tuple[str, str]:
    return HINGE.format("", ""), f'<actuator><{tag} name="motor" joint="h" {attributes}/></actuator>'


CASES = {
    "tendon": (
        SITES,
        '<tendon><spatial name="t" armature="1"><site site="s1"/><site site="s2"/></spatial></tendon>',
        "t",
    ),
    "joint_polynomial": (BALL_JOINT.format('stiffness="1 2 3"'), "", "b"),
    "actuator_dynamics": (*actuator("general", 'dyntype="muscle" dynprm="1 1"'), "motor"),
    "actuator_bias": (
        HINGE.format("", ""),
        '<actuator><general name="motor" body="m" biastype="affine" biasprm="0 0 -1"/></actuator>',
        "motor",
    ),
    "sleep": ('<body name="b" sleep="init"><freejoint/><geom size=".1"/></body>', SLEEP, "b"),
    "geom_type": (
        DROP.format('size=".1"') + '<body name="lift"><joint/><geom name="f" type="hfield" hfield="h"/></body>',
        '<asset><hfield name="h" nrow="2" ncol="2" size="1 1 1 .1" elevation="0 0 0 1"/></asset>',
        "g - f",
    ),
}


@pytest.mark.parametrize("kind", CASES)
def test_refused_by_name_or_ignored(kind: str, load: Load) -> None:
    world, rest, name = CASES[kind]
    with pytest.raises(UserError) as caught:
        load(world, rest)
    message = str(caught.value)
    assert "\n" not in message
    assert kind in message
    assert name in message
    assert f"--ignore {kind}" in message
    scene, model = load(world, rest, ignore=[kind])
    assert {x.kind for x in scene.left_out} - {"tendon"} == {kind} - {"tendon"}
    assert scene.nu == model.nu
    assert kind in describe(scene)


STILL = '<spatial name="t"><site site="w1"/><site site="w2"/></spatial>'
CANCELS = '<fixed name="t" stiffness="9"><joint joint="h" coef="1"/><joint joint="h" coef="-1"/></fixed>'
DRIVE = '<actuator><position name="e" tendon="t" kp="2" timeconst=".1"/></actuator>'


@pytest.mark.parametrize("tendon", [STILL, CANCELS])
@pytest.mark.parametrize(
    ("rest", "why"),
    [
        (DRIVE, "no joint moves it"),
        ('<equality><tendon name="e" tendon1="t" polycoef=".1 0 0 0 0"/></equality>', "no joint moves what it ties"),
        ('<equality><tendon name="e" tendon1="moves" tendon2="t" polycoef=".1 1 0 0 0"/></equality>', None),
    ],
)
def test_what_acts_on_a_tendon_that_nothing_moves_does_nothing(
    rest: str, why: str | None, tendon: str, load: Load
) -> None:
    world = FAR + '<site name="w1"/><site name="w2" pos="1 0 0"/>'
    moves = '<fixed name="moves"><joint joint="h" coef="2"/></fixed>'
    scene, model = load(world, f"<tendon>{tendon}{moves}</tendon>{rest}")
    assert [x.why for x in scene.left_out if x.name == "e"] == ([why] if why else [])
    assert scene.nu == model.nu
    assert worst_step(scene, model, spread=0.1) < 1e-6


def test_a_tie_of_a_tendon_that_nothing_moves_to_one_that_moves_is_refused(load: Load) -> None:
    world = FAR + '<site name="w1"/><site name="w2" pos="1 0 0"/>'
    rest = f'<tendon>{STILL}<fixed name="moves"><joint joint="h" coef="2"/></fixed></tendon>'
    with pytest.raises(UserError, match="'e' is not supported: it ties t, which no joint moves, to moves: tie moves"):
        load(world, rest + '<equality><tendon name="e" tendon1="t" tendon2="moves"/></equality>')


TWICE = '<tendon><fixed name="t" {}><joint joint="h" coef="1"/><joint joint="h" coef="-.5"/></fixed></tendon>'
TIE = '<equality><tendon name="e" tendon1="t"/></equality>'


@pytest.mark.parametrize(("attributes", "rest"), [('range="-.05 .05"', ""), ('frictionloss=".3"', ""), ("", TIE)])
def test_constraints_on_a_sum_with_one_joint_twice_are_refused(attributes: str, rest: str, load: Load) -> None:
    """MuJoCo drops them; on request they act on the sum."""
    with pytest.raises(UserError, match="tendon 't' is not supported: joint h comes more than once in its sum"):
        load(FAR, TWICE.format(attributes) + rest)
    scene, model = load(FAR, TWICE.format(attributes) + rest, ignore=["tendon"])
    assert [x.name for x in scene.left_out] == ["t"]
    data = mujoco.MjData(model)
    data.qpos[0] = 0.3
    mujoco.mj_forward(model, data)
    assert data.nefc == 0


def test_forces_of_a_sum_with_one_joint_twice_are_mujocos(load: Load) -> None:
    scene, model = load(FAR, TWICE.format('stiffness="9" damping="2" armature=".1"') + DRIVE)
    assert worst_step(scene, model, spread=0.2) < 1e-9


def test_rolling_friction_is_left_out_on_request_and_said(load: Load) -> None:
    scene, _ = load(FLOOR + DROP.format('size=".1" condim="4"'))
    assert not scene.left_out
    assert scene.core.con_dim.tolist() == [4]
    scene, _ = load(FLOOR + DROP.format('size=".1" condim="4"'), ignore="condim")
    why = "condim 4 as 3: no torsional friction; left out (--ignore condim)"
    assert [(x.kind, x.why) for x in scene.left_out] == [("condim", why)]
    assert scene.core.con_dim.tolist() == [3]


@pytest.mark.parametrize("friction", ["1 .5 .1 .1 .1", "1 1 .1 .1 .2"])
def test_two_coefficients_of_one_friction_become_one_on_request(friction: str, load: Load) -> None:
    """By an explicit pair; rolling friction only where the contact has it."""
    world = FLOOR + DROP.format('size=".1"')
    pair = '<contact><pair geom1="f" geom2="g" condim="{}" friction="' + friction + '"/></contact>'
    scene, _ = load(world, pair.format(6))
    assert scene.core.con_ratio.ravel().tolist() == ([0.5, 1.0] if friction.startswith("1 .5") else [1.0, 2.0])
    scene, _ = load(world, pair.format(6), ignore="friction_anisotropic")
    assert scene.core.con_ratio.ravel().tolist() == [1.0, 1.0]
    assert [x.kind for x in scene.left_out] == ["friction_anisotropic"]
    assert scene.core.P[scene.layout.contact(0) :][[0, 9, 10]].tolist() == [1.0, 0.1, 0.1]
    if friction.startswith("1 1"):
        assert load(world, pair.format(4))[0].core.con_dim.tolist() == [4]


def test_all_refusals_come_in_one_line(load: Load) -> None:
    world, _ = actuator("", "")
    rest = """<actuator><general name="a" joint="h" dyntype="muscle" dynprm="1 1"/>
    <general name="p" body="m" biastype="affine" biasprm="0 0 -1"/></actuator>"""
    with pytest.raises(UserError, match=r"1 more element.*--ignore actuator_dynamics --ignore actuator_bias"):
        load(world, rest)
    scene, _ = load(world, rest, ignore="actuator_bias,actuator-dynamics")
    assert scene.ignore == ("actuator_bias", "actuator_dynamics")
    with pytest.raises(UserError, match="did you mean 'tendon'"):
        load(world, rest, ignore=["tendn"])


def test_one_element_of_two_kinds_is_one(load: Load) -> None:
    world, muscle = actuator("muscle", 'lengthrange="0 1"')
    with pytest.raises(UserError, match=r"'motor' is not supported: .* \(nor is its actuator_\w+\); remove it") as told:
        load(world, muscle)
    assert "more element" not in str(told.value)


def test_a_servo_on_three_axes_is_of_two_kinds(load: Load) -> None:
    world, rest = BALL_JOINT.format(""), '<actuator><orientation name="motor" joint="b" kp="1"/></actuator>'
    told = "actuator_transmission 'motor' is not supported: it drives a so3 (nor is its actuator_bias); remove it"
    with pytest.raises(UserError, match=re.escape(told)):
        load(world, rest)
    scene, model = load(world, rest, ignore=["actuator_transmission", "actuator_bias"])
    assert scene.nu == model.nu == 3


SUPPORTED = {
    "joint_limit_ball": (BALL_JOINT.format('range="0 1" limited="true"'), "", "b"),
    "fluid": (HINGE.format("", ""), '<option viscosity=".1"/>', "option"),
    "joint_spring_ball": (BALL_JOINT.format('stiffness="1"'), "", "b"),
    "joint_polynomial": (HINGE.format("", 'damping="1 0 2"'), "", "h"),
    "friction_anisotropic": (
        FLOOR + DROP.format('size=".1"'),
        '<contact><pair geom1="f" geom2="g" friction="1 .5"/></contact>',
        "f - g",
    ),
    "gravcomp": (HINGE.format('gravcomp="1"', ""), "", "m"),
    "joint_force_range": (HINGE.format("", 'actuatorfrcrange="-1 1"'), "", "h"),
}


@pytest.mark.parametrize("kind", SUPPORTED)
def test_supported_elements_can_be_left_out(kind: str, load: Load) -> None:
    world, rest, name = SUPPORTED[kind]
    assert not load(world, rest)[0].left_out
    scene, _ = load(world, rest, ignore=[kind])
    assert [(x.kind, x.name) for x in scene.left_out] == [(kind, name)]


def test_elements_that_do_nothing_are_left_out_silently(load: Load) -> None:
    rest = (
        '<tendon><fixed name="t"><joint joint="h" coef="1"/></fixed></tendon>'
        '<equality><joint name="e" joint1="h" active="false"/></equality><sensor><jointpos joint="h"/></sensor>'
    )
    scene, _ = load(HINGE.format("", ""), rest)
    assert [(x.kind, x.name) for x in scene.left_out] == [("tendon", "t"), ("equality", "e")]


def test_sleep_is_told_where_it_is_allowed(load: Load) -> None:
    """A body that may fall asleep is no obstacle, nor is one that would start asleep without the flag."""
    scene, _ = load(HINGE.format("", ""), SLEEP)
    assert [(x.kind, x.name) for x in scene.left_out] == [("sleep", "option")]
    assert "nothing falls asleep" in describe(scene)
    scene, model = load(CASES["sleep"][0])
    assert not scene.left_out
    assert worst_step(scene, model) < 1e-9


def test_unmodelled_contact_that_cannot_happen_is_no_obstacle(load: Load) -> None:
    world = DROP.format('type="box" size=".1 .1 .1" contype="2" conaffinity="2"') + '<geom type="box" size="1 1 1"/>'
    assert load(world)[0].contact_names == ()


@pytest.mark.parametrize("file", GYMNASIUM, ids=lambda file: file.stem)
def test_gymnasium(file: Path) -> None:
    """Every MJCF of gymnasium loads, and all that moves it is modelled."""
    assert {x.kind for x in Scene.from_mjcf(file).left_out} <= {"tendon"}


def test_bad_files(tmp_path: Path) -> None:
    def message(path: Path) -> str:
        with pytest.raises(UserError) as caught:
            Scene.from_mjcf(path)
        assert "\n" not in str(caught.value)
        assert str(path) in str(caught.value)
        return str(caught.value)

    file = tmp_path / "scene.xml"
    assert "no such file" in message(file)
    file.write_bytes(b"\xff\xfe\x00 not text")
    assert "not an MJCF" in message(file)
    file.write_text("<sdf version='1'/>", encoding="utf-8")
    assert "<sdf>" in message(file)
    file.write_text("<mujoco><worldbody><body><geom/></body></worldbody></mujoco>", encoding="utf-8")
    assert "cannot compile" in message(file)
    file.write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>", encoding="utf-8")
    assert "nothing moves" in message(file)


def test_mujocos_warnings_are_kept_and_leave_no_log_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    cheetah = Scene.from_mjcf(next(file for file in GYMNASIUM if file.stem == "half_cheetah"))
    assert all("settotalmass" in warning for warning in cheetah.compiler_warnings)
    assert os.listdir() == []


def test_kinds_are_documented() -> None:
    assert {*CASES, *SUPPORTED} <= set(KINDS)


def test_plugins_that_only_sense_are_borne(load: Load) -> None:
    plugin = "mujoco.sensor.touch_grid"
    config = "".join(
        f'<config key="{key}" value="{value}"/>'
        for key, value in {"size": "7 7", "fov": "10 10", "gamma": "0", "nchannel": "3"}.items()
    )
    instance = f'<plugin plugin="{plugin}"><instance name="grid">{config}</instance></plugin>'
    sense = f"""<mujoco><extension>{instance}</extension>
        <worldbody>{HINGE.format("", "").replace("</body>", '<site name="s"/></body>')}</worldbody>
        <sensor><plugin plugin="{plugin}" instance="grid" objtype="site" objname="s"/></sensor></mujoco>"""
    assert Scene.from_mjcf(sense).left_out == ()
    cable = '<extension><plugin plugin="mujoco.elasticity.cable"><instance name="bend"/></plugin>'
    bent = sense.replace("<extension>", cable).replace('<geom name="g"', '<plugin instance="bend"/><geom name="g"')
    with pytest.raises(UserError, match=r"plugin 'extension' is not supported: 1 plugin instance; remove it"):
        Scene.from_mjcf(bent)
