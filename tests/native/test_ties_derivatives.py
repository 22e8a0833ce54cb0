"""Equality constraints and tendons: derivatives are the step's, alone, with contacts and at impacts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.bench.states import Ranges, random_states
from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.contact import Barrier, Gaussian
from cmbrl.contact.smoothing import Smoothing
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.step_settings import INTEGRATORS
from cmbrl.scene import Scene

from .test_adjoint import mismatch_at
from .tied_scenes import (
    CASES,
    PLANAR,
    SOFT,
    equality,
    states_of,
    string,
    write,
)


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
