"""What a lag inside a servo's own loop makes of its gain of the velocity, and of the rotor.

A drive may answer late: its torque follows what its law asks for by a first-order lag T, or it measures late. At a
joint of inertia M and damping d,

    (1 + T s) (M s^2 + d s) q = kp (c - q) - kd s q,

whose characteristic polynomial is T M s^3 + (M + d T) s^2 + (d + kd) s + kp. That of a drive without lag, under targets
that lag by T', is (1 + T' s) (M' s^2 + D s + kp), D being its kd' and d' together. They are the same motion where

    T' M' = T M,    M' + D T' = M + d T,    D + kp T' = d + kd,

so targets and positions tell them apart only by what else pulls at the joint. A fit has the second one, by a lag of
the commands. Then the drive's kd is larger by kp T', and the rotor by kd' T', or less, if only a part of what is late
is inside the loop. To first order that holds for delays, too. Intervals reach so far; motion under targets, and so
policies, do not differ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from cmbrl.fitting.fitted_parameter import NOMINAL, FittedParameter
from cmbrl.fitting.outcome.lateness import sum_of_lateness
from cmbrl.fitting.search.space import Space
from cmbrl.scene import Scene

_NORMAL_95 = 1.96
_CLEARLY = 1.2  # times the interval's end without it
_NAMED = 4


def widened(
    scene: Scene, space: Space, z: np.ndarray, covariance: np.ndarray, found: Mapping[str, FittedParameter]
) -> tuple[dict[str, FittedParameter], dict[str, Any] | None]:
    """The parameters ``found``, with intervals that reach as far as what is late may be inside the servos' loops.

    And for the report "late", what that is [s], and "parameters": those whose intervals end clearly farther out, with
    what they are if all of it is inside; None where there are none. ``covariance`` (n, n) in z, zero for what is not
    fitted.
    """
    value, deviation = sum_of_lateness(space, z, covariance)
    most, wider, told = value + _NORMAL_95 * deviation, dict(found), {}
    bound = dict(zip(space.names, space.high.tolist(), strict=True))
    for name, (grows, at_most) in _growth(scene, found).items() if value > 0.0 else ():
        own = found[name]
        wider[name] = replace(own, high=float(max(own.high, min(own.high + at_most * most, bound[name]))))
        if wider[name].high > _CLEARLY * own.high:
            told[name] = own.value + grows * value
    return wider, {"late": value, "parameters": told} if told else None


def _growth(scene: Scene, found: Mapping[str, FittedParameter]) -> dict[str, tuple[float, float]]:
    """By how much kd and rotor of each servo grow by a second of lag inside its loop, and by how much at most.

    The damping of its joint takes the part of a kd that was held. Only what a fit has moved.
    """
    growth: dict[str, tuple[float, float]] = {}
    for k, (servo, line) in enumerate(zip(scene.actuator_names, scene.core.act_line.tolist(), strict=True)):
        if not (0 <= line < scene.nv and f"kp.{servo}" in found):
            continue
        joint, stiff, kd = scene.coordinate_names[line], found[f"kp.{servo}"], found.get(f"kd.{servo}")
        geared = float(scene.core.P[scene.layout.actuator(k)]) ** 2
        if kd is not None and kd.status != NOMINAL:
            growth[f"kd.{servo}"] = stiff.value, stiff.most
        else:
            growth[f"damping.{joint}"] = geared * stiff.value, geared * stiff.most
        if kd is not None:
            growth[f"armature.{joint}"] = geared * kd.value, geared * kd.most
    return {name: by for name, by in growth.items() if name in found and found[name].status != NOMINAL}


def inner_lag_told(parameters: Mapping[str, FittedParameter], report: Mapping[str, Any]) -> str | None:
    """One line on ``report["inner_lag"]``; None where there is nothing to say."""
    found = report.get("inner_lag")
    if not found:
        return None
    inside = found["parameters"]
    names = [f"{name} {parameters[name].shown:.3g} or {x:.3g}" for name, x in list(inside.items())[:_NAMED]]
    more = f" and {len(inside) - _NAMED} more" if len(inside) > _NAMED else ""
    return (
        "commands that come late, and drives that answer late within their own loops (a lag of the torque, or of what "
        "they measure) move a servo alike, if kd is larger by kp times that lag, and the rotor by kd times it: "
        f"intervals reach so far ({', '.join(names)}{more}); motion under targets is the same"
    )
