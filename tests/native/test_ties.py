"""Equality constraints and tendons: steps are MuJoCo's, also of robots, and wild states are solved or flagged."""

from __future__ import annotations

import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.contact import Exact
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

from .tied_scenes import (
    CASES,
    HUNG,
    PLANAR,
    SPATIAL,
    arm,
    skip_if_another_law,
    states_of,
    string,
    tendon,
    write,
)

MENAGERIE = Path(__file__).parents[3] / "shared/models/menagerie"  # beside the checkout, as G1
TIED = ("agility_cassie", "aloha", "franka_emika_panda", "pal_talos", "toddlerbot_2xc", "robotiq_2f85_v4")


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
