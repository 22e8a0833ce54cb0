"""A contact model with a small net in front: what the physics cannot express, as accelerations that contacts still see.

    v+ = v + dt f(q, v, u),      (q', v') = step(q, v+, u)

The net f pushes before the step, so that contacts, limits and friction answer its push: nothing sinks in, what sticks
still sticks. Each acceleration is bounded by what the log showed (``limit``), however far from it a state is.

A base that floats over a plane is seen, and pushed, in its own frame: the residual does not depend on where on the
plane the robot is, nor on its heading.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor, nn

from cmbrl.errors import UserError
from cmbrl.files import read_record
from cmbrl.models.around import Around
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.manifold import Coordinates, invariant_translations, rotation_matrix
from cmbrl.models.named import RESIDUAL
from cmbrl.models.protocol import OtherLaw
from cmbrl.models.weights import fill, write

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions

WEIGHTS = "residual.safetensors"
_REMEDY = "fit it again by cmbrl residual"


class ResidualNet(nn.Module):
    """Changes of velocity (B, nv) in a control step from q (B, nq), v (B, nv) and u (B, inputs), all float64.

    ``dropped``: addresses in q along which the dynamics do not change. ``limit`` (nv,) bounds the changes.
    """

    input_mean: Tensor  # (inputs,) float64
    input_scale: Tensor
    limit: Tensor  # (nv,) float64

    def __init__(self, coordinates: Coordinates, inputs: int, dropped: Sequence[int], hidden: Sequence[int]) -> None:
        super().__init__()
        self.coordinates, self.dropped = coordinates, tuple(dropped)
        self.plain = [a for a in coordinates.scalar_q if a not in self.dropped]
        pairs = list(zip(coordinates.ball_q, coordinates.ball_v, strict=True))
        # Of a free joint, whose translation comes just before its rotation, both horizontal ones are dropped.
        self.bases = [(a, b) for a, b in pairs if {a - 3, a - 2} <= set(self.dropped)]
        self.balls = [a for a, b in pairs if (a, b) not in self.bases]
        width = len(self.plain) + 9 * len(self.balls) + 3 * len(self.bases) + coordinates.nv + inputs
        sizes = [width, *hidden]
        layers: list[nn.Module] = []
        for before, after in pairwise(sizes):
            layers += [nn.Linear(before, after), nn.SiLU()]
        last = nn.Linear(sizes[-1], coordinates.nv)
        nn.init.zeros_(last.weight)  # nothing is added until something is learned
        nn.init.zeros_(last.bias)
        self.layers = nn.Sequential(*layers, last)
        self.register_buffer("input_mean", torch.zeros(width, dtype=torch.float64))
        self.register_buffer("input_scale", torch.ones(width, dtype=torch.float64))
        self.register_buffer("limit", torch.ones(coordinates.nv, dtype=torch.float64))

    def features(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        """What the net sees (B, width), before it is standardised."""
        parts = [q[:, self.plain]]
        parts += [rotation_matrix(q[:, a : a + 4]) for a in self.balls]
        parts += [rotation_matrix(q[:, a : a + 4])[:, 6:] for a, _ in self.bases]  # the vertical in the base's frame
        return torch.cat([*parts, self.own_frame(q, v), u], dim=1)

    def own_frame(self, q: Tensor, v: Tensor, back: bool = False) -> Tensor:
        """v (B, nv) with the linear velocities of bases in their own frames; ``back``: from there to the world's."""
        for a, b in self.bases:
            rotation = rotation_matrix(q[:, a : a + 4]).unflatten(-1, (3, 3))
            rotation = rotation if back else rotation.transpose(1, 2)
            v = torch.cat([v[:, : b - 3], (rotation @ v[:, b - 3 : b, None])[..., 0], v[:, b:]], dim=1)
        return v

    def forward(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        """The changes of velocity (B, nv), float64."""
        inputs = ((self.features(q, v, u) - self.input_mean) / self.input_scale).clamp(-10.0, 10.0)
        return self.own_frame(q, self.limit * torch.tanh(self.layers(inputs.float()).double()), back=True)


class ResidualModel(Around):
    """``model`` after the push of ``net``; everything else, parameters and draws among it, is the model's.

    Raises UserError if the net is of another robot.
    """

    name = "complementarity with residual"

    def __init__(self, model: ComplementarityModel, net: ResidualNet) -> None:
        if net.coordinates != model.coordinates:
            raise UserError(f"the residual is of another robot than {model.scene.name}: {_REMEDY}")
        self.model, self.net, self.coordinates = model, net, model.coordinates

    @classmethod
    def fresh(cls, model: ComplementarityModel, hidden: Sequence[int]) -> ResidualModel:
        """One that adds nothing yet."""
        scene = model.scene
        level = scene.planar or not scene.gravity[:2].any()  # otherwise the heading matters
        dropped = invariant_translations(scene) if level else []
        return cls(model, ResidualNet(model.coordinates, scene.inputs, dropped, hidden))

    def step(self, q: Tensor, v: Tensor, u: Tensor, theta: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """(q', v') as :meth:`ComplementarityModel.step`, differentiable in q, v, u and theta."""
        return self.model.step(q, v + self.net(q, v, u), u, theta)

    def seen(self, log: Transitions) -> Transitions:
        """``log`` as the model's state and control."""
        return self.model.seen(log)

    @property
    def integral(self) -> np.ndarray | None:
        """That of the model."""
        return self.model.integral

    def under_other_law(self, law: OtherLaw = "sliding") -> ResidualModel | None:
        """The same with the model under another law (see there); None if it has none."""
        other = self.model.under_other_law(law)
        return None if other is None else ResidualModel(other, self.net)

    def under_both_laws(self, share: float, law: OtherLaw = "sliding") -> ResidualModel | None:
        """The same with the model under both laws (see there); None if it has one."""
        both = self.model.under_both_laws(share, law)
        return None if both is None else ResidualModel(both, self.net)

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Writes ``residual.json`` and ``residual.safetensors`` into ``folder``, next to the fit that it belongs to."""
        hidden = [layer.out_features for layer in self.net.layers if isinstance(layer, nn.Linear)][:-1]
        description = {
            "layout": self.coordinates.to_dict(),
            "inputs": self.model.scene.inputs,
            "dropped": list(self.net.dropped),
            "hidden": hidden,
        }
        write(self.net, description, Path(folder) / RESIDUAL, Path(folder) / WEIGHTS)

    @classmethod
    def load(cls, folder: str | os.PathLike[str], model: ComplementarityModel) -> ResidualModel:
        """Reads what ``save`` wrote, around the ``model`` of the fit there. Raises UserError if it is damaged."""
        place = Path(folder)
        held = read_record(place / RESIDUAL, _REMEDY)
        try:
            with torch.device("meta"):
                layout = Coordinates.from_dict(held["layout"])
                net = ResidualNet(layout, held["inputs"], held["dropped"], held["hidden"])
        except (AttributeError, KeyError, TypeError, ValueError, RuntimeError, IndexError, OverflowError):
            raise UserError(f"{place / RESIDUAL}: damaged: {_REMEDY}") from None
        fill(net, place / WEIGHTS, held.get("weights"), _REMEDY)
        net.requires_grad_(False)  # steps are differentiated in state, control and theta only
        return cls(model, net)
