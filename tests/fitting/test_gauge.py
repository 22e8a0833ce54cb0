"""The unit of force that motion does not tell: parameters that the file does not have say nothing of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl.fitting.search.gauge import common_factors, distance, nearest
from cmbrl.fitting.search.space import Space
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.records import Parameter


def _space() -> Space:
    scales = [Parameter(f"mass.{k}", "mass", 1.0, 0.2, 5.0, "log", "1") for k in range(3)]
    new = [Parameter(f"armature.{k}", "armature", 0.0, 0.0, 1.0, "linear", "kg m^2") for k in range(6)]
    gain = Parameter("kp.a", "kp", 100.0, 20.0, 500.0, "log", "1")
    return Space.of((*scales, *new, gain), np.array([1.0] * 3 + [0.0] * 6 + [100.0]))


def test_what_the_file_does_not_have_does_not_pull_the_unit_down() -> None:
    """Rotors on six joints: with a unit half as large they were half as far from the file's zero."""
    space = _space()
    z = space.z(np.array([1.0] * 3 + [0.3] * 6 + [100.0]))
    members = [list(range(len(space)))]
    np.testing.assert_allclose(space.theta(nearest(space, z, members)), space.theta(z), rtol=1e-3)
    assert distance(space, z) == 0.0


def test_a_unit_that_is_off_goes_back_with_all_that_scales_by_it() -> None:
    space = _space()
    theta = np.array([0.5, 0.4, 0.6] + [0.15] * 6 + [50.0])
    found = space.theta(nearest(space, space.z(theta), [list(range(len(space)))]))
    np.testing.assert_allclose(found / theta, found[0] / theta[0])
    np.testing.assert_allclose(found[0] / theta[0], 2.0, rtol=0.05)


LEG = """<mujoco><option timestep="0.005"/><worldbody><geom type="plane" size="5 5 .1"/><body pos="0 0 .45">
  <joint type="slide" axis="0 0 1"/><geom size=".1"/>
  <body><joint type="hinge" axis="0 1 0" damping=".5" armature=".02"/>
  <geom type="capsule" size=".05" fromto="0 0 0 .1 0 -.4"/></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize("law", ["mujoco", "rigid", "spring-damper"])
def test_no_motion_tells_the_common_factor(law: str, tmp_path: Path) -> None:
    """Under every law of contact: springs and dampers are told in N, and scale with the masses that they carry."""
    (tmp_path / "leg.xml").write_text(LEG)
    scene = Scene.from_mjcf(tmp_path / "leg.xml", contact_law=law)
    model = ComplementarityModel(scene)
    (together,) = common_factors(scene.core, np.array([p.default for p in scene.parameters]))
    scaled = model.parameters.copy()
    scaled[together] *= 1.3
    groups = {scene.parameters[k].group for k in together}
    assert groups >= {"mass", "damping", "armature"}
    assert ("contact_stiffness" in groups) == ("contact_damping" in groups) == (law == "spring-damper")
    q, v = (torch.tensor([x], dtype=torch.float64) for x in ([-0.01, 0.1], [-1.0, 2.0]))
    u = torch.zeros(1, 0, dtype=torch.float64)
    step, other = model.step(q, v, u)[1], model.with_parameters(scaled).step(q, v, u)[1]
    free = model.with_parameters(scaled).step(q + torch.tensor([[1.0, 0.0]]), v, u)[1]
    assert (step - free).abs().max() > 0.1  # it touches
    torch.testing.assert_close(other, step, rtol=1e-7, atol=1e-7)


FISH = """<mujoco><option timestep="0.005" integrator="implicitfast" density="{density}" viscosity=".2"/>
  <worldbody><body><freejoint/><geom type="box" size=".2 .05 .06"/><body pos=".2 0 0">
  <joint axis="0 0 1" name="tail" damping=".1"/><geom type="capsule" size=".05"
  fromto="0 0 0 .3 0 0" fluidshape="ellipsoid"/></body></body></worldbody>
  <actuator><motor joint="tail"/></actuator></mujoco>"""


def test_a_fluid_scales_with_the_masses_in_it(tmp_path: Path) -> None:
    """A known density of water tells them, one of air does not."""

    def scene_in(density: float) -> Scene:
        (tmp_path / "fish.xml").write_text(FISH.format(density=density))
        return Scene.from_mjcf(tmp_path / "fish.xml", ignore="")

    scene = scene_in(1000.0)
    free = np.array([p.default for p in scene.parameters])
    (together,) = common_factors(scene.core, free)
    assert {"fluid_density", "fluid_viscosity", "mass"} <= {scene.parameters[k].group for k in together}
    model = ComplementarityModel(scene)
    scaled = model.parameters.copy()
    scaled[together] *= 1.3
    q = np.array([scene.q0])
    v, u = np.random.default_rng(0).normal(size=(1, scene.nv)), np.ones((1, 1))
    step, still = model.predict(q, v, u), model.predict(q, v, u, theta=scaled)
    np.testing.assert_allclose(still.v_next, step.v_next, rtol=1e-9, atol=1e-9)
    for density, count in ((1000.0, 0), (1.2, 1)):
        scene = scene_in(density)
        free = np.array([p.default and p.name != "fluid_density" for p in scene.parameters])
        assert len(common_factors(scene.core, free)) == count
