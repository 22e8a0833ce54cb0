"""Whether a decision process fits its robot: widths of states and controls, ranges of commands and joints, overlaps."""

from __future__ import annotations

import warnings
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from cmbrl.envs.checked import called, started
from cmbrl.errors import UserError
from cmbrl.scene.records import JointKind

if TYPE_CHECKING:
    from cmbrl.mdp import MDP
    from cmbrl.registry import Task
    from cmbrl.scene import Scene

STARTS = 32  # states that are tried
DEEP, MOST = 0.01, 0.5  # m inside each other in this share of the starts: noise of resets stays below in most
TURNS = (0.5, 2.0)  # norms of quaternions: models scale them, and noise of resets may change them somewhat
LITTLE, WASTED = 0.1, 0.75  # shares: of a range of controls that actions reach, and of the actions that lie within it
BEYOND, SOME = 0.05, 0.1  # of a joint's range, which limits may give way, in this share of the starts
LONG = 0.1  # s: no robot moves by so long a physics step
TURNED = 3.0  # times the largest angle of a joint: an angle in degrees
TURN = 6.5  # rad, somewhat more than a turn


def check_robot(mdp: MDP, task: Task) -> None:
    """Raises UserError where ``mdp`` moves another robot than the one of the task's file, and warns of likely mistakes.

    Those are physics steps in milliseconds, commands beyond an actuator's range, or in a tenth of it, and starts
    beyond limits of joints, inside the floor or each other. A file that cannot be modelled is not looked at: its real
    system can act all the same.
    """
    scene = None
    with suppress(UserError):
        scene = task.load_scene()
    if task.time_step > LONG:
        warnings.warn(
            f"task {task.name!r}: Task.time_step is {task.time_step:g} s: give seconds, not milliseconds, or more "
            "substeps",
            stacklevel=2,
        )
    if scene is not None:
        _check(mdp, scene, f"task {task.name!r}")


def check_widths(mdp: MDP, task: Task) -> None:
    """Raises UserError where starts of ``mdp`` have another width than the task's file, if that can be modelled."""
    scene, label = None, f"task {task.name!r}"
    with suppress(UserError):
        scene = task.load_scene()
    if scene is not None:
        _check_widths(mdp, *started(mdp, STARTS, label), scene, label)


def _check_widths(mdp: MDP, q: Tensor, v: Tensor, scene: Scene, label: str) -> None:
    kept = f" and MDP.memory is {mdp.memory}" if mdp.memory else ""
    _width(q, scene.nq + mdp.memory, f"{label}: MDP.reset gives q", f"the file has {scene.nq} position(s){kept}")
    _width(v, scene.nv, f"{label}: MDP.reset gives v", f"the file has {scene.nv} velocities")


@torch.no_grad()
def _check(mdp: MDP, scene: Scene, label: str) -> None:
    q, v = started(mdp, STARTS, label)
    _check_widths(mdp, q, v, scene, label)
    _check_turns(mdp.robot(q), scene, label)
    start, least = _acted(mdp, q, v, -1.0, scene, label)
    _, most = _acted(mdp, q, v, 1.0, scene, label)
    ends = torch.stack([least, most]).numpy()
    if (ends == ends[:, :1]).all():  # else a law of the state, such as a servo's, whose commands may well be too large
        _warn_of_ranges(ends[:, 0], mdp.act is not type(mdp).act, scene, label)
    at = mdp.robot(start).numpy()
    _warn_of_limits(at, scene, label)
    _warn_of_degrees(at, scene, label)
    _warn_of_overlap(at, scene, label)


def _acted(mdp: MDP, q: Tensor, v: Tensor, action: float, scene: Scene, label: str) -> tuple[Tensor, Tensor]:
    """q (B, n), from which a step starts, and controls (B, nu), of actions that are all ``action``.

    Raises UserError where ``MDP.act`` does not give rows of states and controls.
    """
    q_from, v_from, u = called(mdp.act, "act", label, q, v, q.new_full((len(q), mdp.actions), action))
    for name, x, width in (("q", q_from, q.shape[1]), ("v", v_from, v.shape[1])):
        _width(x, width, f"{label}: MDP.act gives {name}", "as MDP.reset does")
    where = "MDP.actions" if mdp.act is type(mdp).act else "MDP.act"
    _width(u, scene.nu, f"{label}: controls are", f"the file has {scene.nu} actuator(s)", f": fix {where}")
    if u.dtype != torch.float64:
        raise UserError(f"{label}: MDP.act gives controls of {u.dtype}: make them with dtype=torch.float64")
    return q_from, u


def _width(x: Tensor, width: int, what: str, why: str, remedy: str = ": mend it") -> None:
    if x.dim() != 2 or x.shape[1] != width:
        raise UserError(f"{what} of shape {tuple(x.shape)}, not (..., {width}): {why}{remedy}")


def _check_turns(q: Tensor, scene: Scene, label: str) -> None:
    """Raises UserError where a quaternion of ``q`` (B, nq) is far from length 1, such as one that was left zero."""
    for address in scene.core.jnt_qadr[scene.core.jnt_type == JointKind.BALL]:
        norm = q[:, address : address + 4].norm(dim=1)
        worst = norm[(norm - 1.0).abs().argmax()]
        if not TURNS[0] < worst < TURNS[1]:
            raise UserError(
                f"{label}: MDP.reset gives q[:, {address}:{address + 4}] a norm of {worst:.4g}: give unit quaternions "
                "in the order w x y z"
            )


def _warn_of_ranges(ends: np.ndarray, own: bool, scene: Scene, label: str) -> None:
    """Warns of an actuator whose range the controls (2, nu) of actions of -1 and 1 fill badly, if it has a range.

    ``own``: by ``MDP.act``; that a task keeps to a small part of a range is then its choice.
    """
    low, high = np.reshape(scene.core.act_ctrl, (-1, 2)).T
    shared = np.minimum(ends.max(axis=0), high) - np.maximum(ends.min(axis=0), low)
    little = np.isfinite(high - low) & (shared < LITTLE * (high - low)) & (not own)
    for bad in (little, shared < WASTED * np.ptp(ends, axis=0)):
        if bad.any():
            k = int(np.argmax(bad))
            made = f"MDP.act gives controls of {ends[0, k]:g} to {ends[1, k]:g}"
            warnings.warn(
                f"{label}: {made if own else 'actions of -1 to 1 are the controls'}, and {scene.actuator_names[k]} "
                f"takes {low[k]:g} to {high[k]:g}: scale them (MDP.act = cmbrl.mdp.between(low, high))",
                stacklevel=2,
            )
            return


def _warn_of_limits(q: np.ndarray, scene: Scene, label: str) -> None:
    """Warns of the joint that starts (B, nq) leave furthest outside its range, unless the file itself does so too."""
    core, single = scene.core, {joint.vadr: joint for joint in scene.joints if joint.kind != JointKind.BALL}
    limited = [k for k, line in enumerate(core.lim_line.tolist()) if line in single]
    if not limited:
        return
    joints = [single[core.lim_line[k]] for k in limited]
    at, rest = (x[..., [joint.qadr for joint in joints]] for x in (q, scene.q0))
    low, high = core.lim_lo[limited], core.lim_hi[limited]
    beyond = np.maximum(low - at, at - high) / (high - low)
    beyond[:, (rest < low) | (rest > high)] = 0.0
    often = (beyond > BEYOND).mean(axis=0) >= SOME
    k = int(np.argmax(beyond.max(axis=0) * often))
    if often[k]:
        worst, turns = at[beyond[:, k].argmax(), k], joints[k].kind == JointKind.HINGE
        degrees = turns and abs(worst) > TURNED * max(abs(low[k]), abs(high[k]))
        warnings.warn(
            f"{label}: MDP.reset starts with {joints[k].name} at up to {worst:.4g} {'rad' if turns else 'm'}, and its "
            f"range is {low[k]:.4g} to {high[k]:.4g}: {'give radians, not degrees' if degrees else 'start inside it'}",
            stacklevel=2,
        )


def _warn_of_degrees(q: np.ndarray, scene: Scene, label: str) -> None:
    """Warns of the hinge without limits that starts (B, nq) turn furthest, if beyond a turn, as degrees do."""
    limited = set(scene.core.lim_line.tolist())
    free = [x for x in scene.joints if x.kind == JointKind.HINGE and x.vadr not in limited]
    if not free:
        return
    angles = np.abs(q[:, [joint.qadr for joint in free]])
    angles[:, (angles > TURN).mean(axis=0) < SOME] = 0.0
    k = int(np.argmax(angles.max(axis=0)))
    if (most := angles[:, k].max()) > TURN:
        warnings.warn(
            f"{label}: MDP.reset starts with {free[k].name} at up to {most:.4g} rad, and a turn is 6.283: give "
            "radians, not degrees",
            stacklevel=2,
        )


def _warn_of_overlap(q: np.ndarray, scene: Scene, label: str) -> None:
    """Warns of starts (B, nq) with bodies deep in the floor, or in each other where the file keeps them apart."""
    if not scene.core.ncontact:
        return
    gap = scene.gaps(q)
    gap[:, (np.asarray(scene.core.con_plane) < 0) & (scene.gaps(scene.q0) < -DEEP)] = 0.0  # links that always overlap
    deep = (gap < -DEEP).mean(axis=0)
    k = int(np.argmax(deep))
    if deep[k] >= MOST:
        warnings.warn(
            f"{label}: in {deep[k]:.0%} of the starts of MDP.reset bodies are inside each other "
            f"({scene.contact_names[k]}: {-1e3 * gap[:, k].min():.0f} mm deep), and are thrown apart: start them apart",
            stacklevel=2,
        )
