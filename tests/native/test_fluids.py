"""What a fluid does to boxes and ellipsoids is MuJoCo's; its derivatives are exact, by density and viscosity too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.info.report import describe

from .one_step import FLYING, INTEGRATORS, ROOTS, TWO_LINKS, assert_exact, assert_like_mujoco, write


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("medium", ['viscosity="2"', 'density="300"', 'density="300" viscosity="2" wind="1 -2 .5"'])
@pytest.mark.parametrize("root", ROOTS)
def test_drag_of_a_fluid(integrator: str, medium: str, root: str, tmp_path: Path) -> None:
    """On every part of a body; implicit in its velocity where MuJoCo's integrator is."""
    file = write(tmp_path, integrator, FLYING.format(root=root), f"<option {medium}/>")
    assert Scene.from_mjcf(file).core.nbox == 4
    assert_like_mujoco(file)
    named = {f"fluid_{name}" for name in ("density", "viscosity") if name in medium}
    assert {p.name for p in Scene.from_mjcf(file).parameters if p.name.startswith("fluid_")} == named
    assert_exact(file, {"q", "v", "mass"} | named)
    assert_exact(file, {"q", "v"} | named, count=5, integrator="midpoint")


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_drag_in_the_plane(integrator: str, tmp_path: Path) -> None:
    """Planar while the boxes stand upright in the plane, spatial otherwise."""
    for turn, planar in (("0 0 0", True), ("0 30 0", True), ("30 0 0", False)):
        world = TWO_LINKS.format(body="", joint="", axis="0 1 0").replace("<body pos", f'<body euler="{turn}" pos')
        world = f'<body>{world}<joint name="x" type="slide" axis="1 0 0"/><geom type="box" size=".1 .2 .3"/></body>'
        file = write(tmp_path, integrator, world, '<option density="300" viscosity="2" wind="1 -2 .5"/>')
        assert Scene.from_mjcf(file).planar == planar
        assert_like_mujoco(file)
        assert_exact(file, {"q", "v", "fluid_density", "fluid_viscosity"})
    assert "drag" in {x.name for x in Scene.from_mjcf(file).differences}


ELLIPSOID = 'fluidshape="ellipsoid" fluidcoef=".6 .3 1.2 .9 .8"'


@pytest.mark.parametrize("integrator", [*INTEGRATORS, "implicit"])
@pytest.mark.parametrize("root", ROOTS)
def test_ellipsoids_in_a_fluid(integrator: str, root: str, tmp_path: Path) -> None:
    """Drag and lift of every shape, two on one body and none on the other of it; the rest keeps its boxes."""
    world = FLYING.format(root=root).replace(
        'type="box" size=".1 .05 .03"', f'type="ellipsoid" {ELLIPSOID} size=".1 .05 .03"'
    )
    world = world.replace('type="capsule"', f'type="capsule" {ELLIPSOID}')
    world = world.replace('<site name="t"', f'<geom type="cylinder" {ELLIPSOID} size=".03 .08"/><site name="t"')
    file = write(tmp_path, integrator, world, '<option density="300" viscosity="2" wind="1 -2 .5"/>')
    core = Scene.from_mjcf(file).core
    assert (core.nbox, core.nellipsoid) == (1, 3)
    assert_like_mujoco(file)
    assert_exact(file, {"q", "v", "mass", "fluid_density", "fluid_viscosity"}, count=5)
    assert_exact(file, {"q", "v", "fluid_density", "fluid_viscosity"}, count=5, integrator="midpoint")
    assert "drags and lifts 3 ellipsoids" in describe(Scene.from_mjcf(file))


def test_ellipsoids_at_rest_and_alone(tmp_path: Path) -> None:
    """A body at rest in a fluid at rest has finite derivatives; what damps a free body is one-sided."""
    world = f'<body><freejoint/><geom type="ellipsoid" size=".1 .05 .03" {ELLIPSOID}/></body>'
    file = write(tmp_path, "implicitfast", world, '<option density="300" viscosity="2"/>')
    assert_like_mujoco(file)
    scene = Scene.from_mjcf(file)
    zero = np.zeros((1, scene.nv))
    result = ComplementarityModel(scene).predict(scene.q0[None], zero, np.zeros((1, 0)), jacobian=True)
    assert np.isfinite(result.jacobian).all()
    hinge = '<body><joint axis="0 1 0"/><geom size=".1" pos=".2 0 0" fluidshape="ellipsoid"/></body>'
    for rest, planar in (('<option density="1"/>', False), ("", True)):  # lift leaves the plane
        assert Scene.from_mjcf(write(tmp_path, "Euler", hinge, rest)).planar == planar
