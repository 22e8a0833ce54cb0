"""Why a step differs from MuJoCo's: features of the file are switched off in both, until the steps agree.

``cmbrl check`` does so where a step's error is above its limit, and names what it had to switch off. What the scene has
left out of the file is taken in instead. Where only the default differs, it names the option that makes the difference.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from cmbrl.bench.check_steps import States, mujocos, step_errors
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.source.mjcf import early

STATES = 40  # at most
GAIN = 0.8  # what is switched off must leave less than this share of the error
_OFF = mujoco.mjtDisableBit
_SEARCHED = (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_ELLIPSOID, mujoco.mjtGeom.mjGEOM_MESH)


@dataclass(frozen=True)
class Feature:
    """Something that ``switch_off`` takes out of MuJoCo's model, in words; or contacts that a scene leaves out."""

    name: str
    switch_off: Callable[[mujoco.MjModel], None] = lambda model: None
    self_contact: str | None = None  # of the scene, instead of its own


def reason(
    scene: Scene, sliding: str, theirs: mujoco.MjModel, states: States, error: float, limit: float
) -> tuple[str, float] | None:
    """What to switch off, in words, and the median error without it; None if nothing helps.

    All features are off at first; then each comes back, those that say least at first, unless that brings the error
    above ``limit`` again (or above what is left without any of them). So features that differ only together are found.
    """
    states, off = states.first(STATES), [*_left_out(scene), *_features(theirs)]
    best = _error(scene, sliding, theirs, states, off)
    if best > GAIN * error:
        return None
    enough = max(limit, best / GAIN)
    for feature in reversed(off):
        kept = [other for other in off if other is not feature]
        without = _error(scene, sliding, theirs, states, kept) if kept else error
        if without <= enough:
            off, best = kept, without
    return " and ".join(feature.name for feature in off), best


def option(
    model: ComplementarityModel, theirs: mujoco.MjModel, states: States, error: float
) -> tuple[str, float] | None:
    """The setting of ``model`` that takes away most of its median ``error``, and what is left; None if none helps."""
    others: dict[str, dict[str, Any]] = {
        "look_ahead=False": {"look_ahead": False},
        "sliding='convex'": {"sliding": "convex", "look_ahead": model.look_ahead},
        "integrator='rk4'": {"integrator": "rk4"} if mujocos(model.scene).get("integrator") else {},
    }
    models = {name: model.with_settings(**settings) for name, settings in others.items() if settings}
    found, _ = step_errors(list(models.values()), theirs, states.first(STATES))
    left = {name: float(np.median(errors)) for name, errors in zip(models, found, strict=True)}
    best = min(left, key=left.__getitem__)
    return (best, left[best]) if left[best] < GAIN * error else None


def _error(scene: Scene, sliding: str, theirs: mujoco.MjModel, states: States, features: Sequence[Feature]) -> float:
    changed = copy.deepcopy(theirs)
    self_contact = scene.self_contact
    for feature in features:
        feature.switch_off(changed)
        self_contact = feature.self_contact or self_contact
    try:
        ours = Scene.from_mjcf(changed, scene.ignore, scene.contact_law, scene.reduce, self_contact, scene.drives)
        settings = mujocos(ours) if sliding == "convex" else {}
        (found,), _ = step_errors([ComplementarityModel(ours, **settings)], changed, states)
    except UserError:  # it asks for what the change took away
        return np.inf
    return float(np.median(found))


def _left_out(scene: Scene) -> Iterator[Feature]:
    if scene.self_contact != "all" and any("self-contact" in contact.why for contact in scene.dropped_contacts):
        yield Feature("with --self-contact all", self_contact="all")


def _features(theirs: mujoco.MjModel) -> Iterator[Feature]:
    """Those that the file has; what says least comes last."""

    def without(bit: int) -> Callable[[mujoco.MjModel], None]:
        def switch_off(model: mujoco.MjModel) -> None:
            model.opt.disableflags |= int(bit)

        return switch_off

    if early(theirs.opt):
        yield Feature("with MuJoCo's solver run to its end", _to_the_end)
    if theirs.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        yield Feature("with implicitfast for RK4", _no_rk4)
    if theirs.opt.noslip_iterations:
        yield Feature("without the noslip pass", _no_noslip)
    if np.any(theirs.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD):
        yield Feature("with a margin of 1 nm for MuJoCo's height fields", _margin)
    if np.isin(theirs.geom_type, _SEARCHED).any():
        yield Feature("with MuJoCo's contact search run to its end", _sharp)
    yield Feature("with links that pass through each other", _part_links)
    if theirs.jnt_limited.any() or theirs.tendon_limited.any():
        yield Feature("without limits", without(_OFF.mjDSBL_LIMIT))
    if theirs.dof_frictionloss.any() or theirs.tendon_frictionloss.any():
        yield Feature("without friction loss", without(_OFF.mjDSBL_FRICTIONLOSS))
    if theirs.eq_active0.any():
        yield Feature("without equality constraints", without(_OFF.mjDSBL_EQUALITY))
    yield Feature("without contacts", without(_OFF.mjDSBL_CONTACT))


def _part_links(model: mujoco.MjModel) -> None:
    """Geoms of moving bodies touch those of the world only."""
    moves = model.body_weldid[model.geom_bodyid] != 0
    touches = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    model.geom_contype[:] = touches & ~moves
    model.geom_conaffinity[:] = touches & moves


def _margin(model: mujoco.MjModel) -> None:
    """MuJoCo takes boxes and meshes with a margin for smooth, and does not stop at a corner that it has seen."""
    model.geom_margin[:] = np.maximum(model.geom_margin, 1e-9)


def _to_the_end(model: mujoco.MjModel) -> None:
    model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
    model.opt.iterations, model.opt.ls_iterations = 1000, 1000
    model.opt.tolerance, model.opt.ls_tolerance = 0.0, 1e-8


def _sharp(model: mujoco.MjModel) -> None:
    """Usually it ends with normals of round shapes up to 5 mrad off."""
    model.opt.ccd_tolerance, model.opt.ccd_iterations = 1e-12, 1000


def _no_noslip(model: mujoco.MjModel) -> None:
    model.opt.noslip_iterations = 0


def _no_rk4(model: mujoco.MjModel) -> None:
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
