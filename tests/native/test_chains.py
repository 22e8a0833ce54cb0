"""Chains of all lengths: dofs that are eliminated several at a time, in trees, with rows and without."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl.bench.check_steps import mujocos
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

AXES = ("0 1 0", "1 0 0", ".6 0 .8")


def chain(count: int, joint: str, contacts: bool) -> str:
    """One link in another, from the first on."""
    touch = "" if contacts else ' contype="0" conaffinity="0"'
    link = f'<geom type="capsule" fromto="0 0 0 0 .02 -.1" size=".01" mass=".1"{touch}/>'
    begins = "".join(f'<body pos="0 .02 -.1"><joint axis="{AXES[k % 3]}" {joint}/>{link}' for k in range(count))
    return begins + "</body>" * count


def hand(fingers: tuple[int, ...], joint: str, option: str = "", contacts: bool = False) -> mujoco.MjModel:
    """A free palm whose fingers have so many joints."""
    own = "".join(f'<body pos="{0.2 * k} 0 0">{chain(n, joint, contacts)}</body>' for k, n in enumerate(fingers))
    palm = f'<body pos="0 0 .3"><freejoint/><geom type="box" size=".1 .1 .02" mass="1"/>{own}</body>'
    head = f'<option timestep=".002" tolerance="0" iterations="200" ls_iterations="100" {option}/>'
    floor = '<geom type="plane" size="3 3 .1"/>' if contacts else ""
    return mujoco.MjModel.from_xml_string(f"<mujoco>{head}<worldbody>{floor}{palm}</worldbody></mujoco>")


@pytest.mark.parametrize("option", ["", 'integrator="implicit"'])
@pytest.mark.parametrize("fingers", [(), (1,), (2, 3), (4, 5), (6, 1, 7), (9,), (23,)])
@pytest.mark.parametrize("rows", ["nothing", "limits", "contacts"])
def test_a_step_is_mujocos(fingers: tuple[int, ...], rows: str, option: str) -> None:
    joint = 'damping=".01"' + ' range="-5 5" frictionloss=".01"' * (rows != "nothing")
    theirs = hand(fingers, joint, option, rows == "contacts")
    scene, data = Scene.from_mjcf(theirs, self_contact="none"), mujoco.MjData(theirs)
    rng = np.random.default_rng(len(fingers))
    q = scene.integrate(np.tile(scene.q0, (5, 1)), 0.2 * rng.normal(size=(5, scene.nv)))
    v, u = 0.3 * rng.normal(size=q[:, 1:].shape), np.zeros((5, 0))
    if rows == "contacts":
        for row in q:
            row[2] -= scene.gaps(row)[scene.core.con_plane >= 0].min() + 1e-3
    found = ComplementarityModel(scene, **mujocos(scene)).predict(q, v, u)
    assert (found.status == SolverStatus.CONVERGED).all()
    alone = theirs.geom_bodyid > 0  # links touch the floor alone here, in both
    theirs.geom_contype[alone], theirs.geom_conaffinity[alone] = 0, theirs.geom_conaffinity[alone]
    for k in range(len(q)):
        mujoco.mj_resetData(theirs, data)
        data.qpos[:], data.qvel[:] = q[k], v[k]
        mujoco.mj_step(theirs, data)
        off = np.abs(found.v_next[k] - data.qvel).max() / np.abs(data.qvel - v[k]).max()
        assert off < (1e-9 if rows == "nothing" else 1e-3), (k, off)
