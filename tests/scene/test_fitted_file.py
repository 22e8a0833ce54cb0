"""The MJCF with fitted values: what it holds comes back, the rest is named, and MuJoCo moves as the truth does."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.errors import UserError
from cmbrl.registry import load_task
from cmbrl.scene import Scene
from cmbrl.scene.records import Body
from cmbrl.scene.writing.fitted_file import fitted_file
from cmbrl.scene.writing.inertials import Inertial, moved_parts

ARM = """
<mujoco><compiler angle="degree" settotalmass="{total}"/><option timestep="0.002" integrator="implicitfast"/>
<default><joint damping="{damping}" armature="0.02" frictionloss="{loss}"/></default>
<worldbody><geom name="ground" type="plane" size="2 2 1" pos="0 0 -0.33"/>
<body><joint name="yaw" axis="0 0 1"/><geom type="capsule" size=".04" fromto="0 0 0 .3 0 0"/>
  <body pos=".3 0 0" euler="0 20 0"><joint name="pitch" axis="0 1 0" stiffness="2"/>
    <geom name="fore" type="capsule" size=".03" fromto="0 0 0 .3 0 0"/>
    <body pos=".3 0 0" euler="10 0 30"><geom name="load" type="box" size=".03 .04 .05"/></body>
  </body></body></worldbody>
<tendon><fixed name="belt" stiffness="3" damping=".2">
<joint joint="yaw" coef="1"/><joint joint="pitch" coef="-.5"/></fixed></tendon>
<actuator><position joint="yaw" name="servo" kp="{kp}" kv="{kv}"/>
<motor joint="pitch" name="motor" gear="{gear}" armature="0.001"/></actuator></mujoco>
"""
FILE = {"total": 4.0, "damping": 0.3, "loss": 0.1, "kp": 30.0, "kv": 1.0, "gear": 5.0}
TRUTH = {"total": 5.2, "damping": 0.5, "loss": 0.25, "kp": 24.0, "kv": 1.6, "gear": 4.0}


@pytest.fixture
def arm(tmp_path: Path) -> Scene:
    (tmp_path / "arm.xml").write_text(ARM.format(**FILE))
    return Scene.from_mjcf(tmp_path / "arm.xml")


def moved(scene: Scene, seed: int = 0) -> np.ndarray:
    """All parameters away from their nominal values."""
    draw = np.random.default_rng(seed)
    theta = scene.parameter_vector()
    for k, p in enumerate(scene.parameters):
        if p.transform == "log":
            theta[k] *= np.exp(0.2 * draw.normal())
        else:
            theta[k] += (0.05 + 0.05 * draw.random()) * ((p.low if p.transform == "logit" else p.high) - theta[k])
    return np.clip(theta, [p.low for p in scene.parameters], [p.high for p in scene.parameters])


def at(scene: Scene, **values: float) -> np.ndarray:
    """Nominal parameters but for the ``values`` of groups, or of names with __ for the point."""
    theta, known = scene.parameter_vector(), {name.replace("__", "."): x for name, x in values.items()}
    for k, p in enumerate(scene.parameters):
        theta[k] = known.pop(p.name, known.get(p.group, theta[k]))
    assert not [name for name in known if name not in {p.group for p in scene.parameters}]
    return theta


def rollout(text: str, steps: int) -> np.ndarray:
    """Positions under a fixed drive."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    path = []
    for k in range(steps):
        data.ctrl = 0.3 * np.sin(0.02 * k + np.arange(model.nu))
        mujoco.mj_step(model, data)
        path.append(data.qpos.copy())
    return np.array(path)


@pytest.mark.parametrize("law", ["mujoco", "rigid"])
def test_all_that_an_mjcf_holds_comes_back(arm: Scene, tmp_path: Path, law: str) -> None:
    scene = Scene.from_mjcf(arm.path, contact_law=law)
    theta = moved(scene)
    file = fitted_file(scene, theta, {"bias.yaw": 0.01, "delay.command": 0.0})
    kept = {"friction_slope", "stribeck", "stribeck_speed", "force_limit_slope", "backlash"}  # an MJCF has none
    groups = {name.partition(".")[0] for name in file.missing}
    expected = {"rigid": {"restitution", "softness_time"}, "mujoco": set()}[law]
    assert groups - kept == expected | {"bias"}
    assert "bias.yaw = 0.01" in file.text.partition("-->")[0]
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere/fitted.xml").write_text(file.text)
    held = Scene.from_mjcf(tmp_path / "elsewhere/fitted.xml", contact_law=law)
    layout, wanted = scene.layout, scene.physical_vector(theta)
    for field in ("damping", "armature", "stiffness", "frictionloss"):
        places = [layout.dof(d, field) for d in range(scene.nv + 1)]  # the tendon too
        np.testing.assert_allclose(held.core.P[places], wanted[places], rtol=1e-5)
    bodies = slice(0, layout.dof(0))
    np.testing.assert_allclose(held.core.P[bodies], wanted[bodies], rtol=1e-4, atol=1e-6)
    for k in range(scene.nu):
        wanted[[layout.actuator(k, "limit_slope"), layout.actuator(k, "gap")]] = 0.0
    actuators = slice(layout.plane(0), layout.contact(0))  # and the plane, and gravity
    np.testing.assert_allclose(held.core.P[actuators], wanted[actuators], rtol=1e-5, atol=1e-9)


def test_mujoco_moves_the_arm_as_the_hidden_file_does(arm: Scene) -> None:
    theta = at(arm, mass=5.2 / 4.0, damping=0.5, frictionloss=0.25, kp=24.0, kd=1.6, gear=0.8)
    armature = [k for k, p in enumerate(arm.parameters) if p.name == "armature.pitch"]
    theta[armature] = 0.02 + 0.001 * 4.0**2  # the gear also reflects the rotor
    file, hidden = fitted_file(arm, theta), ARM.format(**TRUTH)
    assert file.missing == ()
    true, before = rollout(hidden, 400), rollout(ARM.format(**FILE), 400)
    assert np.abs(rollout(file.text, 400) - true).max() < 1e-3 * np.abs(before - true).max()


BOX = """<mujoco><option timestep=".002"/><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
<body pos="0 0 .06"><freejoint/><geom name="box" {shape}/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("shape", ['type="box" size=".05 .04 .05"', 'type="cylinder" size=".05 .05"'])
@pytest.mark.parametrize("radius", [0.003, -0.002])
def test_what_has_no_radius_rests_as_high_as_with_one(tmp_path: Path, shape: str, radius: float) -> None:
    """A floor that is lower by what the box is rounder: as in the model, the box does not sink with the floor."""
    (tmp_path / "box.xml").write_text(BOX.format(shape=shape))
    scene = Scene.from_mjcf(tmp_path / "box.xml")
    file = fitted_file(scene, at(scene, radius__box=radius, plane_height__floor=-radius))
    assert file.missing == ()
    heights = [rollout(text, 1500)[-1][2] for text in (file.text, BOX.format(shape=shape))]
    assert heights[0] == pytest.approx(heights[1], abs=1e-5)


def test_mujoco_moves_the_hopper_as_the_hidden_one_does() -> None:
    scene = Scene.from_mjcf(load_task("hopper").scene_path)
    spec = mujoco.MjSpec.from_file(scene.path)
    nominal = spec.compile()
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    foot = spec.geom("foot_geom")
    foot.priority, foot.condim, foot.friction[0], foot.solref[:] = 1, 3, 0.7, (0.03, 0.8)
    for body in spec.bodies[1:]:
        body.explicitinertial, body.mass = True, 1.4 * nominal.body_mass[body.id]
        body.ipos, body.iquat = nominal.body_ipos[body.id], nominal.body_iquat[body.id]
        body.inertia = 1.4 * nominal.body_inertia[body.id]
    for actuator in spec.actuators:
        actuator.gear[0] *= 0.8
    spec.compile()
    softness = {"softness_time__foot_geom": 0.03, "softness_damping__foot_geom": 0.8, "friction__foot_geom": 0.7}
    file = fitted_file(scene, at(scene, mass=1.4, gear=0.8, **softness))
    assert file.missing == ()
    true, before = rollout(spec.to_xml(), 300), rollout(Path(scene.path).read_text(), 300)
    assert np.abs(before - true).max() > 0.05
    assert np.abs(rollout(file.text, 300) - true).max() < 1e-2 * np.abs(before - true).max()


def test_softness_is_written_as_impedance(arm: Scene, tmp_path: Path) -> None:
    file = fitted_file(arm, at(arm, softness_scale=2.0))
    assert file.missing == ()
    model = mujoco.MjModel.from_xml_string(file.text)
    share = model.pair_solimp[0, :2]
    np.testing.assert_allclose((1 - share) / share, 2 * (1 - np.array([0.9, 0.95])) / [0.9, 0.95], rtol=1e-4)


def test_meshes_are_found_from_another_folder(tmp_path: Path) -> None:
    (tmp_path / "shapes").mkdir()
    corners = ["v 0 0 0", "v .1 0 0", "v 0 .1 0", "v 0 0 .1", "f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
    (tmp_path / "shapes/corner.obj").write_text("\n".join(corners))
    text = """<mujoco><compiler meshdir="shapes"/><asset><mesh file="corner.obj"/></asset><worldbody><body>
    <joint name="j" damping="1"/><geom type="mesh" mesh="corner" contype="0" conaffinity="0"/>
    </body></worldbody></mujoco>"""
    (tmp_path / "meshed.xml").write_text(text)
    scene = Scene.from_mjcf(tmp_path / "meshed.xml")
    file = fitted_file(scene, at(scene, damping=2.0, mass=1.5))
    (tmp_path / "far/away").mkdir(parents=True)
    (tmp_path / "far/away/fitted.xml").write_text(file.text)
    held = Scene.from_mjcf(tmp_path / "far/away/fitted.xml")
    assert held.total_mass == pytest.approx(1.5 * scene.total_mass, rel=1e-5)
    assert file.missing == ()


def test_thrust_of_a_site_comes_back(tmp_path: Path) -> None:
    text = """<mujoco><worldbody><body><freejoint/><geom size=".1"/><site name="rotor"/></body></worldbody><actuator>
    <motor name="thrust" site="rotor" gear="0 0 .9 0 0 -.01"/><motor name="roll" site="rotor" gear="0 0 0 1e-5 0 0"/>
    </actuator></mujoco>"""
    (tmp_path / "drone.xml").write_text(text)
    scene = Scene.from_mjcf(tmp_path / "drone.xml")
    file = fitted_file(scene, at(scene, gear__thrust=0.8, gear__roll=1.2))
    held = mujoco.MjModel.from_xml_string(file.text)
    np.testing.assert_allclose(held.actuator_gear[0], [0, 0, 0.72, 0, 0, -0.008])
    np.testing.assert_allclose(held.actuator_gear[1, 3], 1.2e-5)
    assert file.missing == ()


def test_parts_of_a_body_together_are_what_was_fitted() -> None:
    draw = np.random.default_rng(1)

    def inertia() -> np.ndarray:
        root = draw.normal(size=(3, 3))
        moments = root @ root.T
        return np.trace(moments) * np.eye(3) - moments

    parts = {n: Inertial(draw.uniform(1, 3), draw.normal(size=3), inertia()) for n in (4, 7)}
    body = Body("b", -1, np.zeros(3), np.eye(3))
    for part in parts.values():
        body.add_mass(part.mass, part.com, part.inertia)
    target = Inertial(2.5, body.com + 0.1, inertia())
    found = Body("b", -1, np.zeros(3), np.eye(3))
    for part in moved_parts(parts, body, target).values():
        assert np.linalg.eigvalsh(0.5 * np.trace(part.inertia) * np.eye(3) - part.inertia).min() > 0  # no negative mass
        found.add_mass(part.mass, part.com, part.inertia)
    assert found.mass == pytest.approx(target.mass)
    np.testing.assert_allclose(found.com, target.com, atol=1e-12)
    np.testing.assert_allclose(found.inertia, target.inertia, atol=1e-9)


def test_a_scene_without_a_file_says_so() -> None:
    scene = Scene.from_mjcf(ARM.format(**FILE))
    with pytest.raises(UserError, match="was not read from a file: write its XML to one"):
        fitted_file(scene, scene.parameter_vector())


def test_torsional_and_rolling_friction_are_written(tmp_path: Path) -> None:
    """And nothing of it into a pair that has none."""
    names = {"torsional_friction__ball": 0.02, "rolling_friction__ball": 0.003}
    for dim, known in ((4, ["torsional_friction__ball"]), (6, [*names])):
        (tmp_path / "ball.xml").write_text(
            f"""<mujoco><worldbody><geom name="floor" type="plane" size="2 2 1"/><body pos="0 0 .1"><freejoint/>
            <geom name="ball" size=".1" condim="{dim}" friction=".8 .01 .001"/></body></worldbody></mujoco>"""
        )
        scene = Scene.from_mjcf(tmp_path / "ball.xml")
        file = fitted_file(scene, at(scene, **{name: names[name] for name in known}))
        assert file.missing == ()
        model = mujoco.MjModel.from_xml_string(file.text)
        assert model.pair_dim.tolist() == [dim]
        rolling = 0.003 if dim == 6 else 0.001
        assert model.pair_friction[0] == pytest.approx([1.0, 1.0, 0.02, rolling, rolling])


def test_a_disc_without_thickness_is_written(tmp_path: Path) -> None:
    """Its moments are as small beside each other as they can be, and the digits of a file made them smaller."""
    disc = '<geom type="cylinder" size=".0371 1e-5" density="10" quat=".3 .5 .7 .2"/>'
    (tmp_path / "disc.xml").write_text(
        f'<mujoco><worldbody><body><joint name="j" type="slide"/>{disc}</body></worldbody></mujoco>'
    )
    scene = Scene.from_mjcf(tmp_path / "disc.xml")
    for factor in np.linspace(0.7, 1.3, 20):
        values = np.array([factor if p.group == "mass" else p.nominal for p in scene.parameters])
        (tmp_path / "fitted.xml").write_text(fitted_file(scene, values).text)
        fitted = mujoco.MjModel.from_xml_path(str(tmp_path / "fitted.xml"))
        nominal = mujoco.MjModel.from_xml_path(str(tmp_path / "disc.xml"))
        assert fitted.body_mass[1] == pytest.approx(factor * nominal.body_mass[1])
        assert fitted.body_inertia[1] == pytest.approx(factor * nominal.body_inertia[1], rel=1e-4)


def test_a_fluid_comes_back(tmp_path: Path) -> None:
    """MuJoCo moves in the fluid of the file, boxes and ellipsoids, as in the true one."""
    swimmer = """<mujoco><option timestep=".01" density="{density}" viscosity="{viscosity}" integrator="implicitfast"/>
    <worldbody><body><freejoint/><geom type="box" size=".2 .04 .05"/><body pos=".2 0 0">
    <joint name="tail" axis="0 0 1"/>
    <geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" fluidshape="ellipsoid"/></body></body></worldbody>
    <actuator><motor joint="tail" gear="3"/></actuator></mujoco>"""
    nominal, true = swimmer.format(density=900, viscosity=0.2), swimmer.format(density=1300, viscosity=0.05)
    (tmp_path / "swimmer.xml").write_text(nominal)
    scene = Scene.from_mjcf(tmp_path / "swimmer.xml")
    file = fitted_file(scene, at(scene, fluid_density=1300.0, fluid_viscosity=0.05))
    assert file.missing == ()
    moved = np.abs(rollout(nominal, 100) - rollout(true, 100)).max()
    assert np.abs(rollout(file.text, 100) - rollout(true, 100)).max() < 1e-4 * moved
    longer = at(scene, fluid_density=1300.0, **{"inertia__body1:z": 1.5})  # and with it MuJoCo's box
    assert fitted_file(scene, longer).missing == ("fluid_density",)
