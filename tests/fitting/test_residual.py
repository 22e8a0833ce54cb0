"""A residual learns what no parameter expresses, pushes before contact answers, and stays at zero where it is none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

import cmbrl
from cmbrl.cli.main import main
from cmbrl.data.transitions import Transitions
from cmbrl.errors import UserError
from cmbrl.fitting import FitResult
from cmbrl.fitting.learn_residual import fit_residual
from cmbrl.models.named import saved_model
from cmbrl.models.residual import ResidualModel
from cmbrl.runs import alone_in
from cmbrl.train.algorithms import ALGORITHMS
from cmbrl.train.models import kind_of

ARM = """<mujoco><option timestep=".01" gravity="0 0 -9.81"/><worldbody>
<body><joint name="a" axis="0 1 0" damping=".1"/><geom type="capsule" fromto="0 0 0 .4 0 0" size=".03"/>
<body pos=".4 0 0"><joint name="b" axis="0 1 0" damping=".1"/><geom type="capsule" fromto="0 0 0 .4 0 0" size=".03"/>
</body></body></worldbody><actuator><motor joint="a" gear="8"/><motor joint="b" gear="4"/></actuator></mujoco>"""
BOX = """<mujoco><option timestep=".004" cone="elliptic"/><worldbody><geom type="plane" size="9 9 .1"/>
<body pos="0 0 .05"><freejoint/><geom type="box" size=".2 .2 .05" mass="2"/><site name="s"/></body></worldbody>
<actuator><motor site="s" gear="40 0 0 0 0 0"/></actuator></mujoco>"""
DRAG = 0.3  # [1/rad]: of an acceleration -DRAG |v| v, which no parameter has


def _model(text: str, folder: Path) -> cmbrl.ComplementarityModel:
    (folder / "robot.xml").write_text(text)
    return cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(folder / "robot.xml"))


def _log(model: cmbrl.ComplementarityModel, drag: float, episodes: int = 20, steps: int = 40) -> Transitions:
    rng = np.random.default_rng(0)
    nv, nu = model.scene.nv, model.scene.nu
    q, v = rng.uniform(-1, 1, (episodes, nv)), rng.uniform(-2, 2, (episodes, nv))
    rows: list[tuple[np.ndarray, ...]] = []
    for _ in range(steps):
        u = rng.uniform(-1, 1, (episodes, nu))
        found = model.predict(q, v - model.dt * drag * np.abs(v) * v, u)
        rows.append((q, v, u, found.q_next, found.v_next))
        q, v = found.q_next, found.v_next
    columns = [np.stack(x, axis=1).reshape(episodes * steps, -1) for x in zip(*rows, strict=True)]
    named = dict(zip(("q", "v", "u", "q_next", "v_next"), columns, strict=True))
    return Transitions(**named, dt=model.dt, episode=np.repeat(np.arange(episodes), steps))


def _fitted(model: cmbrl.ComplementarityModel) -> FitResult:
    return FitResult(model, {}, {"horizon": 4})


def test_learns_drag_that_no_parameter_has(tmp_path: Path) -> None:
    model = _model(ARM, tmp_path)
    log = _log(model, DRAG)
    learned, report = fit_residual(_fitted(model), log, updates=400)
    assert report.kept
    assert report.after < 0.1 * report.before
    q, v, u = (torch.from_numpy(x) for x in (log.q, log.v, log.u))
    truth = -DRAG * v.abs() * v * model.dt
    assert (learned.net(q, v, u) - truth).square().mean() < 0.1 * truth.square().mean()
    assert set(report.share) == set(model.scene.coordinate_names)


def test_stays_at_zero_where_the_physics_is_all(tmp_path: Path) -> None:
    model = _model(ARM, tmp_path)
    learned, report = fit_residual(_fitted(model), _log(model, 0.0), updates=50)
    assert not report.kept
    x = torch.ones(2, 2, dtype=torch.float64)
    assert all(torch.equal(a, b) for a, b in zip(learned.step(x, x, x), model.step(x, x, x), strict=True))
    assert "stays at zero" in report.text()


def _random_net(model: cmbrl.ComplementarityModel) -> ResidualModel:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        found = ResidualModel.fresh(model, (16,))
        for parameter in found.net.layers.parameters():
            torch.nn.init.normal_(parameter, std=0.5)
    found.net.limit.fill_(0.3)
    found.net.requires_grad_(False)
    return found


def test_derivatives_are_those_of_the_step(tmp_path: Path) -> None:
    learned = _random_net(_model(ARM, tmp_path))
    x = [torch.randn(3, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(k)) for k in range(3)]
    given = tuple(t.requires_grad_() for t in x)
    # The net is float32: differences over 1e-3 see its rounding at 1e-4 of its push.
    assert torch.autograd.gradcheck(lambda *a: learned.step(*a)[1], given, eps=1e-3, atol=2e-3, rtol=2e-2)


def test_contact_answers_the_push(tmp_path: Path) -> None:
    learned = _random_net(_model(BOX, tmp_path))
    q = torch.tensor([[0.0, 0, 0.05, 1, 0, 0, 0]], dtype=torch.float64)
    v, u = torch.zeros(1, 6, dtype=torch.float64), torch.zeros(1, 1, dtype=torch.float64)
    for bias in (-20.0, 20.0):  # as hard down, then up, as its limit lets it
        learned.net.layers[-1].weight.zero_()
        learned.net.layers[-1].bias.copy_(torch.tensor([0, 0, bias, 0, 0, 0]))
        rises = float(learned.step(q, v, u)[1][0, 2])
        free = bias / 20.0 * 0.3 - 9.81 * 0.004
        assert rises == pytest.approx(free, abs=1e-6) if bias > 0 else rises > 0.6 * free  # as far as it is soft


def test_does_not_depend_on_place_or_heading(tmp_path: Path) -> None:
    learned = _random_net(_model(BOX, tmp_path))
    q = torch.tensor([[0.3, -0.2, 1.0, 0.9, 0.1, -0.2, 0.3]], dtype=torch.float64)
    q[:, 3:] /= q[:, 3:].norm()
    v = torch.tensor([[1.0, 0.5, -0.2, 0.3, -0.4, 0.5]], dtype=torch.float64)
    u = torch.ones(1, 1, dtype=torch.float64)
    turn = torch.tensor([0.6, 0.0, 0.0, 0.8], dtype=torch.float64)  # about the vertical
    matrix = torch.tensor([[-0.28, -0.96, 0], [0.96, -0.28, 0], [0, 0, 1]], dtype=torch.float64)
    w, z = turn[0], turn[3]
    a, b, c, d = q[0, 3:]
    turned = torch.stack([w * a - z * d, w * b - z * c, w * c + z * b, w * d + z * a])
    there = torch.cat([matrix @ q[0, :3] + torch.tensor([5.0, 2.0, 0.0]), turned])[None]
    moved = torch.cat([matrix @ v[0, :3], v[0, 3:]])[None]
    push, other = learned.net(q, v, u)[0], learned.net(there, moved, u)[0]
    assert torch.allclose(matrix @ push[:3], other[:3], atol=1e-6)
    assert torch.allclose(push[3:], other[3:], atol=1e-6)
    assert push[:3].norm() > 1e-2


def test_heading_matters_where_gravity_is_tilted(tmp_path: Path) -> None:
    tilted = BOX.replace("<option ", '<option gravity="1 0 -9.7" ')
    assert _random_net(_model(BOX, tmp_path)).net.bases == [(3, 3)]
    assert not _random_net(_model(tilted, tmp_path)).net.bases


def test_other_law_keeps_the_residual(tmp_path: Path) -> None:
    learned = _random_net(_model(BOX, tmp_path))
    other = learned.under_other_law()
    assert other is not None
    assert other.net is learned.net
    assert other.model.sliding != learned.model.sliding


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model, robot, data = _model(ARM, tmp_path), str(tmp_path / "robot.xml"), str(tmp_path / "log.npz")
    _log(model, DRAG).save(data)
    fit, out = str(tmp_path / "fit"), str(tmp_path / "residual")
    assert main(["fit", robot, "--data", data, "--out", fit, "--groups", "damping", "--threads", "1"]) == 0
    with alone_in(out):
        assert main(["residual", fit, "--data", data, "--out", out]) == 2
    assert "another run is at work" in capsys.readouterr().err
    assert main(["residual", fit, "--data", data, "--out", out, "--updates", "200", "--threads", "1"]) == 0
    assert "with the residual" in capsys.readouterr().out
    loaded = saved_model(out)
    assert isinstance(loaded, ResidualModel)
    assert kind_of(out) not in ALGORITHMS["loop"].models  # which would fit anew
    assert kind_of(out) in ALGORITHMS["shac"].models
    x = torch.ones(1, 2, dtype=torch.float64)
    assert not torch.equal(loaded.step(x, x, x)[1], saved_model(fit).step(x, x, x)[1])
    assert main(["error", "--data", data, "nominal", fit, out, "--horizons", "1", "5", "--threads", "1"]) == 0
    told = capsys.readouterr().out
    assert "residual" in told
    assert main(["residual", fit, "--data", data, "--out", out]) == 2
    assert "already holds a run" in capsys.readouterr().err
    assert main(["residual", str(tmp_path), "--data", data, "--out", str(tmp_path / "x")]) == 2
    assert "contains no fit" in capsys.readouterr().err
    short = ["residual", fit, "--data", data, "--out", str(tmp_path / "y"), "--horizon", "41"]
    assert main(short) == 2
    assert not (tmp_path / "y").exists()
    weights = tmp_path / "residual" / "residual.safetensors"
    weights.write_bytes(weights.read_bytes()[:-8])
    with pytest.raises(UserError, match=r"residual\.safetensors: damaged"):
        saved_model(out)
    weights.unlink()
    with pytest.raises(UserError, match=r"residual\.safetensors"):
        saved_model(out)
