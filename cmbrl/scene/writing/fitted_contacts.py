"""Writes what is fitted of contacts into the specification of an MJCF: friction, softness, radii."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.collision.contact_meaning import softened
from cmbrl.scene.collision.mixing import Mixed, collision_pairs, mixed, pair_label
from cmbrl.scene.records import Array
from cmbrl.scene.scene import Scene
from cmbrl.scene.source.mjcf import name_of

_ROUND = (int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_CAPSULE))  # the first size is the radius


@dataclass(frozen=True)
class FittedContacts:
    """``spec`` and ``model`` of the scene's file, to be changed from the scene's P to ``P`` (nP,).

    ``softness`` (ncontact,) is the factor on the softness of each contact, ``radii`` what to add to radii by geom.
    """

    scene: Scene
    spec: mujoco.MjSpec
    model: mujoco.MjModel
    P: Array
    softness: Array
    radii: dict[str, float]

    @cached_property
    def change(self) -> Array:
        """What is added to the nominal vector (nP,)."""
        return self.P - self.scene.core.P

    def _contacts(self) -> None:
        """Friction, softness, radii of boxes and meshes, as explicit pairs: geoms would mix theirs with others'."""
        scene, layout = self.scene, self.scene.layout
        fields = [
            layout.contact(0, f) - layout.contact(0)
            for f in ("friction", "spin", "roll", "solref0", "solref1", "d0", "dmax", "width")
        ]
        rows = {name: k for k, name in reversed([*enumerate(scene.contact_names)])}
        for first, second, pair in collision_pairs(self.model) if rows else ():
            labels = pair_label(self.model, first, second), pair_label(self.model, second, first)
            row = next((rows[label] for label in labels if label in rows), None)
            if row is None:
                continue
            values, wider = self.P[layout.contact(row) + np.array(fields)], self._wider(first, second)
            same = np.array_equal(values, scene.core.P[layout.contact(row) + np.array(fields)])
            if same and self.softness[row] == 1 and not wider:
                continue
            law = mixed(self.model, first, second, pair)
            friction, solref, solimp = law.friction, law.solref, law.solimp
            friction[:2] = values[0]
            for place, coefficient in ((slice(2, 3), values[1]), (slice(3, 5), values[2])):
                friction[place] = coefficient or friction[place]  # 0 where the contact has none
            if scene.contact_law == "mujoco":
                solref[:], solimp[:3] = softened(*[*values[3:].tolist(), float(self.softness[row])])
            element = self._element("pairs", pair) if pair >= 0 else self._add_pair(first, second, law)
            element.friction, element.solref, element.solimp = friction, solref, solimp
            element.margin += wider

    def _wider(self, first: int, second: int) -> float:
        """How far from each other two geoms touch: the radii of those that have none in a file."""
        return sum(self._radius(geom) for geom in (first, second) if int(self.model.geom_type[geom]) not in _ROUND)

    def _add_pair(self, first: int, second: int, law: Mixed) -> Any:
        names = []
        for geom in (first, second):
            element = self._element("geoms", geom)
            element.name = element.name or name_of(self.model, "geom", geom)
            names.append(element.name)
        return self.spec.add_pair(
            geomname1=names[0], geomname2=names[1], condim=law.dim, margin=law.margin, gap=law.gap
        )

    def _radii(self) -> bool:
        """Radii of spheres and capsules; others have margins. Returns whether one has changed."""
        changed = False
        for geom in range(self.model.ngeom):
            if self._radius(geom) and int(self.model.geom_type[geom]) in _ROUND:
                self._element("geoms", geom).size[0] += self._radius(geom)
                changed = True
        return changed

    def _radius(self, geom: int) -> float:
        """What is added to that of a geom [m]."""
        return self.radii.get(name_of(self.model, "geom", geom), 0.0)

    def _element(self, kind: str, number: int) -> Any:
        return self._elements[kind][number]

    @cached_property
    def _elements(self) -> dict[str, dict[int, Any]]:
        """Elements of the specification by kind and number in the compiled model."""
        kinds = ("bodies", "joints", "geoms", "tendons", "actuators", "pairs")
        return {kind: {element.id: element for element in getattr(self.spec, kind)} for kind in kinds}
