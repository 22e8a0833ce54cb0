"""Joints that follow another one by an equality of the file, as a gripper's second finger: no column need tell them."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import polynomial

from cmbrl.scene.records import JointKind, TieKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene

Law = tuple[int, int, np.ndarray]  #: places in v of a joint and of its leader; coefficients


def laws(scene: Scene) -> list[Law]:
    """Which hinges and slides of ``scene`` follow which, and how; in both directions where a line ties them."""
    core, found = scene.core, []
    single = {joint.vadr for joint in scene.joints if joint.kind != JointKind.BALL}
    for k in range(core.ntie):
        a, b = int(core.tie_A[k]), int(core.tie_B[k])
        if core.tie_type[k] != TieKind.POLYNOMIAL or a not in single or b not in single:
            continue
        (at, of), poly = core.tie_ref[k], core.tie_poly[k]
        found.append((a, b, _shifted(poly, at, of)))
        if poly[1] and not poly[2:].any():
            found.append((b, a, _shifted(np.array([-poly[0] / poly[1], 1 / poly[1]]), of, at)))
    return found


def followers(scene: Scene, known: Collection[int]) -> list[Law]:
    """The laws that tell joints which are not ``known`` by their places in v, each after the law of its leader."""
    told = set(known)
    steps: list[Law] = []
    while True:  # a chain of ties takes a turn a link
        law = next((law for law in laws(scene) if law[0] not in told and law[1] in told), None)
        if law is None:
            return steps
        steps.append(law)
        told.add(law[0])


def _shifted(poly: np.ndarray, at: float, of: float) -> np.ndarray:
    """``at + poly(x - of)`` as coefficients in x, the constant one first."""
    total = np.array([0.0])
    for coefficient in poly[::-1]:
        total = polynomial.polyadd(polynomial.polymul(total, [-of, 1.0]), [coefficient])
    return polynomial.polyadd(total, [at])
