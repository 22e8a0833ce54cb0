"""With which code a result was made, where, and from how many seeds."""

from __future__ import annotations

from typing import Any

from cmbrl.code_digest import code_digest
from cmbrl.runs import environment

SECTION = "section.json"  #: a study's result, in its folder
_PACKAGES = ("mujoco", "numpy", "torch")


def made(module: str, seeds: int) -> dict[str, Any]:
    """The record of a result that ``module`` makes now from so many seeds."""
    return {**environment(), "module": module, "code": code_digest(module), "seeds": seeds}


def line(record: dict[str, Any]) -> str:
    """A record as one sentence."""
    versions, hardware = record["versions"], record["hardware"]
    packages = ", ".join(f"{name} {versions[name]}" for name in _PACKAGES if name in versions)
    commit = f"commit {record['commit']}" if record["commit"] else "no checkout"
    seeds = f"{record['seeds']} seed{'s' * (record['seeds'] != 1)}"
    return (
        f"Made by cmbrl {versions['cmbrl']} ({commit}, code {record['code']} of {record['module']}) from {seeds} on "
        f"{hardware['processor']}, {hardware['cores']} cores; {packages}."
    )
