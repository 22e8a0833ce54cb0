"""MBPO's probabilistic ensemble: the neural rival of a contact model, trained on the same transitions.

Architecture and training follow the original TensorFlow code of Janner et al. 2019 (MBPO): 7 nets of which the 5 best
on held-out rows predict, 4 swish layers of 200, Gaussian output with learned log-variance bounds, a weight decay per
layer, standardised inputs, targets = change of the state. What differs is stated at the option in EnsembleConfig;
`EnsembleConfig.original()` undoes it. There is no reward output: a reward is computed from the state.

The change of a configuration is taken, and added, on the manifold (`Scene.difference`), so quaternions stay unit.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from cmbrl.errors import UserError
from cmbrl.files import atomic_path, read_json, write_json
from cmbrl.models.ensemble_network import EnsembleNetwork
from cmbrl.models.manifold import Layout, invariant_translations, rotation_matrix
from cmbrl.models.named import ENSEMBLE

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.models.ensemble_training import TrainingReport
    from cmbrl.scene import Scene

CHUNK = 8192  # rows per forward pass: bounds the memory of large batches
WEIGHTS = "weights.safetensors"


@dataclass(frozen=True)
class EnsembleConfig:
    """Settings of the ensemble; the defaults are the strongest found for prediction, `original()` is MBPO's."""

    nets: int = 7
    elites: int = 5
    hidden: int = 4
    width: int = 200
    batch: int = 128
    """Rows of a gradient step, per net. Original: 256."""
    learning_rate: float = 1e-2
    """Adam's step size (at the start, when it falls). Original: 1e-3, which learns several times slower."""
    updates: int | None = 10_000
    """Length of training in gradient steps, over which the step size falls to zero as a cosine. Original: None, that
    is a constant step size until patience ends; on short logs that stops after some hundred steps, far too early."""
    weight_decay: tuple[float, ...] = (2.5e-5, 5e-5, 7.5e-5, 7.5e-5, 1e-4)
    """L2 penalty per layer, first to last."""
    variance_regulariser: float = 0.01
    beta: float = 1.0
    """Weight of the likelihood's terms, see `EnsembleNetwork.loss`. Original: 0."""
    initial_gain: float = 1.0
    """Initial weights have a standard deviation of this over the root of a layer's inputs. Original: .5."""
    holdout: float = 0.2
    holdout_max: int = 5000
    patience: int = 5
    """Without ``updates``: training ends when no net has improved on the held-out rows for more than so many epochs."""
    improvement: float = 0.01
    """Relative fall of the held-out error that counts as better for patience."""
    bootstrap: bool = False
    """Every net sees its own sample of the rows, drawn with replacement: 37 % less data each. Original: yes."""
    normalise_targets: bool = True
    """Standardise every target. Original: no, which drowns a change of position (~1e-2) in one of velocity (~1)."""
    angles: Literal["raw", "periodic"] = "raw"
    """Features of a rotation: raw (angle; quaternion wxyz), or periodic (sine and cosine; rotation matrix)."""
    drop_translations: bool = True
    """Leave out coordinates along which the world looks the same everywhere (x of a robot on a floor), as Gymnasium's
    observations do. Invariance to rotation about the vertical is not built in."""

    @classmethod
    def original(cls) -> EnsembleConfig:
        """MBPO as published."""
        return cls(
            batch=256,
            learning_rate=1e-3,
            updates=None,
            beta=0.0,
            initial_gain=0.5,
            bootstrap=True,
            normalise_targets=False,
        )


class NeuralEnsemble:
    """Next-state model q' = q (+) dq, v' = v + dv with (dq, dv) from the mean of the elite nets.

    ``dt`` [s] is the control step of the log it is trained on. A fresh ensemble predicts nothing of use until `fit`.
    """

    name = "neural ensemble"

    def __init__(self, scene: Scene, dt: float, config: EnsembleConfig | None = None) -> None:
        config = config or EnsembleConfig()
        dropped = invariant_translations(scene) if config.drop_translations else []
        self._build(Layout.from_scene(scene), scene.name, dt, config, dropped)

    def _build(self, layout: Layout, scene: str, dt: float, config: EnsembleConfig, dropped: list[int]) -> None:
        self.layout, self.scene_name, self.dt, self.config = layout, scene, float(dt), config
        self.dropped = list(dropped)  # addresses in q that are no feature
        self.elites = torch.arange(config.elites)
        inputs = self.features(torch.zeros(1, layout.nq), torch.zeros(1, layout.nv), torch.zeros(1, layout.nu)).shape[1]
        self.network = EnsembleNetwork(config.nets, inputs, 2 * layout.nv, config.hidden, config.width)
        self.network.reset(torch.Generator().manual_seed(0))
        self.network.requires_grad_(False)  # only `fit` learns: a step is differentiated in q, v and u alone

    def features(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        """Inputs of the nets before standardisation, (B, inputs)."""
        periodic = self.config.angles == "periodic"
        turned: set[int] = set()  # coordinates that enter by another feature
        if periodic:
            turned = {*self.layout.hinges_q, *(a + k for a in self.layout.ball_q for k in range(4))}
        plain = [a for a in range(self.layout.nq) if a not in turned and a not in self.dropped]
        parts = [q[:, plain], v, u]
        if periodic:
            angle = q[:, list(self.layout.hinges_q)]
            parts += [torch.sin(angle), torch.cos(angle)]
            parts += [rotation_matrix(q[:, a : a + 4]) for a in self.layout.ball_q]
        return torch.cat(parts, dim=1)

    def step(
        self, q: Tensor, v: Tensor, u: Tensor, sample: bool = False, generator: torch.Generator | None = None
    ) -> tuple[Tensor, Tensor]:
        """(q', v') of shapes (B, nq), (B, nv), float64, differentiable.

        ``sample``: instead of the mean of the elites, each row draws one elite and a value from its Gaussian, as
        MBPO's rollouts do; reproducible by ``generator``.
        """
        changes = [
            self._change(*rows, sample, generator)
            for rows in zip(q.split(CHUNK), v.split(CHUNK), u.split(CHUNK), strict=True)
        ]
        change = torch.cat(changes)
        return self.layout.integrate(q, change[:, : self.layout.nv]), v + change[:, self.layout.nv :]

    def _change(self, q: Tensor, v: Tensor, u: Tensor, sample: bool, generator: torch.Generator | None) -> Tensor:
        network = self.network
        standard = (self.features(q, v, u) - network.input_mean) / network.input_scale
        inputs = standard.to(network.weights[0].dtype)
        if sample:
            predicted = self._draw(inputs, generator)
        else:
            mean, _ = network(inputs.expand(len(self.elites), -1, -1), self.elites)
            predicted = mean.mean(dim=0)
        return network.target_mean + network.target_scale * predicted.double()

    def _draw(self, inputs: Tensor, generator: torch.Generator | None) -> Tensor:
        """A value (B, outputs) from the Gaussian of one elite per row of inputs (B, n), the only one asked."""
        chosen = torch.randint(len(self.elites), (len(inputs),), generator=generator)
        width = self.network.target_mean.shape[0]
        drawn = torch.randn(len(inputs), width, generator=generator, dtype=inputs.dtype)
        for k, elite in enumerate(self.elites):
            rows = (chosen == k).nonzero()[:, 0]
            mean, log_variance = self.network(inputs[rows][None], elite[None])
            drawn = drawn.index_copy(0, rows, mean[0] + drawn[rows] * torch.exp(0.5 * log_variance[0]))
        return drawn

    def fit(
        self,
        data: Transitions,
        seed: int = 0,
        progress: Callable[[float, str], None] | None = None,
        max_seconds: float | None = None,
        warm_start: bool = False,
        updates: int | None = None,
    ) -> TrainingReport:
        """Trains on ``data`` (its dt must be this model's) and keeps the best weights of every net.

        ``progress(share, text)`` is called after each epoch with the share of the work done and the held-out error;
        ``max_seconds`` ends training early with the best so far, as Ctrl-C does; ``warm_start`` continues from the
        present weights, the inputs standardised anew; ``updates`` gradient steps instead of the configuration's.
        Raises UserError when the log is too short or has another control step.
        """
        from cmbrl.models.ensemble_training import train  # imports this module's types

        return train(self, data, seed, progress, max_seconds, warm_start, updates)

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Writes ``weights.safetensors`` and ``ensemble.json`` into ``folder``."""
        with atomic_path(Path(folder) / WEIGHTS) as temporary:
            save_file({k: value.contiguous() for k, value in self.network.state_dict().items()}, temporary)
        description = {
            "kind": "neural ensemble",
            "scene": self.scene_name,
            "dt": self.dt,
            "layout": self.layout.to_dict(),
            "dropped": self.dropped,
            "elites": self.elites.tolist(),
            "config": asdict(self.config),
        }
        write_json(Path(folder) / ENSEMBLE, description)

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> NeuralEnsemble:
        """Reads what `save` wrote; the scene is not needed. Raises UserError when it is missing or does not fit."""
        description: dict[str, Any] = read_json(Path(folder) / ENSEMBLE)
        weights = Path(folder) / WEIGHTS
        model = cls.__new__(cls)
        try:
            config: dict[str, Any] = {
                k: tuple(v) if isinstance(v, list) else v for k, v in description["config"].items()
            }
            layout, dropped = Layout.from_dict(description["layout"]), description["dropped"]
            model._build(layout, description["scene"], description["dt"], EnsembleConfig(**config), dropped)
            model.elites = torch.tensor(description["elites"])
            model.network.load_state_dict(load_file(weights))
        except (KeyError, TypeError, RuntimeError, SafetensorError, OSError) as error:
            reason = str(error).splitlines()[0]
            raise UserError(f"{folder}: not a saved ensemble ({reason}): train it again") from None
        return model
