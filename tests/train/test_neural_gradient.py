"""First-order gradients through the neural ensemble: SHAC on it is the direct competitor of SHAC on our model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl import Scene, UserError
from cmbrl.envs.disturbance import Disturbance
from cmbrl.envs.evaluation import evaluate_real
from cmbrl.envs.recording import Recording
from cmbrl.envs.simulation import Simulation
from cmbrl.models.neural.ensemble import EnsembleConfig, NeuralEnsemble
from cmbrl.train.shac import SHAC, SHACConfig

from . import slider

NET = EnsembleConfig(
    nets=3, elites=2, hidden=2, width=24, weight_decay=(0.0,) * 3, learning_rate=5e-3, updates=300, batch=64
)
CART = """<mujoco><worldbody><body><joint name="x" type="slide" axis="1 0 0"/><geom size=".1" mass="1"/>
<body><joint name="pole" type="hinge" axis="0 1 0"/><geom size=".05" pos="0 0 -.5" mass=".1"/></body></body></worldbody>
<actuator><motor joint="x"/></actuator></mujoco>"""


def fitted(folder: Path) -> NeuralEnsemble:
    recording = Recording(slider.mdp(), slider.system(folder), seed=1)
    draw = torch.Generator().manual_seed(1)
    for _ in range(300):
        recording.step(2 * torch.rand(1, 1, generator=draw, dtype=torch.float64) - 1)
    model = NeuralEnsemble(slider.scene(folder), slider.DT, NET)
    model.fit(recording.log())
    return model


def test_gradient_of_a_rollout_is_its_finite_difference(tmp_path: Path) -> None:
    model = NeuralEnsemble(slider.scene(tmp_path), slider.DT, NET)
    model.network.double()  # finite differences of float32 nets are noise

    def total(gain: torch.Tensor) -> torch.Tensor:
        simulation = Simulation(slider.mdp(), model, 4, seed=2)
        steps = [simulation.step(o := simulation.observe(), torch.tanh(o @ gain)) for _ in range(8)]
        return torch.stack([step.reward for step in steps]).sum()

    gain = torch.tensor([[-0.5], [0.3]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(total, (gain,), eps=1e-6, atol=1e-6)
    assert all(p.grad is None for p in model.network.parameters())  # nor is anything computed for them


def test_shac_learns_on_the_ensemble_what_holds_in_reality(tmp_path: Path) -> None:
    config = SHACConfig(iterations=40, environments=16, horizon=8, actor_hidden=(24,), critic_hidden=(24,),
                        actor_rate=1e-2, discount=0.95, noise_linear=0.01)  # fmt: skip
    shac = SHAC(slider.mdp(), fitted(tmp_path), config)
    before = evaluate_real(lambda o: torch.zeros(len(o), 1), slider.mdp(), slider.system(tmp_path), 10).returns.mean()
    for _ in range(config.iterations):
        metrics = shac.update()
    after = evaluate_real(shac.policy, slider.mdp(), slider.system(tmp_path), 10).returns.mean()
    assert (after - before) / (20 - before) > 0.25  # of what there is to gain: at best 1 in each of 20 steps
    assert np.isfinite(metrics["gradient_norm"])


def test_velocity_noise_is_linear_or_angular_by_joint(tmp_path: Path) -> None:
    (tmp_path / "cart.xml").write_text(CART, encoding="utf-8")
    model = NeuralEnsemble(Scene.from_mjcf(tmp_path / "cart.xml"), slider.DT, NET)
    assert model.coordinates.slides_v == (0,)
    still = replace(slider.mdp(), reset=lambda count, generator: torch.zeros(2, count, 2, dtype=torch.float64).unbind())
    velocities = []
    for disturbance in (None, Disturbance(linear=0.5, angular=0.1)):
        simulation = Simulation(still, model, 4000, disturbance=disturbance)
        simulation.step(simulation.observe(), torch.zeros(4000, 1))
        velocities.append(simulation.v.detach())
    noise = velocities[1] - velocities[0]
    np.testing.assert_allclose(noise.std(dim=0).numpy(), [0.5, 0.1], rtol=0.05)


def test_noise_needs_a_model_that_knows_its_robot(tmp_path: Path) -> None:
    class Nobody:
        name, dt = "nobody", slider.DT
        step = None

    with pytest.raises(UserError, match="nobody has no coordinates"):
        Simulation(slider.mdp(), Nobody(), 2, disturbance=Disturbance(linear=0.1))  # type: ignore[arg-type]
