"""A policy on disk: ``policy.safetensors`` (weights, observation scaling) and ``policy.json`` (their description)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from cmbrl.errors import UserError
from cmbrl.files import check_writable, make_folder, read_record
from cmbrl.models.weights import fill, write
from cmbrl.train.policies.policy import Architecture, Policy

WEIGHTS, DESCRIPTION = "policy.safetensors", "policy.json"
_FORMAT, _WITHOUT_CHECKSUMS = 2, 1
_REMEDY = "train again"
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
    make_folder(place)
    description = {
        "format": _FORMAT,
        **about,
        "architecture": asdict(policy.architecture),
        "observation_scaling": _SCALING[policy.architecture.normalise],
    }
    write(policy, description, place / DESCRIPTION, place / WEIGHTS)
    return place


def load_policy(folder: str | os.PathLike[str]) -> SavedPolicy:
    """Reads what ``save_policy`` wrote. Raises UserError that names a file that is missing, damaged or not finite."""
    place = Path(folder)
    if not (place / DESCRIPTION).is_file():
        raise UserError(f"{place}: no policy here ({DESCRIPTION} is missing): give the folder of a `cmbrl train` run")
    described = read_record(place / DESCRIPTION, _REMEDY, older=lambda held: held.get("format") != _FORMAT)
    digest = described.pop("weights", None)
    if described.pop("format", None) not in (_FORMAT, _WITHOUT_CHECKSUMS):
        raise UserError(f"{place / DESCRIPTION}: not a policy of this version: train it again")
    try:
        fields: dict[str, Any] = described.pop("architecture")
        with torch.device("meta"):
            policy = Policy(Architecture(**fields | {"hidden": tuple(fields["hidden"])}))
    except (AttributeError, KeyError, TypeError, ValueError, RuntimeError, OverflowError) as error:
        last = (str(error).strip().splitlines() or [""])[-1].strip()
        raise UserError(f"{place / DESCRIPTION}: damaged ({last}): {_REMEDY}") from None
    fill(policy, place / WEIGHTS, digest, _REMEDY)
    if not all(torch.isfinite(value).all() for value in policy.state_dict().values()):
        raise UserError(f"{place / WEIGHTS}: weights are not finite, the run diverged: train again")
    described.pop("observation_scaling", None)
    return SavedPolicy(policy.eval(), described)
