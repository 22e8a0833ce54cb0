"""The neural ensemble: it learns, rests on the manifold, stops when told, and comes back from disk as it was."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl import Scene, Transitions, UserError
from cmbrl.models.neural.ensemble import EnsembleConfig, NeuralEnsemble
from cmbrl.models.neural.network import EnsembleNetwork

DT = 0.02
WORLD = """<mujoco><worldbody><geom type="plane" size="5 5 .1"/>
<body pos="0 0 1"><freejoint/><geom type="box" size=".1 .1 .1"/>
<body><joint name="j" type="hinge" axis="0 1 0"/><geom size=".05" pos=".2 0 0"/></body></body></worldbody>
<actuator><motor joint="j"/></actuator></mujoco>"""
SMALL = EnsembleConfig(nets=3, elites=2, hidden=2, width=32, weight_decay=(0.0,) * 3, learning_rate=3e-3, updates=600)


@pytest.fixture
def body(tmp_path: Path) -> Scene:
    (tmp_path / "scene.xml").write_text(WORLD, encoding="utf-8")
    return Scene.from_mjcf(tmp_path / "scene.xml")


def falling(scene: Scene, rows: int = 400, seed: int = 0) -> Transitions:
    """Free fall with a driven hinge: a smooth map, so that learning it takes seconds."""
    rng = np.random.default_rng(seed)
    q = scene.integrate(np.repeat(scene.q0[None], rows, axis=0), rng.normal(0, 0.5, (rows, scene.nv)))
    v, u = rng.normal(size=(rows, scene.nv)), rng.uniform(-1, 1, (rows, 1))
    v_next = v.copy()
    v_next[:, 2] -= DT * 9.81
    v_next[:, 6] += u[:, 0] - 0.5 * np.sin(q[:, 7])
    q_next = scene.integrate(q, DT * v_next)
    return Transitions(q=q, v=v, u=u, q_next=q_next, v_next=v_next, dt=DT, episode=np.arange(rows))


def tensors(data: Transitions) -> list[torch.Tensor]:
    return [torch.as_tensor(a) for a in (data.q, data.v, data.u)]


def test_learns_and_keeps_quaternions_unit(body: Scene) -> None:
    model = NeuralEnsemble(body, DT, SMALL)
    calls: list[float] = []
    report = model.fit(falling(body), seed=1, progress=lambda share, text: calls.append(share))
    assert (report.stopped, report.updates) == ("updates", 600)
    assert report.rows + report.holdout_rows == 400
    assert len(calls) == report.epochs
    assert report.holdout_error < 0.15
    test = falling(body, seed=7)
    q_next, v_next = model.step(*tensors(test))
    assert q_next.dtype == v_next.dtype == torch.float64
    np.testing.assert_allclose(torch.linalg.vector_norm(q_next[:, 3:7], dim=1).detach().numpy(), 1, atol=1e-12)
    error = np.abs(v_next.detach().numpy()[:, 6] - test.v_next[:, 6])
    assert error.mean() < 0.2 * np.abs(test.v_next - test.v)[:, 6].mean()


def test_same_seed_same_weights_other_seed_others(body: Scene) -> None:
    data, config = falling(body, 100), dataclasses.replace(SMALL, updates=30)
    results = []
    for seed in (0, 0, 1):
        model = NeuralEnsemble(body, DT, config)
        model.fit(data, seed=seed)
        results.append(model.step(*tensors(data))[1].detach())
    assert torch.equal(results[0], results[1])
    assert not torch.equal(results[0], results[2])


def test_save_and_load(body: Scene, tmp_path: Path) -> None:
    model = NeuralEnsemble(body, DT, dataclasses.replace(SMALL, angles="periodic", updates=30))
    data = falling(body, 100)
    model.fit(data)
    model.save(tmp_path / "net")
    again = NeuralEnsemble.load(tmp_path / "net")
    assert again.dt == DT
    assert again.config == model.config
    for a, b in zip(model.step(*tensors(data)), again.step(*tensors(data)), strict=True):
        assert torch.equal(a, b)
    again.fit(data, warm_start=True, max_seconds=0.0)  # a loaded ensemble can learn on, without its scene


def test_load_says_what_is_wrong(body: Scene, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such file"):
        NeuralEnsemble.load(tmp_path / "nothing")
    NeuralEnsemble(body, DT, SMALL).save(tmp_path / "net")
    (tmp_path / "net/weights.safetensors").write_bytes(b"damaged")
    with pytest.raises(UserError, match=r"weights\.safetensors: damaged.*train it again"):
        NeuralEnsemble.load(tmp_path / "net")
    (tmp_path / "net/ensemble.json").write_text('{"kind": "other"}', encoding="utf-8")
    with pytest.raises(UserError, match=r"net: not a saved ensemble"):
        NeuralEnsemble.load(tmp_path / "net")


def test_gradients_pass_through_a_step(body: Scene) -> None:
    model = NeuralEnsemble(body, DT, SMALL)
    q, v, u = (a[:2].requires_grad_() for a in tensors(falling(body, 10)))
    model.network.double()
    assert torch.autograd.gradcheck(lambda *state: model.step(*state), (q, v, u), atol=1e-6)


def test_x_and_y_are_no_features_over_a_floor(body: Scene) -> None:
    model = NeuralEnsemble(body, DT, SMALL)
    assert model.dropped == [0, 1]
    q, v, u = tensors(falling(body, 5))
    shifted = q.clone()
    shifted[:, :2] += 3.0
    moved, still = model.step(shifted, v, u)[0], model.step(q, v, u)[0]
    np.testing.assert_allclose((moved - still)[:, :2].detach().numpy(), 3.0, atol=1e-12)
    assert torch.equal(moved[:, 2:], still[:, 2:])
    periodic = NeuralEnsemble(body, DT, dataclasses.replace(SMALL, angles="periodic"))
    flipped = q.clone()
    flipped[:, 3:7] *= -1
    assert torch.allclose(periodic.features(q, v, u), periodic.features(flipped, v, u))


def test_samples_differ_between_rows_and_repeat_by_seed(body: Scene) -> None:
    model = NeuralEnsemble(body, DT, SMALL)
    q, v, u = (a[:1].expand(50, -1) for a in tensors(falling(body, 10)))
    draws = [model.step(q, v, u, sample=True, generator=torch.Generator().manual_seed(s))[1] for s in (0, 0, 1)]
    assert torch.equal(draws[0], draws[1])
    assert not torch.equal(draws[0], draws[2])
    assert draws[0].std(dim=0).min() > 0


def test_original_settings_learn_raw_targets(body: Scene) -> None:
    original = EnsembleConfig.original()
    model = NeuralEnsemble(body, DT, dataclasses.replace(original, nets=3, elites=2, width=16, patience=0))
    report = model.fit(falling(body, 50))
    assert report.stopped == "patience"
    assert model.network.target_scale.eq(1).all()
    assert (original.nets, original.elites, original.hidden, original.width, original.batch) == (7, 5, 4, 200, 256)


def test_refuses_a_log_too_short_or_of_another_step(body: Scene) -> None:
    with pytest.raises(UserError, match="at least 10"):
        NeuralEnsemble(body, DT, SMALL).fit(falling(body, 9))
    with pytest.raises(UserError, match="dt"):
        NeuralEnsemble(body, 0.01, SMALL).fit(falling(body, 20))


def test_time_ends_training(body: Scene) -> None:
    report = NeuralEnsemble(body, DT, dataclasses.replace(SMALL, updates=10**9)).fit(falling(body, 50), max_seconds=0.5)
    assert report.stopped == "max_seconds"
    assert report.seconds < 5


def test_interrupted_training_keeps_the_best(body: Scene) -> None:
    def stop(share: float, text: str) -> None:
        raise KeyboardInterrupt

    model = NeuralEnsemble(body, DT, SMALL)
    report = model.fit(falling(body, 50), progress=stop)
    assert (report.stopped, report.epochs) == ("interrupted", 1)


def test_one_batched_product_equals_net_by_net() -> None:
    network = EnsembleNetwork(3, 4, 2, hidden=2, width=8).double()
    network.reset(torch.Generator().manual_seed(0))
    x = torch.randn(5, 4, dtype=torch.float64)
    mean, log_variance = network(x.expand(3, -1, -1))
    for k in range(3):
        hidden = x
        for layer, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
            hidden = (hidden * torch.sigmoid(hidden) if layer else hidden) @ weight[k] + bias[k]
        assert torch.allclose(mean[k], hidden[:, :2])
    assert (log_variance < 0.5).all()
    assert (log_variance > -10).all()
    picked, _ = network(x.expand(2, -1, -1), torch.tensor([2, 0]))
    assert torch.allclose(picked, mean[[2, 0]])


def test_new_input_scales_leave_the_function_as_it_was(body: Scene) -> None:
    model = NeuralEnsemble(body, DT, SMALL)
    model.network.double()
    q, v, u = tensors(falling(body, 20))
    before = model.step(q, v, u)
    width = model.network.input_mean.shape[0]
    draw = torch.Generator().manual_seed(0)
    mean, scale = (torch.rand(2, width, generator=draw, dtype=torch.float64) + 0.5).unbind()
    model.network.standardise_inputs(mean, scale)
    assert torch.equal(model.network.input_mean, mean)
    for a, b in zip(before, model.step(q, v, u), strict=True):
        np.testing.assert_allclose(a.numpy(), b.numpy(), atol=1e-12)


def test_draws_have_the_mean_and_deviation_of_the_elites(body: Scene) -> None:
    model = NeuralEnsemble(body, DT, SMALL)
    model.elites = torch.tensor([2, 0])
    count = 40_000
    q, v, u = (a[:1].expand(count, -1) for a in tensors(falling(body, 10)))
    inputs = (model.features(q[:1], v[:1], u[:1])).float()
    mean, log_variance = model.network(inputs.expand(2, -1, -1), model.elites)
    expected = mean[:, 0].mean(dim=0)
    variance = log_variance[:, 0].exp().mean(dim=0) + mean[:, 0].var(dim=0, correction=0)  # law of total variance
    drawn = model.step(q, v, u, sample=True, generator=torch.Generator().manual_seed(3))[1] - v
    columns = slice(v.shape[1], None)
    error = (drawn.mean(dim=0) - expected[columns]) / (variance[columns] / count).sqrt()
    assert error.abs().max() < 5
    np.testing.assert_allclose(drawn.var(dim=0).numpy(), variance[columns].numpy(), rtol=0.05)


def test_updates_asked_for_replace_those_of_the_configuration(body: Scene) -> None:
    model = NeuralEnsemble(body, DT, SMALL)
    assert model.fit(falling(body, 50), updates=7).updates == 7
    assert not any(p.requires_grad for p in model.network.parameters())
