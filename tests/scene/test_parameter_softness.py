"""Masses, inertias and armatures soften and stiffen what yields, as in MuJoCo."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
import pytest

from cmbrl.scene import Scene
from cmbrl.scene.core.inverse_weights import contact_factors, line_factors
from cmbrl.scene.writing.fitted_file import written_and_read

from .cart_arm import column
from .conftest import Load


def test_masses_soften_contacts(load: Load) -> None:
    """As MuJoCo's inverse weights do: exactly where bodies are free, by value and slope in trees."""
    free = '<body pos="{0} 0 1"><freejoint/><geom name="g{0}" size=".1" mass="{0}"/></body>'
    scene, _ = load(free.format(1) + free.format(3))
    theta = scene.parameter_vector()
    theta[column(scene, "mass.body2")] = 1.5
    P = scene.physical_vector(theta)
    soft = P[scene.layout.contact(0, "rscale")] * scene.core.con_invweight[0]
    assert soft == pytest.approx(1 + 1 / 4.5, rel=1e-12)


def test_softness_by_inertia_against_mujoco(robot: tuple[Scene, mujoco.MjModel]) -> None:
    """Slopes of inverse weights with masses and armatures, of joints and bodies that touch, against mj_setConst."""
    scene, base = robot
    core, step = scene.core, 1e-5
    geoms = [[base.geom(name).id for name in pair.split(" - ")] for pair in scene.contact_names]
    sides = base.geom_bodyid[np.array(geoms)]
    rows = scene.layout.contacts(np.arange(core.ncontact), "rscale")
    moving = np.array([_moving_body(base, k) for k in range(base.nbody)])
    armatures = [p.name for p in scene.parameters if p.group == "armature"]
    for name in [*(f"mass.{body}" for body in scene.body_names), *armatures]:
        place, of = column(scene, name), name.partition(".")[2]
        theta = np.tile(scene.parameter_vector(), (2, 1))
        theta[:, place] += step * np.array([-1, 1]) * (theta[:, place] if theta[0, place] else 1.0)
        soft, joints, weights = [], [], []
        for x in theta:
            soft.append(scene.physical_vector(x)[rows] * core.con_invweight)
            joints.append(line_factors(core.line_weight, scene.inverse_weights(x)) * core.line_invweight)
            model = copy.copy(base)
            if name in armatures:
                model.dof_armature[base.jnt_dofadr[base.joint(of).id]] = x[place]
            else:
                for field in (model.body_mass, model.body_inertia):
                    field[moving == base.body(of).id] *= x[place]
            mujoco.mj_setConst(model, mujoco.MjData(model))
            weights.append((model.body_invweight0[sides, 0].sum(axis=1) * core.P[rows], model.dof_invweight0))
        (low, low_dof), (high, high_dof) = weights
        assert np.subtract(*soft[::-1]) == pytest.approx(high - low, rel=1e-3, abs=1e-6 * np.abs(low).max() * step)
        bound = core.line_weight >= 0  # a free joint has neither limits nor friction
        by_mass = (high_dof - low_dof)[bound]
        assert np.subtract(*joints[::-1])[bound] == pytest.approx(by_mass, rel=1e-3, abs=1e-3 * np.abs(by_mass).max())


def test_inverse_weights_are_those_of_the_fitted_file(robot: tuple[Scene, mujoco.MjModel]) -> None:
    """At masses, centres, shapes and armatures far from the file's, as MuJoCo's compiler has them, to six digits."""
    (scene, base), rng = robot, np.random.default_rng(0)
    core, theta = scene.core, scene.parameter_vector()
    inertial = [scene.parameters[k] for k in core.inertial_par]
    scales = {"mass", "inertia", "armature"}
    assert {p.group for p in inertial} >= scales | {"com_x", "com_z"}
    for k, p in zip(core.inertial_par, inertial, strict=True):
        own = max(p.nominal, 0.01) if p.group == "armature" else p.nominal
        theta[k] = own * np.exp(rng.uniform(-0.5, 0.5)) if p.group in scales else 0.05 * rng.uniform(p.low, p.high)
    factors, held = scene.inverse_weights(theta), written_and_read(scene, theta)[1].core
    bound = core.line_weight >= 0
    lines = line_factors(core.line_weight, factors) * core.line_invweight
    assert np.abs(factors - 1.0).max() > 0.2
    np.testing.assert_allclose(lines[bound], held.line_invweight[bound], rtol=2e-5)
    found = contact_factors(core, factors) * core.con_invweight
    moving = [_moving_body(base, k) for k in range(base.nbody)]  # a humanoid's feet are welded to its shins
    sides = [
        [moving[base.geom_bodyid[base.geom(geom).id]] for geom in pair.split(" - ")] for pair in scene.contact_names
    ]
    alone = [all(body == 0 or moving.count(body) == 1 for body in pair) for pair in sides]
    assert any(alone)
    np.testing.assert_allclose(found[alone], held.con_invweight[alone], rtol=2e-5)


def test_masses_soften_tendons(load: Load) -> None:
    """A string between two trees, and a tendon that adds joints: slopes against mj_setConst, and the unit of force."""
    slide = '<joint name="{}" type="slide" axis="{}"/>'
    world = f"""<body name="A" pos="0 0 1">{slide.format("a", "0 0 1")}<geom size=".1" mass="2"/>
    <site name="a" pos=".1 0 0"/></body>
    <body name="B" pos="0 0 .5">{slide.format("b", "0 0 1")}{slide.format("c", "1 0 0")}<geom size=".1" mass="1"/>
    <site name="b"/><body name="D" pos=".2 0 0"><joint name="d" axis="0 1 0"/><geom size=".05" pos=".3 0 0" mass=".5"/>
    </body></body>"""
    tendons = """<tendon><spatial name="string" range="0 .5" limited="true"><site site="a"/><site site="b"/></spatial>
    <fixed name="sum" frictionloss="1" armature=".3"><joint joint="b" coef="1"/><joint joint="d" coef=".5"/>
    </fixed></tendon>"""
    scene, base = load(world, tendons)
    core, step = scene.core, 1e-5
    rows = core.line_weight[core.nv :]
    assert (rows >= 0).all()
    bodies = [p.name for p in scene.parameters if p.group == "mass"]
    for name in bodies:
        found, true = [], []
        for side in (-step, step):
            theta, model = scene.parameter_vector(), copy.copy(base)
            theta[column(scene, name)] += side
            for field in (model.body_mass, model.body_inertia):
                field[model.body(name.partition(".")[2]).id] *= 1.0 + side
            mujoco.mj_setConst(model, mujoco.MjData(model))
            found.append(scene.inverse_weights(theta)[rows] * core.line_invweight[core.nv :])
            true.append(model.tendon_invweight0)
        assert found[0] == pytest.approx(true[0], rel=1e-6)
        assert found[1] - found[0] == pytest.approx(true[1] - true[0], rel=1e-3, abs=1e-9)
    theta = scene.parameter_vector()
    theta[[column(scene, name) for name in [*bodies, "tendon_armature.sum"]]] *= 2.5
    assert scene.inverse_weights(theta)[rows] == pytest.approx(1 / 2.5, rel=1e-6)


def test_an_armature_that_only_the_fit_has_stiffens_as_in_mujoco(load: Load) -> None:
    """Exactly for a body on one joint, and the unit of force stays open: all of them scale a weight's inverse."""
    scene, _ = load('<body><joint name="j" type="slide" range="-1 1" limited="true"/><geom size=".1" mass="2"/></body>')
    theta = scene.parameter_vector()
    mass, armature = column(scene, "mass.body1"), column(scene, "armature.j")
    row = scene.core.lim_weight[0]
    for scale, added in ((1.0, 0.0), (1.0, 3.0), (0.5, 3.0), (5.0, 0.4)):
        theta[mass], theta[armature] = scale, added
        assert scene.inverse_weights(theta)[row] == pytest.approx(2.0 / (2.0 * scale + added), rel=1e-12)


def _moving_body(model: mujoco.MjModel, body: int) -> int:
    """The body with joints that a body of the file is welded to."""
    while body and not model.body_jntnum[body]:
        body = int(model.body_parentid[body])
    return body
