"""Which law of sliding each model in a table has, and its time step: errors under two laws compare more than values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from cmbrl.accuracy.named_models import NOMINAL, is_file, label
from cmbrl.models.complementarity import ComplementarityModel


def laws_told(models: Mapping[str, Any], words: Sequence[str], doubt: bool = True) -> list[str]:
    """A line for each law, with the models with contacts that have it; ``doubt``: and one on files without MuJoCo's.

    These may look worse than the file is.
    """
    found = {name: getattr(model, "model", model) for name, model in models.items()}  # a residual's is within
    own = {name: one for name, one in found.items() if isinstance(one, ComplementarityModel) and _touches(one)}
    by_law: dict[str, list[str]] = {}
    for name, model in own.items():
        by_law.setdefault(_law(model), []).append(name)
    told = [f"{law}: {', '.join(names)}" for law, names in by_law.items()]
    files = [label(word, words) for word in words if word == NOMINAL or is_file(word)]
    apart = [name for name in files if name in own and _slides_apart(own[name])]
    if doubt and apart:
        told.append(f"{', '.join(apart)}: if MuJoCo made the log, give the file its law by --sliding convex")
    return told


def _touches(model: ComplementarityModel) -> bool:
    return bool(len(model.scene.contact_names))


def _slides_apart(model: ComplementarityModel) -> bool:
    return model.sliding == "coulomb" and model.scene.contact_law == "mujoco"


def _law(model: ComplementarityModel) -> str:
    law = "exact Coulomb" if model.sliding == "coulomb" else "MuJoCo's convex law"
    ahead = ", rows that look ahead" if model.sliding == "convex" and model.look_ahead else ""
    return f"law of sliding: {law}{ahead}, time step {1e3 * model.time_step:.4g} ms"
