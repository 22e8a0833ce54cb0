"""Losses of candidates equal those of plain steps, however many candidates share a pack, and from any starts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cmbrl.bench.states import random_states
from cmbrl.contact import Barrier
from cmbrl.data.transitions import Transitions
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.windows import Scales, Windows, huber
from cmbrl.scene import Scene

from .test_batches import CALM, CUBE, HOPPER

STARTS = np.array([0, 3, 4, 10, 11, 12, 20, 31, 33, 50, 61])  # no multiple of any pack
HORIZON = 3


@pytest.fixture(params=[HOPPER, CUBE], ids=["hopper", "cube"])
def model(request: pytest.FixtureRequest) -> ComplementarityModel:
    return ComplementarityModel(Scene.from_mjcf(request.param), substeps=2, smoothing=Barrier(1e-4))


def noisy_windows(model: ComplementarityModel, candidates: int) -> tuple[Windows, np.ndarray]:
    """Windows with starts of each candidate's own, and the candidates (C, np)."""
    rng, nv = np.random.default_rng(3), model.scene.nv
    q, v, u = random_states(model.scene, 70, rng, CALM)
    log = Transitions(
        q=q, v=v, u=u, q_next=np.roll(q, 1, 0), v_next=np.roll(v, 1, 0), dt=model.dt, episode=np.zeros(70)
    )
    scales = Scales(np.full(nv, 0.5), np.full(nv, 2.0), 0.5, noise=np.full(2 * nv, 0.01))
    windows = Windows(log, STARTS, HORIZON, scales)
    offset = 0.02 * rng.standard_normal((candidates, len(STARTS), 2 * nv))
    return replace(windows, offset=offset), model.parameters * rng.uniform(
        0.95, 1.0, (candidates, len(model.parameters))
    )


def by_steps(model: ComplementarityModel, theta: np.ndarray, windows: Windows) -> float:
    """The same loss of one candidate from plain steps; rotation errors as twice the vector part of the quaternion."""
    scene, log, scales = model.scene, windows.data, windows.scales
    (q, v), total = windows.begin(scene), 0.0
    for j in range(HORIZON):
        rows = STARTS + j
        step = model.predict(q, v, log.u[rows], theta=theta)
        q, v = step.q_next, step.v_next
        off = scene.difference(log.q_next[rows], q)
        if scene.nq > scene.nv:  # a rotation by |r| is 2 sin(|r| / 2) long there
            angle = np.linalg.norm(off[:, 3:6], axis=1, keepdims=True)
            off[:, 3:6] *= 2.0 * np.sin(angle / 2) / angle
        total += (
            huber(off / scales.q, scales.huber).sum() + huber((v - log.v_next[rows]) / scales.v, scales.huber).sum()
        )
    return total / (len(STARTS) * HORIZON)


@pytest.mark.parametrize("candidates", [1, 2, 3, 5, 9])
def test_every_candidate_has_its_own_starts(model: ComplementarityModel, candidates: int) -> None:
    windows, theta = noisy_windows(model, candidates)
    found = model.candidate_losses(theta, windows).mean(axis=1)
    assert windows.offset is not None
    wanted = [by_steps(model, t, replace(windows, offset=o)) for t, o in zip(theta, windows.offset, strict=True)]
    np.testing.assert_allclose(found, wanted, rtol=1e-7)


def test_common_starts_are_those_of_every_candidate(model: ComplementarityModel) -> None:
    windows, theta = noisy_windows(model, 3)
    assert windows.offset is not None
    common = model.candidate_losses(theta, replace(windows, offset=windows.offset[0])).mean(axis=1)
    tiled = replace(windows, offset=np.tile(windows.offset[:1], (3, 1, 1)))
    same = model.candidate_losses(theta, tiled).mean(axis=1)
    np.testing.assert_array_equal(common, same)


def test_a_window_that_is_not_finite_leaves_the_others_alone(model: ComplementarityModel) -> None:
    windows, theta = noisy_windows(model, 1)
    assert windows.offset is not None
    wanted = model.candidate_losses(theta, windows).mean(axis=1)
    others = np.delete(windows.offset, 4, axis=1)
    rest = model.candidate_losses(theta, replace(windows, starts=np.delete(STARTS, 4), offset=others)).mean(axis=1)
    bad = windows.offset.copy()
    bad[:, 4] = np.nan
    found = model.candidate_losses(theta, replace(windows, offset=bad)).mean(axis=1)
    assert found[0] > 1e10 > wanted[0]
    share = found[0] - 1e15 / (len(STARTS) * HORIZON)  # the sum of the others, over all windows
    np.testing.assert_allclose(share, rest[0] * (len(STARTS) - 1) / len(STARTS), rtol=1e-2)


def test_a_window_that_explodes_is_lost_and_leaves_the_others_alone(model: ComplementarityModel) -> None:
    windows, theta = noisy_windows(model, 1)
    assert windows.offset is not None
    steady = np.delete(windows.offset, 4, axis=1)
    rest = model.candidate_losses(theta, replace(windows, starts=np.delete(STARTS, 4), offset=steady)).mean(axis=1)
    fast = windows.offset.copy()
    fast[:, 4, model.scene.nv :] = 1e150
    lost = 1e15 / (len(STARTS) * HORIZON)
    share = model.candidate_losses(theta, replace(windows, offset=fast)).mean(axis=1)[0] - lost
    np.testing.assert_allclose(share, rest[0] * (len(STARTS) - 1) / len(STARTS), rtol=1e-2)
    everywhere = np.broadcast_to(fast[:, 4:5], fast.shape)
    all_lost = model.candidate_losses(theta, replace(windows, offset=everywhere))
    np.testing.assert_allclose(all_lost.mean(axis=1), lost * len(STARTS))


def test_starts_of_another_number_of_candidates_are_refused(model: ComplementarityModel) -> None:
    windows, theta = noisy_windows(model, 3)
    with pytest.raises(UserError, match=r"^array 'q' has the shape \(3, 11, \d+\); give \(2, 11, \d+\)"):
        model.candidate_losses(theta[:2], windows)
