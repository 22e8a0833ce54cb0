"""Bundled Contact Gradients: identities without noise, finite differences with it, and the rules of the branches."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from cmbrl.contact import Barrier
from cmbrl.envs.simulation import Simulation
from cmbrl.errors import UserError
from cmbrl.gradients.bcg import BundleConfig, BundledContactModel, mean_state
from cmbrl.gradients.offsets import ContactOffsets
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.manifold import Coordinates
from cmbrl.registry import load_task
from cmbrl.scene import Scene

LEG = """<body pos="0 {y} -.1"><joint name="hip_{n}" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".03" mass="1" contype="0" conaffinity="0"/>
<body pos="0 0 -.2"><joint name="knee_{n}" axis="0 1 0"/><geom name="foot_{n}" size=".05" pos=".1 0 -.2" mass="1"/>
</body></body>"""
WALKER = f"""<mujoco><option timestep="0.005"/><worldbody><geom name="ground" type="plane" size="9 9 1"/>
<body pos="0 0 .62"><freejoint/><geom type="box" size=".1 .1 .1" mass="5" contype="0" conaffinity="0"/>
{LEG.format(n="l", y=0.1)}{LEG.format(n="r", y=-0.1)}</body></worldbody>
<actuator><motor joint="hip_l"/><motor joint="knee_l"/></actuator></mujoco>"""
NAMES = ("hopper", "cheetah", "cube", "walker")


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> dict[str, ComplementarityModel]:
    """Planar robots, a free cube, a floating base on two legs: smooth enough to be differentiated by differences."""
    file = tmp_path_factory.mktemp("walker") / "walker.xml"
    file.write_text(WALKER, encoding="utf-8")
    scenes = {
        n: load_task(t).load_scene() for n, t in {"hopper": "hopper", "cheetah": "cheetah", "cube": "cube_toss"}.items()
    }
    scenes["walker"] = Scene.from_mjcf(file)
    settings = {"smoothing": Barrier(1e-4), "path_tolerance": 1e-12, "prune": np.inf}
    return {n: ComplementarityModel(s, substeps=2, time_step=0.002, **settings) for n, s in scenes.items()}


def start(model: ComplementarityModel, name: str, rows: int = 3) -> tuple[Tensor, Tensor, Tensor]:
    """States that fall onto their contacts, each a little different."""
    scene, rng = model.scene, np.random.default_rng(3)
    q = np.tile(scene.q0, (rows, 1))
    height = 1 if scene.planar else 2
    q = scene.integrate(q, 0.02 * rng.normal(size=(rows, scene.nv)))
    lowest = scene.gaps(q).min(axis=1)
    q[:, height] -= lowest + 1e-3
    v = 0.1 * rng.normal(size=(rows, scene.nv))
    v[:, height] -= 0.5
    u = 0.3 * rng.normal(size=(rows, scene.nu))
    return torch.from_numpy(q), torch.from_numpy(v), torch.from_numpy(u)


def rolled(model, q: Tensor, v: Tensor, u: Tensor, steps: int = 5):  # type: ignore[no-untyped-def]
    """Final state under feedback of the velocity, so that an action depends on the mean."""
    for _ in range(steps):
        q, v = model.step(q, v, u * torch.tanh(1.0 + v[:, : u.shape[1]]))
    return q, v


def gradients(model, q: Tensor, v: Tensor, u: Tensor):  # type: ignore[no-untyped-def]
    inputs = [x.clone().requires_grad_() for x in (q, v, u)]
    ends = rolled(model, *inputs)
    rng = np.random.default_rng(0)
    loss = sum((x * torch.from_numpy(rng.normal(size=x.shape))).sum() for x in ends)
    used = [x for x in inputs if x.numel()]
    return [x.detach() for x in ends], list(torch.autograd.grad(loss, used))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("branches", [1, 4])
def test_no_noise_no_change(name: str, branches: int, models: dict[str, ComplementarityModel]) -> None:
    model = models[name]
    config = BundleConfig(branches, 2, trigger=1e-3, position=0.0, velocity=0.0)
    bundled = BundledContactModel(model, config)
    state = start(model, name)
    for ours, plain in zip(gradients(bundled, *state), gradients(model, *state), strict=True):
        for a, b in zip(ours, plain, strict=True):
            torch.testing.assert_close(a, b, rtol=1e-8, atol=1e-9)
    assert bundled.bundles > 0
    assert bundled.lost == 0


@pytest.mark.parametrize("name", NAMES)
def test_with_noise_it_is_the_derivative_of_the_mean(name: str, models: dict[str, ComplementarityModel]) -> None:
    """Central differences along every tangent direction of the state, the offsets held."""
    model = models[name]
    q, v, u = start(model, name, 1)
    bundled = BundledContactModel(model, BundleConfig(3, 2, trigger=1e-3, position=1e-3, velocity=0.02))
    rng, scene, layout = np.random.default_rng(1), model.scene, Coordinates.from_scene(model.scene)
    dq, dv = bundled.offsets.draw(q.numpy(), v.numpy(), np.ones((1, len(scene.contact_names))), None, 3, rng)
    bundled.offsets.draw = lambda q, v, load, *_: (np.repeat(dq, len(q), 0), np.repeat(dv, len(q), 0))  # type: ignore
    weight = torch.from_numpy(rng.normal(size=2 * scene.nv))
    at_end = [x.detach() for x in _two(bundled, q, v, u)]

    def value(z: Tensor) -> Tensor:
        """Of states moved by z (B, 2 nv), in tangent coordinates at the end."""
        bundled.forget()
        moved = layout.integrate(q.expand(len(z), -1), z[:, : scene.nv]), v + z[:, scene.nv :]
        q_end, v_end = _two(bundled, *moved, u.expand(len(z), -1))
        q_there = at_end[0].expand(len(z), -1)
        return torch.cat([layout.difference(q_there, q_end), v_end], dim=1) @ weight

    z = torch.zeros(1, 2 * scene.nv, dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(value(z).sum(), z)
    step = 1e-6
    with torch.no_grad():
        moves = step * torch.eye(2 * scene.nv, dtype=torch.float64)
        differences = (value(moves) - value(-moves)) / (2 * step)
    torch.testing.assert_close(gradient[0], differences, rtol=2e-4, atol=2e-4 * float(differences.abs().max()))


def _two(model: BundledContactModel, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Both steps of one bundle."""
    started = model.bundles
    end = rolled(model, q, v, u, 2)
    assert model.bundles == started + len(q)
    return end


def test_costs_and_life_of_a_bundle(models: dict[str, ComplementarityModel]) -> None:
    """A plain step finds the force; two bundled ones; then the next plain one finds it again."""
    model = models["walker"]
    q, v, u = start(model, "walker", 2)
    q[1, 2] += 1.0  # in flight
    bundled = BundledContactModel(model, BundleConfig(4, 2, trigger=1e-3))
    steps = []
    for _ in range(4):
        before = bundled.steps
        q, v = bundled.step(q, v, u)
        steps.append(bundled.steps - before)
    assert steps == [2 + 4, 1 + 4, 2 + 4, 1 + 4]
    assert bundled.bundles == 2


def test_high_trigger_is_the_model(models: dict[str, ComplementarityModel]) -> None:
    bundled = BundledContactModel(models["hopper"], BundleConfig(trigger=1e9))
    state = start(models["hopper"], "hopper")
    for a, b in zip(rolled(bundled, *state), rolled(models["hopper"], *state), strict=True):
        assert torch.equal(a, b)
    assert bundled.bundles == 0
    default = BundledContactModel(models["hopper"])
    assert default.trigger == pytest.approx(1.2 * 9.81 * models["hopper"].scene.total_mass)


def test_restarted_rows_drop_their_bundle(models: dict[str, ComplementarityModel]) -> None:
    """A row that was moved is stepped as by a new model; one whose velocity was pushed keeps its branches, pushed."""
    model = models["walker"]
    q, v, u = start(model, "walker", 2)
    bundled = BundledContactModel(model, BundleConfig(3, 5, trigger=1e-3))
    q1, v1 = bundled.step(q, v, u)
    high = q1.clone()
    high[0, 2] += 1.0
    pushed = v1 + torch.tensor([[0.0], [0.01]], dtype=torch.float64)
    branches = bundled._kept
    assert branches is not None
    q2, v2 = bundled.step(high, pushed, u)
    fresh = model.step(high[:1], pushed[:1], u[:1])
    assert torch.equal(q2[:1], fresh[0])
    assert torch.equal(v2[:1], fresh[1])
    one = model.step(branches.q[1], branches.v[1] + 0.01, u[1:].expand(3, -1))
    expected = mean_state(bundled.coordinates, one[0][None], one[1][None], torch.ones(1, 3, dtype=torch.bool))
    torch.testing.assert_close(q2[1:], expected[0])
    torch.testing.assert_close(v2[1:], expected[1])


def test_a_cut_graph_drops_bundles(models: dict[str, ComplementarityModel]) -> None:
    """Windows are differentiated one by one: nothing reaches back into the last one."""
    model = models["hopper"]
    bundled = BundledContactModel(model, BundleConfig(3, 4, trigger=1e-3))
    q, v, u = start(model, "hopper")
    for _ in range(2):
        u = u.detach().requires_grad_()
        q, v = rolled(bundled, q.detach(), v.detach(), u, 2)
        v.sum().backward()
        assert u.grad is not None
        assert torch.isfinite(u.grad).all()


def test_broken_branches_leave_the_mean(models: dict[str, ComplementarityModel]) -> None:
    model = models["walker"]
    bundled = BundledContactModel(model, BundleConfig(3, 2, trigger=1e-3, position=0.0, velocity=0.0))
    q, v, u = (x.requires_grad_() for x in start(model, "walker", 2))
    broken = np.zeros((2, 3, model.scene.nv))
    broken[0, 1, 0] = np.nan  # one of row 0
    broken[1, :, 0] = np.nan  # all of row 1
    bundled.offsets.draw = lambda *_: (0 * np.nan_to_num(broken), broken)  # type: ignore
    q1, v1 = bundled.step(q, v, u)
    plain = model.step(q, v, u)
    torch.testing.assert_close(q1[0], plain[0][0])
    torch.testing.assert_close(v1[0], plain[1][0])
    assert torch.isnan(v1[1]).all()
    assert bundled.lost == 4
    ours = torch.autograd.grad(v1[0].sum(), (q, v, u), retain_graph=True)
    expected = torch.autograd.grad(plain[1][0].sum(), (q, v, u))
    for a, b in zip(ours, expected, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-8, atol=1e-9)
    _, v2 = bundled.step(q1, v1, u)  # the lost branch stays out, the lost row is the model's own again
    torch.testing.assert_close(v2[0], model.step(*plain, u)[1][0], rtol=1e-8, atol=1e-9)
    assert bundled.lost == 4


def test_mean_of_quaternions(models: dict[str, ComplementarityModel]) -> None:
    """Of q and -q it is q; of two turns by +-a about one axis no turn; always of unit length."""
    layout = Coordinates.from_scene(models["cube"].scene)
    q = torch.zeros(1, 2, 7, dtype=torch.float64)
    q[0, 0, 3:], q[0, 1, 3:] = torch.tensor([0.6, 0.8, 0, 0]), -torch.tensor([0.6, 0.8, 0, 0])
    v, alive = torch.zeros(1, 2, 6, dtype=torch.float64), torch.ones(1, 2, dtype=torch.bool)
    torch.testing.assert_close(mean_state(layout, q, v, alive)[0][0], q[0, 0])
    turn = torch.tensor([[[0, 0, 0, 0.3, 0, 0], [0, 0, 0, -0.3, 0, 0]]], dtype=torch.float64)
    turned = layout.integrate(q, turn)
    mean = mean_state(layout, turned, v, alive)[0]
    torch.testing.assert_close(mean[0], q[0, 0], rtol=1e-6, atol=1e-6)


def test_offsets_move_the_contact_by_the_noise(models: dict[str, ComplementarityModel]) -> None:
    """Damping aside, the contact point moves by the noise drawn; other chains and the base stay where they are."""
    model = models["walker"]
    q, v, _ = start(model, "walker", 1)
    offsets = ContactOffsets(model, 1e-3, 0.0, 1e-12)
    contact = model.scene.contact_names.index("foot_l - ground")
    load = np.eye(len(model.scene.contact_names))[[contact]]
    dq, dv = offsets.draw(q.numpy(), v.numpy(), load, None, 400, np.random.default_rng(0))
    legs = [model.scene.coordinate_names.index(n) for n in ("hip_l", "knee_l")]
    assert np.abs(dq[..., legs]).min() > 0
    assert not np.delete(dq, legs, axis=2).any()
    assert not dv.any()
    J = model.smooth_dynamics(q.numpy(), v.numpy())["J"][0, contact]
    moved = dq[0] @ J.T  # two joints about y move the point in the plane x, z only
    np.testing.assert_allclose(np.sort(moved.std(axis=0)), [0, 1e-3, 1e-3], atol=1.2e-4)


def test_one_perturbation_for_each_chain(models: dict[str, ComplementarityModel]) -> None:
    """A foot or a cube that touches in several points is moved once, at the most loaded."""
    model = models["cube"]
    q, v, _ = start(model, "cube", 1)
    offsets = ContactOffsets(model, 1.0, 1.0, 1e-12)
    load = np.zeros((1, 8))
    load[0, [2, 5]] = 1.0, 3.0
    dq, dv = offsets.draw(q.numpy(), v.numpy(), load, None, 4, np.random.default_rng(0))
    assert np.linalg.matrix_rank(np.concatenate([dq[0], dv[0]])) == 3
    J = model.smooth_dynamics(q.numpy(), v.numpy())["J"][0, 5]
    noise = np.random.default_rng(0).normal(size=(1, 4, 3))
    np.testing.assert_allclose(dq[0] @ J.T, noise[0], atol=1e-8)


def test_in_a_simulation(models: dict[str, ComplementarityModel]) -> None:
    """Episodes that end and restart, noise on velocities: finite, and the counters add up."""
    mdp = load_task("hopper").mdp
    assert mdp is not None
    bundled = BundledContactModel(models["hopper"], BundleConfig(3, trigger=1.0))
    simulation = Simulation(mdp(), bundled, 4, seed=0)
    action = torch.full((4, 3), 0.3, dtype=torch.float64, requires_grad=True)
    total = torch.zeros(4, dtype=torch.float64)
    for _ in range(60):
        total = total + simulation.step(simulation.observe(), action).reward
    (gradient,) = torch.autograd.grad(total.sum(), action)
    assert torch.isfinite(gradient).all()
    assert bundled.steps > simulation.steps_taken
    assert bundled.bundles > 0


def test_state_continues(models: dict[str, ComplementarityModel]) -> None:
    model = models["hopper"]
    one, other = (BundledContactModel(model, BundleConfig(3, trigger=1.0), seed) for seed in (0, 1))
    state = start(model, "hopper")
    rolled(one, *state)
    other.restore(one.state())
    one.forget()
    for a, b in zip(rolled(one, *state), rolled(other, *state), strict=True):
        assert torch.equal(a, b)
    assert one.steps == other.steps


def test_refusals(models: dict[str, ComplementarityModel]) -> None:
    for config in (BundleConfig(branches=0), BundleConfig(position=-1.0), BundleConfig(damping=0.0)):
        with pytest.raises(UserError, match="at least one branch"):
            BundledContactModel(models["hopper"], config)


def test_g1() -> None:
    """Without noise the model's states and gradients; each foot is a chain of six joints, the pelvis in neither."""
    from cmbrl.bench.scenes import paired

    found = paired("g1 feet")
    scene = found.scene
    model = ComplementarityModel(scene, 2, 0.002, Barrier(1e-4))
    q = torch.from_numpy(found.start[None])
    q[:, 2] -= scene.gaps(q.numpy()).min()
    state = q, torch.zeros(1, scene.nv, dtype=torch.float64), torch.zeros(1, scene.nu, dtype=torch.float64)
    bundled = BundledContactModel(model, BundleConfig(3, 2, trigger=1e-3, position=0.0, velocity=0.0))
    for ours, plain in zip(gradients(bundled, *state), gradients(model, *state), strict=True):
        for a, b in zip(ours, plain, strict=True):
            torch.testing.assert_close(a, b, rtol=1e-6, atol=1e-6)
    assert bundled.bundles > 0
    chains = [[scene.coordinate_names[k] for k in np.flatnonzero(chain)] for chain in bundled.offsets.chains]
    assert [len(chain) for chain in chains] == [6, 6]
    assert not any("pelvis" in name or "floating" in name for chain in chains for name in chain)
