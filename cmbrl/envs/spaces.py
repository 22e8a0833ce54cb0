"""The spaces of a decision process, as Gymnasium describes them."""

from __future__ import annotations

import numpy as np

from cmbrl.errors import UserError
from cmbrl.mdp import MDP

try:
    from gymnasium.spaces import Box
except ImportError:
    raise UserError("gymnasium is not installed: pip install 'cmbrl[tasks]'") from None


def observation_space(mdp: MDP) -> Box:
    """Observations (n_o,), float64 and unbounded, as for Gymnasium's MuJoCo robots."""
    return Box(-np.inf, np.inf, (mdp.observations,), np.float64)


def action_space(mdp: MDP) -> Box:
    """Actions (n_a,) in [-1, 1]."""
    return Box(-1.0, 1.0, (mdp.actions,), np.float32)


def check_render_mode(mode: str | None) -> None:
    """Raises UserError unless pictures are arrays, or there are none."""
    if mode not in (None, "rgb_array"):
        raise UserError(f"render_mode {mode!r}: use None or 'rgb_array'")
