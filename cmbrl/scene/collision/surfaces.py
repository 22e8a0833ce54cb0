"""The contact laws of pairs of geoms, one record for all pairs of the same surfaces: robots have thousands of pairs."""

from __future__ import annotations

import mujoco
import numpy as np

from cmbrl.scene.collision.contact_records import ContactLaw
from cmbrl.scene.collision.glide import with_moving_surfaces
from cmbrl.scene.collision.mixing import adhesive_bodies, contact_law, inverse_weight, pair_label
from cmbrl.scene.source.support import Gate

_SURFACE = (
    "geom_condim", "geom_priority", "geom_solmix", "geom_friction", "geom_solref", "geom_solimp", "geom_margin",
    "geom_gap", "geom_adhesion", "geom_surfacevel",
)  # fmt: skip


class Surfaces:
    """What each geom brings to a contact, and the laws of pairs of them."""

    def __init__(self, model: mujoco.MjModel, gate: Gate) -> None:
        self.model, self.gate = model, gate
        self._laws: dict[tuple[bytes, bytes], ContactLaw] = {}
        self._surfaces: dict[int, bytes] = {}
        self._moving = with_moving_surfaces(model)

    def law(self, a: int, b: int, pair: int) -> ContactLaw:
        """Of the geoms ``a`` and ``b`` in any order, with the number of their explicit pair or -1; tells the gate.

        Surfaces share their law unless there is something to report about each of their pairs.
        """
        if pair >= 0:
            return self._mixed(a, b, pair)
        first, second = sorted((a, b))
        key = self._surface(first), self._surface(second)
        if key not in self._laws:
            before = self.gate.reports
            law = self._mixed(a, b, pair)
            if self.gate.reports > before:
                return law
            self._laws[key] = law
        return self._laws[key]

    def _surface(self, geom: int) -> bytes:
        """All that a law takes from one of its geoms."""
        if geom not in self._surfaces:
            fields = [name for name in _SURFACE if hasattr(self.model, name)]
            numbers = [np.ravel(getattr(self.model, name)[geom]).astype(float) for name in fields]
            body = int(self.model.geom_bodyid[geom])
            own = [inverse_weight(self.model, body), float(body in adhesive_bodies(self.model))]
            self._surfaces[geom] = np.concatenate([*numbers, own]).tobytes()
        return self._surfaces[geom]

    def _mixed(self, a: int, b: int, pair: int) -> ContactLaw:
        model, label = self.model, pair_label(self.model, a, b)
        for field, kind, rows in (
            ("geom_adhesion", "adhesion", [a, b]),
            ("pair_adhesion", "adhesion", [pair] if pair >= 0 else []),
        ):
            values = getattr(model, field, None)  # fields of recent MuJoCo versions
            if values is not None and rows and np.any(np.asarray(values)[rows]):
                self.gate.refuse(kind, label, f"nonzero {field.split('_')[1]}")
        if self._moving[[a, b]].any():
            self.gate.drops("surface_velocity", label, "a surface that moves", "it stands")
        first, second = sorted((a, b))
        return contact_law(model, first, second, pair, self.gate)
