"""MBPO's probabilistic ensemble: a neural alternative to a contact model, trained on the same transitions.

Architecture and training follow the original TensorFlow code of Janner et al. 2019 (MBPO): 7 nets, of which the 5 best
on held-out rows predict; 4 swish layers of width 200; a Gaussian output with learned log-variance bounds; weight decay
per layer; standardised inputs; targets are changes of the state. `EnsembleConfig` states what differs. There is no
reward output: rewards are computed from the state.

Changes of a configuration are taken and added on the manifold (`Scene.difference`), so quaternions stay unit.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from cmbrl.errors import UserError
from cmbrl.files import read_record
from cmbrl.models.manifold import Coordinates, invariant_translations, rotation_matrix
from cmbrl.models.neural.config import ENSEMBLE, EnsembleConfig
from cmbrl.models.neural.network import EnsembleNetwork
from cmbrl.models.neural.training import TrainingReport, train
from cmbrl.models.weights import fill, write

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.scene import Scene

CHUNK = 8192  # rows per forward pass: bounds the memory of large batches
WEIGHTS = "weights.safetensors"
_REMEDY = "train it again"


class NeuralEnsemble:
    """Next-state model q' = q (+) dq, v' = v + dv, where (dq, dv) is the mean of the elite nets.

    ``dt`` [s] is the control step of the log it is trained on. Call `fit` or `load` before `step`.
    """

    name = "neural ensemble"

    def __init__(self, scene: Scene, dt: float, config: EnsembleConfig | None = None) -> None:
        config = config or EnsembleConfig()
        dropped = invariant_translations(scene) if config.drop_translations else []
        self._build(Coordinates.from_scene(scene), scene.name, dt, config, dropped)
        self.network.reset(torch.Generator().manual_seed(0))

    def _build(
        self, coordinates: Coordinates, scene: str, dt: float, config: EnsembleConfig, dropped: list[int]
    ) -> None:
        self.coordinates, self.scene_name, self.dt, self.config = coordinates, scene, float(dt), config
        self.dropped = list(dropped)  # addresses in q that are not features
        self.elites = torch.arange(config.elites)
        inputs = self.features(
            torch.zeros(1, coordinates.nq), torch.zeros(1, coordinates.nv), torch.zeros(1, coordinates.nu)
        ).shape[1]
        self.network = EnsembleNetwork(config.nets, inputs, 2 * coordinates.nv, config.hidden, config.width)
        self.network.requires_grad_(False)  # steps are differentiated in q, v and u only

    def features(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        """Inputs of the nets before standardisation, (B, inputs)."""
        periodic = self.config.angles == "periodic"
        turned: set[int] = set()  # coordinates with other features
        if periodic:
            turned = {*self.coordinates.hinges_q, *(a + k for a in self.coordinates.ball_q for k in range(4))}
        plain = [a for a in range(self.coordinates.nq) if a not in turned and a not in self.dropped]
        parts = [q[:, plain], v, u]
        if periodic:
            angle = q[:, list(self.coordinates.hinges_q)]
            parts += [torch.sin(angle), torch.cos(angle)]
            parts += [rotation_matrix(q[:, a : a + 4]) for a in self.coordinates.ball_q]
        return torch.cat(parts, dim=1)

    def step(
        self, q: Tensor, v: Tensor, u: Tensor, sample: bool = False, generator: torch.Generator | None = None
    ) -> tuple[Tensor, Tensor]:
        """(q', v') of shapes (B, nq), (B, nv), float64, differentiable.

        ``sample``: each row draws one elite and a value from its Gaussian with ``generator``, as in MBPO's rollouts,
        instead of the mean of the elites.
        """
        changes = [
            self._change(*rows, sample, generator)
            for rows in zip(q.split(CHUNK), v.split(CHUNK), u.split(CHUNK), strict=True)
        ]
        change = torch.cat(changes)
        return self.coordinates.integrate(q, change[:, : self.coordinates.nv]), v + change[:, self.coordinates.nv :]

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
        """A value (B, outputs) from the Gaussian of one random elite per row of inputs (B, n)."""
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
        """Trains on ``data`` and keeps the best weights of every net.

        Args:
            data: a log with this model's control step.
            seed: of the initial weights, the held-out rows and the batches.
            progress: called after each epoch with the share of the work done and the held-out error.
            max_seconds: ends training early with the best weights so far, as Ctrl-C does.
            warm_start: continue from the present weights, with the inputs standardised anew.
            updates: gradient steps instead of the configuration's.

        Raises UserError if the log is too short or has another control step.
        """
        if abs(data.dt - self.dt) > 1e-6 * self.dt:
            raise UserError(f"the log's dt is {data.dt:g} s, the ensemble's {self.dt:g} s; make it with the log's dt")
        q, v, u, q_next, v_next = (torch.as_tensor(a) for a in (data.q, data.v, data.u, data.q_next, data.v_next))
        inputs = self.features(q, v, u)
        targets = torch.cat([self.coordinates.difference(q, q_next), v_next - v], dim=1)
        report, self.elites = train(
            self.network, self.config, inputs, targets, seed, progress, max_seconds, warm_start, updates
        )
        return report

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Writes ``weights.safetensors`` and ``ensemble.json`` into ``folder``."""
        description = {
            "kind": "neural ensemble",
            "scene": self.scene_name,
            "dt": self.dt,
            "layout": self.coordinates.to_dict(),
            "dropped": self.dropped,
            "elites": self.elites.tolist(),
            "config": asdict(self.config),
        }
        write(self.network, description, Path(folder) / ENSEMBLE, Path(folder) / WEIGHTS)

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> NeuralEnsemble:
        """Reads what `save` wrote, without the scene. Raises UserError if it is missing or damaged."""
        place = Path(folder)
        description = read_record(place / ENSEMBLE, _REMEDY, older=lambda held: "weights" not in held)
        model = cls.__new__(cls)
        try:
            config: dict[str, Any] = {
                k: tuple(v) if isinstance(v, list) else v for k, v in description["config"].items()
            }
            coordinates, dropped = Coordinates.from_dict(description["layout"]), description["dropped"]
            with torch.device("meta"):  # nothing is allocated before the sizes are known to be those of the weights
                model._build(coordinates, description["scene"], description["dt"], EnsembleConfig(**config), dropped)
            model.elites = torch.tensor(description["elites"], dtype=torch.long).reshape(-1)
            if not len(model.elites) or not set(model.elites.tolist()) <= set(range(model.config.nets)):
                raise ValueError(f"elites {description['elites']}")
        except (AttributeError, KeyError, TypeError, ValueError, RuntimeError, OverflowError, IndexError) as error:
            reason = (str(error).splitlines() or [""])[0]
            raise UserError(f"{folder}: not a saved ensemble ({reason}); {_REMEDY}") from None
        fill(model.network, place / WEIGHTS, description.get("weights"), _REMEDY)
        return model
