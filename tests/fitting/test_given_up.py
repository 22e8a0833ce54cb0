"""Candidates that some windows of the log show to be worse than what is known are given up; others lose nothing."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.search.folds import draw_starts


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_what_is_beyond_the_bound_is_infinite_and_the_rest_as_it_was(carts, noise: float) -> None:
    data = carts.record(carts.truth(2, gear_1=0.7, tilt=0.4), episodes=20, steps=40, noise=1e-3)
    evidence = Evidence.of(carts.model(2), data)
    spread = None if noise == 0.0 else np.full((1, 2 * evidence.model.scene.nv), noise)
    starts = draw_starts(evidence.log, 4, 300, 0)
    loss = evidence.loss(starts, 4, *evidence.scales(4, 0.5, spread)).settled(evidence.space.nominal)
    draw = np.random.default_rng(0).normal(size=(12, len(evidence.space)))
    theta = evidence.space.theta(np.clip(0.3 * draw, evidence.space.z_low, evidence.space.z_high))
    offset = None if loss.windows.offset is None else np.stack([loss.windows.offset * k for k in np.linspace(0, 1, 12)])
    extra = np.linspace(0.0, 0.1, 12)
    whole = loss.values(theta, offset) + extra
    bound = float(np.median(whole))
    found = loss.values(theta, offset, extra, bound)
    below = whole <= bound
    assert 0 < below.sum() < 12
    np.testing.assert_allclose(found[below], whole[below], rtol=1e-12)
    assert np.isinf(found[~below]).all()
    predicted = []
    loses = loss.model.candidate_losses
    object.__setattr__(
        loss.model, "candidate_losses", lambda t, w: predicted.append(len(t) * len(w.starts)) or loses(t, w)
    )
    loss.values(theta, offset, extra, 1.01 * float(whole.min()))
    assert sum(predicted) < 0.9 * 12 * len(starts)
