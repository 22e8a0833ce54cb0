"""A fit for a task: at another control step, and for the file in which its robot is not bolted down."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from cmbrl import Scene, UserError
from cmbrl.models.carried import fit_for
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene.drives import Drive
from cmbrl.scene.writing.played import played_scene

LEG_WITH_ROTORS = """
<mujoco model="leg"><option timestep="0.005"/><worldbody><geom name="floor" type="plane" size="0 0 1"/>
<body name="thigh" pos="0 0 .5"><joint name="hip" axis="0 1 0" damping=".2" armature=".01"/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".5"/><body name="shank" pos="0 0 -.2">
<joint name="knee" axis="0 1 0" damping=".2" armature=".01"/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".3"/></body></body></worldbody>
<actuator><motor joint="hip"/><motor joint="knee"/></actuator></mujoco>"""
SERVO = '<position name="{0}" joint="{0}" kp="40" kv="1"/>'
MOTOR = '<motor name="{0}" joint="{0}" ctrlrange="-20 20"/>'
SERVOS = (Drive("*", "position", kp=40.0, kd=1.0),)


def leg(root: str = "", actuator: str = SERVO, floor: str = "", joint: str = "hip") -> Scene:
    acts = "".join(actuator.format(name) for name in (joint, "knee"))
    return Scene.from_mjcf(f"""
<mujoco model="leg"><option timestep="0.005"/><worldbody>{floor}<body name="trunk" pos="0 0 1">{root}
<geom type="box" size=".1 .1 .05" mass="2"/><body name="thigh"><joint name="{joint}" axis="0 1 0" damping=".2"/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".5"/><body name="shank" pos="0 0 -.2">
<joint name="knee" axis="0 1 0" damping=".2"/><geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".3"/>
</body></body></body></worldbody><actuator>{acts}</actuator></mujoco>""")


def walking(**settings: str) -> ComplementarityModel:
    floor = '<geom name="floor" type="plane" size="0 0 1"/>'
    return ComplementarityModel(leg(root="<freejoint/>", floor=floor, **settings), substeps=4)


def fit(scene: Scene, moved: dict[str, float], **settings: object) -> ComplementarityModel:
    theta = scene.parameter_vector()
    for k, p in enumerate(scene.parameters):
        theta[k] = moved.get(p.name, theta[k])
    return ComplementarityModel(scene, parameters=theta, **settings)  # type: ignore[arg-type]


MOVED = {"damping.hip": 0.7, "kp.knee": 31.0, "mass.shank": 1.3}
BETWEEN = {"delay.command": 0.012, "bias.knee": 0.03}


def test_what_a_hanging_robot_told_is_carried_to_the_file_in_which_it_walks():
    nominal = walking()
    hanging = fit(leg(), MOVED, observation=BETWEEN)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = fit_for(hanging, nominal, "fit")
    values = dict(zip([p.name for p in found.scene.parameters], found.parameters, strict=True))
    start = dict(zip([p.name for p in found.scene.parameters], nominal.parameters, strict=True))
    assert {name: x for name, x in values.items() if x != start[name]} == MOVED
    assert found.observation == BETWEEN
    assert (found.dt, found.scene) == (nominal.dt, nominal.scene)


def test_candidates_are_carried_within_the_bounds_there():
    nominal, hanging = walking(), fit(leg(), MOVED)
    names = [p.name for p in hanging.scene.parameters]
    rows = np.tile(hanging.parameters, (3, 1))
    rows[:, names.index("damping.hip")] = 0.6, 0.7, 0.8
    rows[:, names.index("armature.hip")] = 0.05  # the fit itself left it alone
    found = fit_for(hanging.with_settings(candidates=rows), nominal, "fit").candidates
    assert found is not None
    there = [p.name for p in nominal.scene.parameters]
    assert found[:, there.index("damping.hip")].tolist() == [0.6, 0.7, 0.8]
    assert (found[:, there.index("kp.knee")] == 31.0).all()
    at = there.index("armature.hip")
    assert (found[:, at] == nominal.parameters[at]).all()


def test_what_has_no_place_is_left_out_and_told():
    hanging = fit(leg(joint="hip"), MOVED)
    nominal = ComplementarityModel(
        Scene.from_mjcf("""
<mujoco model="foot"><worldbody><body name="shank"><freejoint/><geom size=".1" mass=".3"/><body><joint name="knee"/>
<geom size=".1"/></body></body></worldbody>
<actuator><position name="knee" joint="knee" kp="40"/></actuator></mujoco>""")
    )
    with pytest.warns(UserWarning, match=r"fit: a fit of leg; 1 of the 3 numbers .* no place in foot .*: damping.hip"):
        fit_for(hanging, nominal, "fit")


def test_a_fit_runs_at_the_tasks_control_step():
    log, scene = 0.005, leg()
    hanging = fit(scene, MOVED, substeps=2, time_step=log / 2, observation=BETWEEN)
    found = fit_for(hanging, ComplementarityModel(scene, substeps=4), "fit")
    assert (found.substeps, found.time_step, found.observation) == (8, log / 2, BETWEEN)
    assert found.wiring is not None
    assert found.wiring.dt == pytest.approx(0.02)
    q, v, u = np.array([[0.3, -0.5]]), np.array([[1.0, -2.0]]), np.array([[0.2, -0.1]])
    once = found.predict(q, v, u)
    for _ in range(4):
        r = hanging.predict(q, v, u)
        q, v = r.q_next, r.v_next
    np.testing.assert_allclose(once.q_next, q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(once.v_next, v, rtol=0, atol=1e-12)


def test_other_robots_and_other_commands_are_refused():
    hanging = fit(leg(), MOVED)
    with pytest.raises(UserError, match=r"fit: model of another robot: nq, nv, nu \(2, 2, 2\), leg has \(9, 8, 2\)"):
        fit_for(hanging, walking(joint="shoulder"), "fit")
    told = r"fit: actuator 'hip' takes a position there and a torque in the task: give the task drives="
    with pytest.raises(UserError, match=told):
        fit_for(hanging, walking(actuator=MOTOR), "fit")
    with pytest.raises(UserError, match=told):
        fit_for(hanging, ComplementarityModel(leg(actuator=MOTOR)), "fit")
    with pytest.raises(UserError, match="fit: none of what it moved is a parameter of leg"):
        fit_for(fit(leg(root='<joint name="rail" type="slide"/>'), {"damping.rail": 1.0}), walking(), "fit")


def test_of_a_fit_with_play_all_but_the_gaps_is_kept(tmp_path):
    """Also the laws that it found: the file is the task's own."""
    (tmp_path / "leg.xml").write_text(LEG_WITH_ROTORS)
    scene = Scene.from_mjcf(tmp_path / "leg.xml")
    played = fit(
        played_scene(scene, {"knee": 0.02}), {"play.knee": 0.011, "damping.hip": 0.7}, sliding="convex",
        observation={"delay.command": 0.012},
    )  # fmt: skip
    played = played.with_settings(candidates=played.parameters[None] * 0.99)
    with pytest.warns(UserWarning, match="gaps are left out"):
        found = fit_for(played, ComplementarityModel(scene, substeps=4), "fit")
    assert (found.scene, found.to_config()["sliding"], found.observation) == (scene, "convex", played.observation)
    values = dict(zip([p.name for p in found.scene.parameters], found.parameters, strict=True))
    assert values["damping.hip"] == 0.7
    np.testing.assert_allclose(found.candidates[0], 0.99 * found.parameters)
    assert found.dt == pytest.approx(4 * scene.timestep)
