"""What can be fitted of a fluid: its density and its viscosity, with which all drag goes."""

from __future__ import annotations

import numpy as np

from cmbrl.scene.fittable.collector import Collector
from cmbrl.scene.forces.fluid import drags
from cmbrl.scene.layout import Layout
from cmbrl.scene.parts import Parts
from cmbrl.scene.records import Array

_TIMES, _LOAD = 5.0, 2.5  # as of masses
_MOST = 5.0  # [m/s^2] of drag at 1 m/s that may be meant by a fluid, be it air: rotors and ducts are no boxes


def offer_fluid(parts: Parts, layout: Layout, P: Array, out: Collector) -> None:
    """Density and viscosity, where the file has them. They are known no better than the boxes that they drag."""
    by_density, by_viscosity = drags(
        np.array([box.linear[3:] for box in parts.boxes]),
        np.array([box.quadratic[3:] for box in parts.boxes]),
        np.array([ellipsoid.coefficients for ellipsoid in parts.ellipsoids]),
    )
    mass = float(P[[layout.mass(k) for k in range(layout.nbody)]].sum())
    of = (("fluid_density", "kg/m^3", by_density), ("fluid_viscosity", "Pa s", by_viscosity))
    for k, (group, unit, drag) in enumerate(of):
        if (value := float(P[layout.fluid + k])) > 0.0:
            reach = max(_LOAD, float(np.log(_MOST * mass / (drag * value)) / np.log(_TIMES)) if drag > 0.0 else 0.0)
            out.add(group, "", value, value / _TIMES, value * _TIMES, unit, [layout.fluid + k], reach=reach)
