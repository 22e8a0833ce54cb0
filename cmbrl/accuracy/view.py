"""A log as one model sees it: its own state and control, with the plays of its file, which no log tells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.unlogged import with_columns
from cmbrl.models.carried import is_without_play
from cmbrl.models.protocol import Model, seen
from cmbrl.scene.fittable.play import plays

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.scene import Scene


@dataclass(frozen=True)
class View:
    """``data`` in the coordinates of ``scene``, that of one model; ``told`` (nv,): those of the scene to compare in."""

    scene: Scene
    data: Transitions
    told: np.ndarray

    @classmethod
    def of(cls, model: Model, data: Transitions, scene: Scene) -> View:
        """``data``, a log of ``scene``, as ``model`` sees it, whose file may have play that this scene has not."""
        own = scene_of(model)
        if own is None or not is_without_play(scene, own):
            return cls(scene, seen(model, data), np.arange(scene.nv))
        missing = [joint.vadr for joint in plays(own.joints) if joint.name not in scene.joint_names]
        return cls(own, seen(model, with_columns(data, own)), np.setdiff1d(np.arange(own.nv), missing))

    def error(self, starts: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Errors (W, k, 2 n) of predicted states (W, k, .) in the coordinates that are told."""
        rows = starts[:, None] + np.arange(q.shape[1])
        with np.errstate(all="ignore"):
            places = self.scene.difference(self.data.q_next[rows], q)
            return np.concatenate([places[..., self.told], (v - self.data.v_next[rows])[..., self.told]], axis=-1)


def scene_of(model: object) -> Scene | None:
    """The scene of a contact model, also of one with a residual; None of other models."""
    inner = getattr(model, "model", model)
    found: Scene | None = getattr(inner, "scene", None)
    return found
