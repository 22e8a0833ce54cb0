"""The model around the core: settings, parameters, refusals, JSON."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl.contact import Barrier, Exact, Gaussian
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.protocol import Model
from cmbrl.scene import Scene

CUBE = Path(__file__).parents[2] / "tasks/cube_toss/scene.xml"


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene.from_mjcf(CUBE, contact_law="rigid")


def state(scene: Scene, count: int = 3) -> list[torch.Tensor]:
    v = torch.zeros(count, scene.nv, dtype=torch.float64)
    return [torch.from_numpy(np.tile(scene.q0, (count, 1))), v, torch.zeros(count, scene.nu, dtype=torch.float64)]


def test_fills_the_protocol(scene: Scene) -> None:
    model = ComplementarityModel(scene, substeps=3)
    assert isinstance(model, Model)
    assert model.dt == pytest.approx(3 * scene.timestep)
    q_next, v_next = model.step(*state(scene))
    assert q_next.shape == (3, scene.nq)
    assert v_next.shape == (3, scene.nv)
    assert q_next.dtype == v_next.dtype == torch.float64
    np.testing.assert_allclose(q_next[:, 3:].norm(dim=1).numpy(), 1.0, atol=1e-14)


def test_parameters_by_name(scene: Scene) -> None:
    model = ComplementarityModel(scene, 2)
    names = [p.name for p in scene.parameters]
    changed = model.with_parameters({"friction.cube": 0.3, "mass.cube": 2})
    expected = model.parameters.copy()
    expected[[names.index("friction.cube"), names.index("mass.cube")]] = 0.3, 2.0
    np.testing.assert_array_equal(changed.parameters, expected)
    again = changed.with_parameters({"mass.cube": 1.5})
    assert again.parameters[names.index("friction.cube")] == 0.3, "what is not named stays"
    assert changed.to_config()["substeps"] == 2
    wrong = [
        ({"friction.cub": 1.0}, "did you mean 'friction.cube'"),
        ({"mass.cube": -1}, "outside its bounds"),
        ({"mass.cube": "heavy"}, "mass.cube = 'heavy': give a number"),
    ]
    for values, told in wrong:
        with pytest.raises(UserError, match=told):
            model.with_parameters(values)


def test_a_model_tells_what_it_is(scene: Scene) -> None:
    told = repr(ComplementarityModel(scene, 2, 0.003, Barrier(1e-3)))
    for part in (repr(scene), "2 x 0.003 s", "semi-implicit", "coulomb", "Barrier"):
        assert part in told


@pytest.mark.parametrize("smoothing", [Exact(), Barrier(1e-3), Barrier(length=1e-3), Gaussian(length=0.02)])
def test_config_round_trip(scene: Scene, smoothing: Exact | Barrier | Gaussian) -> None:
    theta = scene.parameter_vector()
    theta[0] *= 1.5
    model = ComplementarityModel(scene, 2, 0.003, smoothing, "leapfrog", theta, backward_smoothing=Barrier(1e-2))
    again = ComplementarityModel.from_config(scene, json.loads(json.dumps(model.to_config())))
    assert again.to_config() == model.to_config()
    for ours, theirs in zip(model.step(*state(scene)), again.step(*state(scene)), strict=True):
        assert torch.equal(ours, theirs)


def test_settings_and_parameters_are_replaced_on_a_copy(scene: Scene) -> None:
    model = ComplementarityModel(scene)
    theta = scene.parameter_vector() * np.where(scene.parameter_vector() > 0, 1.1, 1.0)
    other = model.with_parameters(theta).with_settings(substeps=4)
    assert (other.substeps, model.substeps) == (4, 1)
    np.testing.assert_array_equal(other.parameters, theta)
    np.testing.assert_array_equal(model.parameters, scene.parameter_vector())


def test_a_derivative_of_the_step_follows_its_smoothing(scene: Scene) -> None:
    model = ComplementarityModel(scene, smoothing=Barrier(1e-2))
    assert model.with_settings(smoothing=Barrier(1e-3)).backward_smoothing == Barrier(1e-3)
    softer = model.with_settings(backward_smoothing=Barrier(1e-1))
    assert softer.with_settings(smoothing=Barrier(1e-3)).backward_smoothing == Barrier(1e-1)


def test_parameter_jacobian_is_part_of_the_whole(scene: Scene) -> None:
    model = ComplementarityModel(scene, smoothing=Barrier(1e-3))
    q, v, u = (x.numpy() for x in state(scene))
    q_next, _, dq, dv = model.parameter_jacobian(q, v, u)
    whole = model.predict(q, v, u, parameter_jacobian=True)
    np.testing.assert_array_equal(q_next, whole.q_next)
    np.testing.assert_array_equal(np.concatenate([dq, dv], 1), whole.jacobian[:, :, 2 * scene.nv + scene.nu :])


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"substeps": 0}, "from 1 to"),
        ({"time_step": -1.0}, "above 0"),
        ({"integrator": "heun"}, "leapfrog, midpoint, rk4, semi-implicit"),
        ({"integrator": "rk4", "look_ahead": True}, "choose 'leapfrog'"),
        ({"parameters": np.ones(2)}, "shape"),
        ({"smoothing": Barrier(-1.0)}, "give a number above 0"),
        ({"smoothing": Barrier()}, "exactly one"),
        ({"smoothing": Gaussian(length=0.1, derivative="half")}, "known: exact, stop"),
    ],
)
def test_settings_out_of_range_are_refused(scene: Scene, settings: dict, says: str) -> None:
    with pytest.raises(UserError, match=says):
        ComplementarityModel(scene, **settings)


def test_parameter_out_of_bounds_is_named(scene: Scene) -> None:
    theta = scene.parameter_vector()
    theta[0] = -1.0
    with pytest.raises(UserError, match=f"parameter {scene.parameters[0].name} = -1 is outside"):
        ComplementarityModel(scene, parameters=theta)


def test_wrong_tensors_are_refused(scene: Scene) -> None:
    model = ComplementarityModel(scene)
    q, v, u = state(scene)
    with pytest.raises(UserError, match=r"q is torch\.float32"):
        model.step(q.float(), v, u)
    with pytest.raises(UserError, match="give float64 of shape"):
        model.step(q, v[:, :3], u)
    with pytest.raises(UserError, match="rows"):
        model.step(q, v[:2], u)
    with pytest.raises(UserError, match="theta"):
        model.step(q, v, u, torch.zeros(3, dtype=torch.float64))


def test_impulses_come_with_jacobians_too(scene: Scene) -> None:
    """The cube at rest on the ground: what the contacts give is the same whether or not it is differentiated."""
    model = ComplementarityModel(scene, smoothing=Barrier(1e-6))
    q, v, u = (x.numpy().copy() for x in state(scene))
    q[:, 2] -= scene.gaps(scene.q0).min()
    plain, both = model.predict(q, v, u, impulse=True), model.predict(q, v, u, impulse=True, jacobian=True)
    assert plain.impulse is not None
    assert plain.impulse[:, :, 0].sum() > 0
    np.testing.assert_array_equal(both.impulse, plain.impulse)


def test_a_model_that_does_not_look_ahead_has_its_alternatives() -> None:
    """The rigid law looks ahead whatever the model of the file's softness does."""
    model = ComplementarityModel(Scene.from_mjcf(CUBE), sliding="convex", look_ahead=False)
    found = model.alternatives()
    assert not model.look_ahead
    assert {found[name].scene.contact_law for name in found} == {"mujoco", "rigid"}
    assert found["contact law rigid"].look_ahead


def test_a_model_under_rk4_has_its_alternatives(tmp_path: Path) -> None:
    """Rigid contact, which does not go with RK4, is stepped by the file's usual integrator."""
    file = tmp_path / "ball.xml"
    file.write_text(
        '<mujoco><option integrator="RK4"/><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 1"><freejoint/>'
        '<geom size=".1"/></body></worldbody></mujoco>'
    )
    found = ComplementarityModel(Scene.from_mjcf(file), integrator="rk4").alternatives()
    assert found["contact law rigid"].integrator == "midpoint"
