"""Friction that differs by direction (pairs with two coefficients): steps of MuJoCo under both cones, derivatives."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.contact import Barrier, Exact, Gaussian
from cmbrl.contact.smoothing import Smoothing
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

from .test_adjoint import mismatch_at
from .test_convex_sliding import OPTION, their_step, touching, tumbled

FLOOR = '<geom name="floor" type="plane" size="5 5 .1"/>'
TILTED = '<geom name="floor" type="plane" size="5 5 .1" euler="0 0 30"/>'
BODY = '<body pos="0 0 .1"><freejoint/><geom name="low" mass="2" {}/></body>'
ON_IT = '<body pos="0 0 .28"><freejoint/><geom name="high" mass=".5" {}/></body>'
PAIR = '<pair geom1="{}" geom2="{}" condim="{{dim}}" friction=".8 .2 .04 .004 .001"/>'
SCENES = {
    "ball": (FLOOR + BODY.format('size=".1"'), PAIR.format("low", "floor")),
    "box": (TILTED + BODY.format('type="box" size=".15 .1 .1" euler="0 0 20"'), PAIR.format("low", "floor")),
    "capsule": (FLOOR + BODY.format('type="capsule" size=".1 .2" euler="90 0 30"'), PAIR.format("low", "floor")),
    "a ball on a box": (
        FLOOR + BODY.format('type="box" size=".2 .15 .1"') + ON_IT.format('size=".08"'),
        PAIR.format("low", "floor") + PAIR.format("high", "low"),
    ),
}
CONES = ("elliptic", "pyramidal")
DIMS = (3, 4, 6)


def write(folder: Path, name: str, dim: int, cone: str, impratio: float = 1.0) -> Path:
    file = folder / "scene.xml"
    world, pairs = SCENES[name]
    rest = f"<contact>{pairs.format(dim=dim)}</contact>"
    option = OPTION.format(impratio=impratio, cone=cone)
    file.write_text(f"<mujoco>{option}<worldbody>{world}</worldbody>{rest}</mujoco>", encoding="utf-8")
    return file


@pytest.mark.parametrize("dim", DIMS)
@pytest.mark.parametrize("cone", CONES)
@pytest.mark.parametrize("impratio", [1.0, 10.0])
@pytest.mark.parametrize("name", SCENES)
def test_a_step_is_mujocos(name: str, impratio: float, cone: str, dim: int, tmp_path: Path) -> None:
    """Pressed on the floor, at rest or sliding. With the first coefficients alone it is not."""
    file = write(tmp_path, name, dim, cone, impratio)
    q, v, u = touching(Scene.from_mjcf(file), 60)
    expected = their_step(mujoco.MjModel.from_xml_path(str(file)), q, v)
    errors = {}
    for ignore in ("", "friction_anisotropic"):
        scene = Scene.from_mjcf(file, ignore)
        model = ComplementarityModel(scene, smoothing=Exact(1e-12), sliding="convex", look_ahead=False)
        found = model.predict(q, v, u)
        assert (found.status == SolverStatus.CONVERGED).all()
        errors[ignore] = np.linalg.norm(found.v_next - expected, axis=1) / np.linalg.norm(expected - v, axis=1)
    assert errors[""].max() < 1e-5
    assert errors["friction_anisotropic"].max() > 1e-2


STEPPING = (Barrier(1e-4), 1, "semi-implicit"), (Gaussian(length=0.01, floor=1e-6), 3, "midpoint")


@pytest.mark.parametrize("dim", [3, 6])
@pytest.mark.parametrize("cone", CONES)
@pytest.mark.parametrize("sliding", ["coulomb", "convex"])
@pytest.mark.parametrize(("smoothing", "substeps", "integrator"), STEPPING)
@pytest.mark.parametrize("name", SCENES)
def test_derivatives_are_those_of_the_step(
    name: str, smoothing: Smoothing, substeps: int, integrator: str, sliding: str, cone: str, dim: int, tmp_path: Path
) -> None:
    """In q, v and parameters, friction among them; what flows backwards is the transpose."""
    scene = Scene.from_mjcf(write(tmp_path, name, dim, cone))
    q, v, u = tumbled(scene, 6)
    settings = {"smoothing": smoothing, "sliding": sliding, "substeps": substeps, "integrator": integrator}
    model = ComplementarityModel(scene, path_tolerance=1e-12, **settings)
    row = compare(model, q, v, u, 60)
    assert {"q", "v", "friction"} <= set(row["kinds"])
    assert row["worst"] < 1e-4, row
    assert row["median"] < 1e-7, row
    assert mismatch_at(model, q, v, u, np.random.default_rng(2)) < 1e-9


def test_a_skate_glides_along_and_not_across(tmp_path: Path) -> None:
    """Coulomb's law: a box that is pushed along the slippery tangent goes on, across it stops."""
    scene = Scene.from_mjcf(write(tmp_path, "ball", 3, "elliptic"))
    file = tmp_path / "skate.xml"
    pair = '<pair geom1="low" geom2="floor" friction=".9 .01 .005 .0001 .0001"/>'
    box = BODY.format('type="box" size=".1 .1 .1"')
    file.write_text(f"<mujoco><worldbody>{FLOOR}{box}</worldbody><contact>{pair}</contact></mujoco>", encoding="utf-8")
    scene = Scene.from_mjcf(file)
    model, ends = ComplementarityModel(scene, smoothing=Exact()), []
    for direction in (0, 1):
        q, v = scene.q0[None].copy(), np.zeros((1, scene.nv))
        v[0, direction] = 1.0
        for _ in range(100):
            r = model.predict(q, v, np.zeros((1, 0)))
            q, v = r.q_next, r.v_next
        ends.append(float(v[0, direction]))
    assert sorted(ends)[0] == pytest.approx(0.0, abs=1e-3)
    assert sorted(ends)[1] == pytest.approx(1.0 - 0.01 * 9.81 * 0.2, abs=1e-3)
