"""A policy on disk: ``policy.safetensors`` (weights, observation scaling) and ``policy.json`` (their description)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from cmbrl.errors import UserError
from cmbrl.files import atomic_path, check_writable, read_json, write_json
from cmbrl.train.policy import Architecture, Policy

WEIGHTS, DESCRIPTION = "policy.safetensors", "policy.json"
_FORMAT = 1
_SCALING = {
    True: "(observation - normaliser.mean) / sqrt(normaliser.variance + 1e-5), clipped at +-10; part of the policy",
    False: "none",
}


@dataclass(frozen=True)
class SavedPolicy:
    """``about``: where it comes from; "task", "algorithm", "model" and "seed" as far as known."""

    policy: Policy
    about: dict[str, Any]

    @property
    def task(self) -> str:
        """The name of the task that it acts in; raises UserError if the file does not say."""
        if not isinstance(self.about.get("task"), str):
            raise UserError(f"{DESCRIPTION}: does not name the policy's task: train it again")
        return self.about["task"]


def save_policy(policy: Policy, folder: str | os.PathLike[str], about: Mapping[str, Any]) -> Path:
    """Writes both files into ``folder``; ``about`` (JSON types) says what the policy is for.

    Raises UserError if the folder cannot be written.
    """
    place = Path(folder)
    check_writable(place, folder=True)
    place.mkdir(parents=True, exist_ok=True)
    with atomic_path(place / WEIGHTS) as temporary:
        save_file({name: value.contiguous() for name, value in policy.state_dict().items()}, temporary)
    architecture = policy.architecture
    write_json(
        place / DESCRIPTION,
        {
            "format": _FORMAT,
            **about,
            "architecture": asdict(architecture),
            "observation_scaling": _SCALING[architecture.normalise],
        },
    )
    return place


def load_policy(folder: str | os.PathLike[str]) -> SavedPolicy:
    """Reads what ``save_policy`` wrote. Raises UserError that names a file that is missing, damaged or not finite."""
    place = Path(folder)
    if not (place / DESCRIPTION).is_file():
        raise UserError(f"{place}: no policy here ({DESCRIPTION} is missing): give the folder of a `cmbrl train` run")
    described = read_json(place / DESCRIPTION)
    if not isinstance(described, dict) or described.pop("format", None) != _FORMAT:
        raise UserError(f"{place / DESCRIPTION}: not a policy of this version: train it again")
    try:
        fields: dict[str, Any] = described.pop("architecture")
        policy = Policy(Architecture(**fields | {"hidden": tuple(fields["hidden"])}))
        policy.load_state_dict(load_file(place / WEIGHTS))
    except (AttributeError, KeyError, TypeError, RuntimeError, SafetensorError, OSError) as error:
        last = str(error).strip().splitlines()[-1].strip()
        raise UserError(f"{place / WEIGHTS}: does not fit {DESCRIPTION}, or damaged ({last}): train again") from None
    if not all(torch.isfinite(value).all() for value in policy.state_dict().values()):
        raise UserError(f"{place / WEIGHTS}: weights are not finite, the run diverged: train again")
    described.pop("observation_scaling", None)
    return SavedPolicy(policy.eval(), described)
