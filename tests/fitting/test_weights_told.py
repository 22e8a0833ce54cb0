"""Rows are softer for lighter links by MuJoCo's law: intervals do not rest on it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.data import read_trajectories
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.surveyed import Survey
from cmbrl.fitting.outcome.discrepancy import Discrepancy
from cmbrl.fitting.outcome.weights_told import constant
from cmbrl.fitting.state import Journal
from cmbrl.scene import Scene
from cmbrl.scene.weighed import weighed_at

CHAIN = """<mujoco><option timestep=".005" gravity="0 0 0"/><default><geom type="capsule" size=".03"/>
<joint axis="0 1 0"/></default><worldbody><body name="a"><joint name="x" type="slide" axis="1 0 0"/>
<joint name="z" type="slide" axis="0 0 1"/><joint name="turn"/><geom fromto="0 0 0 .3 0 0" mass="{masses[0]}"/>
<body name="b" pos=".3 0 0"><joint name="first" range="-30 30" limited="true"/>
<geom fromto="0 0 0 .3 0 0" mass="{masses[1]}"/><body name="c" pos=".3 0 0">
<joint name="second" range="-30 30" limited="true"/><geom fromto="0 0 0 .3 0 0" mass="{masses[2]}"/></body></body>
</body></worldbody><actuator><motor joint="first" gear="3"/><motor joint="second" gear="1"/></actuator></mujoco>"""
FILE, ROBOT = (1.0, 1.0, 1.0), (0.9, 1.5, 0.7)


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    path = tmp_path_factory.mktemp("chain") / "chain.xml"
    path.write_text(CHAIN.format(masses=FILE))
    return Scene.from_mjcf(path)


def test_weights_are_those_of_mujoco_at_other_masses(chain: Scene) -> None:
    scaled = {"mass.a": ROBOT[0], "mass.b": ROBOT[1], "mass.c": ROBOT[2]}
    theta = np.array([scaled.get(p.name, p.nominal) for p in chain.parameters])
    own = mujoco.MjModel.from_xml_string(CHAIN.format(masses=ROBOT)).dof_invweight0
    weighed = weighed_at(chain, theta)
    np.testing.assert_allclose(weighed.core.line_invweight, own, rtol=1e-6)
    np.testing.assert_allclose(weighed.core.lim_invweight, own[chain.core.lim_line], rtol=1e-6)
    np.testing.assert_array_equal(weighed.inverse_weights(theta), chain.inverse_weights(theta))
    assert (weighed.core.line_weight == -1).all()
    assert (weighed.core.con_weight == -1).all()


def test_mass_across_a_hinge_is_told_by_nothing(chain: Scene) -> None:
    """A mass at a hinge may belong to either link: motion is the same, and so are the softness of joints' rows."""
    robot, rng, rows = mujoco.MjModel.from_xml_string(CHAIN.format(masses=FILE)), np.random.default_rng(0), []
    data = mujoco.MjData(robot)
    for command in np.repeat(rng.uniform(-1, 1, (20, 2)), 8, axis=0):
        rows.append((data.qpos.copy(), data.qvel.copy(), command))
        data.ctrl[:] = command
        mujoco.mj_step(robot, data, nstep=2)
    q, v, u = (np.array(x) for x in zip(*rows, strict=True))
    evidence = Evidence.of(cmbrl.ComplementarityModel(chain, 2), read_trajectories(q, [160], 0.01, v, u))
    space, far, share = evidence.space, 0.15, 1e-6  # from the hinge to either centre [m]; of a link's mass
    turned = share * (far**2 * robot.body("b").mass[0] / robot.body("b").inertia.max() - 1.0)
    moved = {"mass.a": share, "com_x.a": share * far, "inertia.a": turned}
    moved |= {"mass.b": -share, "com_x.b": share * far, "inertia.b": -turned}
    across = space.z(space.nominal + [moved.get(name, 0.0) for name in space.names]) / share
    survey = cast(Survey, SimpleNamespace(horizon=1, noise=None, left=None))
    discrepancy = Discrepancy(evidence, survey, 0.5, 0, 200, Journal(None, ""))
    z, every = np.zeros(len(space)), np.ones(len(space), dtype=bool)
    own, found = discrepancy._equations(z, None, 1), discrepancy.weighed(z, every)
    assert found is not None
    mass = space.z(space.nominal + [share * (name == "mass.b") for name in space.names]) / share
    for equations in (own, found[0]):
        assert equations.root is not None
        told, across_hinge = (float(np.linalg.norm(equations.root @ change)) for change in (mass, across))
        assert across_hinge < 1e-4 * told
    silent = constant(found[0], own)
    assert silent.variance == own.variance
    assert not silent.gradient.any()
