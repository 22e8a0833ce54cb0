"""solref, which says how fast and how damped a constraint corrects an error, as MuJoCo takes it from a file.

Two numbers above 0 are a time constant and a damping ratio; two that are not are a stiffness and a damping, negated.
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from cmbrl.scene.records import Array
from cmbrl.scene.source.mjcf import friction_acts, ignores, limits_act, name_of
from cmbrl.scene.source.support import Gate

_DEFAULT = (0.02, 1.0)  # MuJoCo's: a time constant [s] and a damping ratio


def acting(solref: Array, default: tuple[float, float] = _DEFAULT) -> Array:
    """solref (..., 2) as it acts: MuJoCo's default in place of one that is neither of both kinds."""
    return np.where(_is_mixed(solref)[..., None], default, solref)


def note_if_mixed(solref: Array, kind: str, name: str, gate: Gate) -> None:
    """Tells the gate if the default acts in place of solref (2,)."""
    if _is_mixed(solref):
        first, second = solref
        why = f"only one number of solref {first:g} {second:g} is above 0: MuJoCo's default, .02 1, acts"
        gate.note(kind, name, why)


def check_solrefs(model: mujoco.MjModel, gate: Gate) -> None:
    """Tells the gate where the default acts, but for contacts, which mix theirs first."""
    for kind, number, solref in _solrefs(model):
        note_if_mixed(solref, kind, name_of(model, kind.split()[0], number), gate)


def _solrefs(model: mujoco.MjModel) -> Iterator[tuple[str, int, Array]]:
    """Kind and number of everything with constraints that act, and its solref (2,)."""
    if limits_act(model):
        for k in np.flatnonzero(model.jnt_limited).tolist():
            yield "joint limit", k, model.jnt_solref[k]
        for k in np.flatnonzero(model.tendon_limited).tolist():
            yield "tendon limit", k, model.tendon_solref_lim[k]
    if friction_acts(model):
        lossy = np.flatnonzero(model.dof_frictionloss)
        for dof in lossy[np.unique(model.dof_jntid[lossy], return_index=True)[1]].tolist():
            yield "joint friction", int(model.dof_jntid[dof]), model.dof_solref[dof]
        for k in np.flatnonzero(model.tendon_frictionloss).tolist():
            yield "tendon friction", k, model.tendon_solref_fri[k]
    if not (ignores(model, "EQUALITY") or ignores(model, "CONSTRAINT")):
        for k in np.flatnonzero(model.eq_active0).tolist():
            yield "equality", k, model.eq_solref[k]


def _is_mixed(solref: Array) -> NDArray[np.bool_]:
    """Whether (...) one number of solref (..., 2) is above 0, and the other is not."""
    found: NDArray[np.bool_] = (solref[..., 0] > 0) != (solref[..., 1] > 0)
    return found
