"""Whether what a fit leaves looks like play between motors and links, which its file does not have.

No parameter of a joint does what play does, and inertias, friction and damping make up for a part of it, so that only
residuals tell. Each driven joint gets play of several sizes in turn; the play is followed along the log as in a fit of
it (``cmbrl.models.between.following``), and what it changes is compared with the residuals (``unexplained``). The
encoder has to be the motor's: where it is the link's, play changes predictions in another way, and nothing is found.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from cmbrl.data.unlogged import unlogged, with_columns
from cmbrl.errors import UserError
from cmbrl.fitting.choice.unexplained import Unexplained
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.search.folds import draw_starts, windows_in_blocks
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.state import Journal, OutOfTime
from cmbrl.scene import Scene
from cmbrl.scene.records import Joint, JointKind
from cmbrl.scene.writing.played import played_scene

_GAPS, _SLIDE = (0.003, 0.008, 0.02, 0.05), 0.1  # [rad]; a tenth of it [m]
_AHEAD = 0.1  # [s] that is predicted: what play does is over by then
_ROWS = 3000  # predicted for each size
_WORK = 300_000  # rows predicted and followed in all; joints of which most is unexplained come first
_CLEARLY, _LEAST = 0.1, 0.05  # share of the squares of what is left that play explains at one joint, and at one more
_AS_PLAYED = 0.3, 3.0  # c of its trace


def play_shown(
    evidence: Evidence, z: np.ndarray, active: np.ndarray, huber: float, seed: int, journal: Journal
) -> list[dict[str, Any]]:
    """Joints whose play explains residuals at ``z`` (n,) that its ``active`` (n,) parameters do not, clearest first.

    By each: the "joint", a "gap" [rad, m] to begin with, and the share of the squares of what was left that it
    "explains" beside those before. Empty where nothing shows it, or the scene is not of a file that may get play.
    """
    scene = evidence.model.scene
    if evidence.free or not scene.path or scene.urdf_changes:
        return []
    steps = max(2, round(_AHEAD / evidence.log.dt))
    if not len(windows_in_blocks(evidence.log, steps)):  # episodes that are shorter
        return []
    starts = draw_starts(evidence.log, steps, _ROWS, seed)
    loss, theta = evidence.loss(starts, steps, *evidence.scales(steps, huber)), evidence.space.theta(z)
    work = len(_GAPS) * (len(evidence.log) + len(starts) * steps)
    changes: dict[Hashable, tuple[PredictionLoss, np.ndarray]] = {}
    with suppress(OutOfTime):
        for joint in _joints(evidence, loss, theta)[: max(1, _WORK // work)]:
            journal.check_time()
            changes |= _played(evidence, joint, theta, starts, steps, huber)
    if not changes:
        return []
    return _clearest(Unexplained.of(loss, evidence.space, z, active, changes))


def may_play(scene: Scene) -> list[Joint]:
    """Hinges and slides that an actuator drives and whose rotor the file knows."""
    rotors = {p.name.partition(".")[2] for p in scene.parameters if p.group == "armature" and p.nominal > 0.0}
    driven = {line for line in scene.core.act_line.tolist() if 0 <= line < scene.nv}
    joints = [j for j in scene.joints if j.kind in (JointKind.HINGE, JointKind.SLIDE) and j.name in rotors]
    return [j for j in joints if j.vadr in driven]


def _joints(evidence: Evidence, loss: PredictionLoss, theta: np.ndarray) -> list[str]:
    """Those whose positions are compared, the least explained ones first."""
    compared = np.flatnonzero(loss.windows.scales.counts).tolist()
    off = np.nan_to_num(np.square(loss.residuals(theta)[0]).mean(axis=(0, 1)), nan=np.inf)
    found = [j for j in may_play(evidence.model.scene) if j.vadr in compared]
    return [j.name for j in sorted(found, key=lambda j: -off[compared.index(j.vadr)])]


def _played(
    evidence: Evidence, joint: str, theta: np.ndarray, starts: np.ndarray, steps: int, huber: float
) -> dict[Hashable, tuple[PredictionLoss, np.ndarray]]:
    """The windows from ``starts`` with play at ``joint``, and its parameters, by (joint, gap)."""
    own = evidence.model.scene
    found: dict[Hashable, tuple[PredictionLoss, np.ndarray]] = {}
    slides = next(j.kind == JointKind.SLIDE for j in own.joints if j.name == joint)
    try:
        scene = played_scene(own, {joint: None})
    except UserError:  # a file that cannot have it, or that has changed
        return {}
    values = dict(zip(evidence.space.names, theta.tolist(), strict=True))
    played = with_play(evidence, scene, values)
    if played is None:
        return {}
    for size in _GAPS:
        gap = size * (_SLIDE if slides else 1.0)
        at = played.space.nominal.copy()
        at[played.space.names.index(f"play.{joint}")] = gap
        try:
            seen = played.following(at)
        except UserError:  # a reading of no robot throws the link
            return {}
        found[joint, gap] = seen.loss(starts, steps, *seen.scales(steps, huber)), at
    return found


def with_play(evidence: Evidence, scene: Scene, values: Mapping[str, float]) -> Evidence | None:
    """``evidence`` of the same robot with play, ``scene``, at ``values`` by name; None if it is of another one."""
    theta = np.array([values.get(p.name, p.nominal) for p in scene.parameters])
    try:
        model = evidence.model.with_settings(scene=scene, parameters=theta)
    except UserError:  # a setting that this scene has not
        return None
    log = with_columns(evidence.log, scene)
    free = tuple(unlogged(log, scene))
    if log.q.shape[1] != scene.nq or not free:
        return None
    logged = ~np.isin(np.arange(scene.nv), [joint.vadr for joint in free])
    measured, sloped = np.zeros(scene.nv, dtype=bool), np.zeros(scene.nv, dtype=np.int64)
    measured[logged], sloped[logged] = evidence.measured, evidence.sloped
    observation = model.observer
    start = np.append(theta, [values.get(p.name, p.nominal) for p in observation.parameters])
    space = Space.of((*scene.parameters, *observation.parameters), start)
    return replace(
        evidence,
        model=model,
        log=log,
        observation=observation,
        space=space,
        measured=measured,
        free=free,
        sloped=sloped,
    )


def _clearest(test: Unexplained) -> list[dict[str, Any]]:
    """Joints one after the other, as long as play at one more explains a clear share of what is left."""
    left, found = test.left([])[0], []
    taken: list[Any] = []
    names: list[Any] = list(test.names)
    while names:
        tried = [(*test.left([*taken, name]), name) for name in names]
        like = [
            (rest, name) for rest, c, name in tried if _AS_PLAYED[0] < c[:, -1].min() and c[:, -1].max() < _AS_PLAYED[1]
        ]
        if not like:
            break
        rest, name = min(like, key=lambda each: each[0])
        if rest > (1.0 - (_LEAST if taken else _CLEARLY)) * left:
            break
        joint, gap = name
        found.append({"joint": joint, "gap": gap, "explains": 1.0 - rest / left})
        left, taken, names = rest, [*taken, name], [each for each in names if each[0] != joint]
    return found


def gaps_to_try(scene: Scene, shown: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Gaps [rad, m] to begin with at every joint that may have play, once ``shown`` has it at one; else none.

    Motors of a robot are alike. What is hidden at the others keeps a fit from finding the gaps that show, and where
    there is none, it closes. Of two hidden hoppers with play at three joints, with that of one alone in the file,
    friction stayed on its bound.
    """
    gaps = {each["joint"]: float(each["gap"]) for each in shown}
    units = {j.name: _SLIDE if j.kind == JointKind.SLIDE else 1.0 for j in may_play(scene)}
    usual = float(np.median([gap / units[name] for name, gap in gaps.items()])) if gaps else 0.0
    return {name: gaps.get(name, usual * unit) for name, unit in units.items()} if gaps else {}


def shown_told(report: Mapping[str, Any]) -> str | None:
    """One line on play that residuals show: what a fit with it gave, or the commands that try it; else None."""
    found, tried = report.get("play"), report.get("with_play")
    if tried and tried["taken"]:
        return (
            "Residuals of a fit of the file showed play between motor and link. So it was fitted with play at "
            f"{', '.join(tried['gaps'])}, too ({tried['seconds']:.0f} s for both). That leaves {tried['error']:.2g} of "
            "the error on unseen seconds, and is the fit given here; --no-play fits the file alone."
        )
    if not found:
        return None
    gaps = report.get("gaps") or {each["joint"]: each["gap"] for each in found}
    names, share = " and ".join(each["joint"] for each in found), 100.0 * found[0]["explains"]
    shown = (
        f"What this fit leaves looks like play between motor and link at {names} ({share:.0f} % of the squares of its "
        "errors)."
    )
    if tried:
        left = "no finite error" if tried["error"] is None else f"{tried['error']:.2g} of the error"
        return (
            f"{shown} With play at all joints with rotors a fit leaves {left} on unseen seconds, so that it was not "
            "taken."
        )
    options = " ".join(f"--play {name}={gap:g}" for name, gap in gaps.items())
    return (
        f"{shown} Put it into the file at all joints with rotors by `cmbrl convert FILE.xml played.xml {options}`, "
        "fit played.xml to the same log, and compare both by `cmbrl error`; where there is none, the gap closes."
    )
