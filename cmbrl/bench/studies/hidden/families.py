"""The study's draws of hidden robots: the families of :mod:`cmbrl.hidden`, with random numbers of its own by scene.

The families "parameters", "payload" and "floor" stay within what the file can say. "outside" keeps the file and adds
friction loss here; everything else of it no file of the model class can say, so it is in :mod:`cmbrl.hidden.flaws`.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from cmbrl.bench.studies.hidden.plan import DRAW_SEED, FAMILIES, FLOOR, OUTSIDE, PARAMETERS, PAYLOAD, SCENES
from cmbrl.data.recorder import without_mujoco_warnings
from cmbrl.hidden.changes import PAYLOAD_SHARE, add_sphere, floor, friction_loss, parameters

PAYLOAD_RADIUS = 0.08  #: m, of a solid sphere
PAYLOAD_PLACE = {"hopper": ((0.05, 0.15), (-0.15, 0.15)), "cheetah": ((0.1, 0.4), (0.0, 0.1))}
"""scene -> how far before or behind the torso's origin [m], and how far above it [m]"""


def generator(scene: str, family: str, draw: int, part: int = 0) -> np.random.Generator:
    """Of one part of one draw; draws do not depend on each other."""
    return np.random.default_rng([DRAW_SEED, SCENES.index(scene), FAMILIES.index(family), draw, part])


def changed(scene: str, path: str, family: str, draw: int) -> mujoco.MjModel:
    """The file's model with the changes of a draw that a file can say: what the oracle is given."""
    with without_mujoco_warnings():
        model = mujoco.MjModel.from_xml_path(path)
    rng = generator(scene, family, draw)
    if family == PAYLOAD:
        _payload(model, rng, scene)
    else:
        {PARAMETERS: parameters, FLOOR: floor, OUTSIDE: friction_loss}[family](model, rng)
    mujoco.mj_setConst(model, mujoco.MjData(model))  # what the compiler derives from the rest
    return model


def _payload(model: Any, rng: np.random.Generator, scene: str) -> None:
    """A solid sphere in the torso, off centre in the plane of motion."""
    along, above = PAYLOAD_PLACE[scene]
    place = (rng.choice([-1.0, 1.0]) * rng.uniform(*along), 0.0, rng.uniform(*above))
    mass = PAYLOAD_SHARE * float(model.body_mass.sum())
    add_sphere(model, model.body("torso").id, mass, PAYLOAD_RADIUS, place)
