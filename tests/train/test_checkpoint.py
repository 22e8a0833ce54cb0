"""A state that goes through a checkpoint comes back with its types and bits."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from cmbrl.errors import UserError
from cmbrl.train.running.checkpoint import load_state, save_state


def same(a: Any, b: Any) -> bool:
    """Equal in type, nesting and every bit (NaN equals NaN)."""
    if type(a) is not type(b):
        return False
    if isinstance(a, dict):
        return list(a) == list(b) and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, torch.Tensor):
        return a.dtype == b.dtype and a.shape == b.shape and a.numpy().tobytes() == b.numpy().tobytes()
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    return bool(a == b) or (isinstance(a, float) and math.isnan(a) and math.isnan(b))


def test_every_kind_comes_back(tmp_path: Path) -> None:
    shared = torch.randn(3)
    state = {
        "none": None,
        "numbers": [1, -(2**127), True, 0.1, 1e-310, math.inf, -math.inf, math.nan, -0.0],
        "text": "κ \n",
        "tuple": (1, (2.5, [])),
        "tensors": {0: torch.randn(2, 3, dtype=torch.float64), 1: torch.tensor(3), "empty": torch.empty(0, 4)},
        "not contiguous": torch.arange(6).reshape(2, 3).T,
        "the same twice": [shared, shared, shared[1:]],
        "bits": torch.tensor([math.nan, -0.0, math.inf]),
        "generator": torch.Generator().manual_seed(3).get_state(),
        "numpy": np.random.default_rng(0).bit_generator.state,
        "array": np.arange(4, dtype=np.int16),
        "nothing": {},
    }
    save_state(tmp_path / "state.safetensors", state)
    assert same(load_state(tmp_path / "state.safetensors"), state)


def test_an_optimiser_goes_on_bit_for_bit(tmp_path: Path) -> None:
    def fresh() -> tuple[nn.Module, torch.optim.Optimizer]:
        torch.manual_seed(0)
        net = nn.Linear(3, 2)
        return net, torch.optim.Adam(net.parameters(), 1e-2)

    def step(net: nn.Module, optimiser: torch.optim.Optimizer) -> None:
        optimiser.zero_grad()
        net(torch.ones(4, 3)).square().mean().backward()
        optimiser.step()

    net, optimiser = fresh()
    step(net, optimiser)
    save_state(tmp_path / "a.safetensors", {"net": dict(net.state_dict()), "optimiser": optimiser.state_dict()})
    step(net, optimiser)
    other, its = fresh()
    loaded = load_state(tmp_path / "a.safetensors")
    other.load_state_dict(loaded["net"])
    its.load_state_dict(loaded["optimiser"])
    step(other, its)
    assert same(dict(net.state_dict()), dict(other.state_dict()))


def test_what_json_and_tensors_cannot_hold_is_refused_and_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "state.safetensors"
    save_state(path, {"good": 1})
    for bad in ({"x": object()}, {(1, 2): 0}, {"f": print}):
        with pytest.raises(TypeError, match="checkpoint cannot hold"):
            save_state(path, bad)
    assert load_state(path) == {"good": 1}
    assert [file.name for file in tmp_path.iterdir()] == ["state.safetensors"]


def test_damage_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such file"):
        load_state(tmp_path / "none")
    path = tmp_path / "state.safetensors"
    save_state(path, {"x": torch.zeros(1000)})
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(UserError, match=r"state\.safetensors.*damaged"):
        load_state(path)
    path.write_bytes(b"not one")
    with pytest.raises(UserError, match="damaged"):
        load_state(path)
