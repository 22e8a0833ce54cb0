"""Moves mass: what a fitted inertia of a moving body means for each body of the file that is welded into it.

With second moments S about the centre c of mass m, the fitted body (m', c', S') is the nominal one under the linear map

    x -> c' + T (x - c),   T (S / m) T^T = S' / m',   T symmetric,

with densities scaled to the mass m'. So every part keeps a mass that is nowhere negative. T is the optimal transport
between two ellipsoids (Gelbrich 1990), the identity where only masses and centres change.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.manifold import quaternion_matrix
from cmbrl.scene.records import Array, Body, Frame

_FLAT = 1e-9  # of the largest second moment: a body without extent in this direction stays so
_SAME = 1e-12
_PRINCIPAL = 1e-9  # of the largest moment, what products of inertia are below in principal axes
_ROUNDED = 1e-5  # of a moment, by which it may be off where it is written


@dataclass(frozen=True)
class Inertial:
    """Mass, its centre (3,), and inertia about it (3, 3), in the frame of a moving body."""

    mass: float
    com: Array
    inertia: Array

    @classmethod
    def of_file(cls, model: mujoco.MjModel, number: int, frame: Frame) -> Inertial:
        """Of a body of the file, whose ``frame`` is given in that of the moving body."""
        axes = frame.rot @ quaternion_matrix(model.body_iquat[number])
        inertia = axes @ np.diag(model.body_inertia[number]) @ axes.T
        return cls(float(model.body_mass[number]), frame.pos + frame.rot @ model.body_ipos[number], inertia)

    def write(self, element: Any, frame: Frame, nominal: Array) -> None:
        """Into the specification of the body with this ``frame``.

        The axes stay those of the quaternion ``nominal`` (4,) if they are principal. Those of a rod could turn about
        it, and the box that a fluid drags with them.
        """
        quaternion, own = np.array(nominal), quaternion_matrix(nominal)
        inertia = own.T @ frame.rot.T @ self.inertia @ frame.rot @ own
        moments = np.diag(inertia).copy()
        if np.abs(inertia - np.diag(moments)).max() > _PRINCIPAL * moments.max():
            moments, axes = np.linalg.eigh(inertia)
            mujoco.mju_mat2Quat(quaternion, (own @ axes * np.sign(np.linalg.det(axes))).ravel())
        write_inertial(element, self.mass, frame.rot.T @ (self.com - frame.pos), quaternion, moments)


def write_inertial(element: Any, mass: float, pos: Array, quaternion: Array, moments: Array) -> None:
    """Makes this the inertial frame of a body's specification, however the file had given it."""
    element.explicitinertial = True
    element.fullinertia = [np.nan, 0.0, 0.0, 0.0, 0.0, 0.0]
    element.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    missing = np.max((1.0 + _ROUNDED) * moments) - (np.sum(moments) - np.max(moments))
    thick = np.where(moments < np.max(moments), 0.5 * max(missing, 0.0), 0.0)  # a disc's file rounds to none
    element.mass, element.ipos, element.iquat, element.inertia = mass, pos, quaternion, moments + thick


def moved_parts(parts: Mapping[int, Inertial], body: Body, target: Inertial) -> dict[int, Inertial]:
    """The ``parts`` of ``body`` moved so that together they are ``target``."""
    T = _transport(_moments(body.inertia) / body.mass, _moments(target.inertia) / target.mass)
    density = target.mass / body.mass
    moved = {}
    for n, part in parts.items():
        S = density * T @ _moments(part.inertia) @ T.T
        inertia = np.trace(S) * np.eye(3) - S
        moved[n] = Inertial(density * part.mass, target.com + T @ (part.com - body.com), inertia)
    return moved


def _moments(inertia: Array) -> Array:
    """Second moments of mass of an inertia; its own inverse but for the trace."""
    return 0.5 * np.trace(inertia) * np.eye(3) - inertia


def _transport(before: Array, after: Array) -> Array:
    """Symmetric T with T before T^T = after."""
    if np.linalg.norm(after - before) <= _SAME * np.linalg.norm(before):
        return np.eye(3)
    root, inverse = _roots(before)
    middle, _ = _roots(root @ after @ root)
    flat = np.eye(3) - inverse @ root
    return inverse @ middle @ inverse + flat


def _roots(moments: Array) -> tuple[Array, Array]:
    """Square root of a positive semidefinite matrix, and the pseudo-inverse of that root."""
    values, axes = np.linalg.eigh(moments)
    values = np.sqrt(np.where(values > _FLAT * values.max(), values, 0.0))
    inverse = np.divide(1.0, values, out=np.zeros(3), where=values > 0)
    return axes * values @ axes.T, axes * inverse @ axes.T
