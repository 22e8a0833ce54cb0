"""One contact, as small as it gets: a point mass above the ground, through the same core as every robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cmbrl.contact.smoothing import Smoothing
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

Array = NDArray[np.float64]
MASS, H, GRAVITY = 2.0, 1e-2, 9.81
F = 1 / MASS  #: the Delassus matrix of the one contact [1/kg]

POINT = """<mujoco><option gravity="0 0 -{gravity}"/><worldbody>
<geom name="ground" type="plane" size="9 9 1" friction="{mu}"/>
<body name="b"><joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
<joint name="z" type="slide" axis="0 0 1"/>
<geom name="b" size=".1" mass="2" pos="0 0 .1" friction="{mu}"/></body></worldbody>
<actuator><motor joint="x"/></actuator></mujoco>"""


@dataclass(frozen=True)
class ScalarLaw:
    """The normal impulse of one step as a function of the free closing speed z = gap/h + v_free [m/s]."""

    model: ComplementarityModel

    def __call__(self, z: Array) -> tuple[Array, Array]:
        """Impulse (n,) [N s] and its slope d impulse / d z (n,) [kg], from the velocity and its Jacobian."""
        q, v, u = np.zeros((len(z), 3)), np.zeros((len(z), 3)), np.zeros((len(z), 1))
        v[:, 2] = z + GRAVITY * H
        r = self.model.predict(q, v, u, jacobian=True)
        assert r.status.max() == 0
        impulse = self.model.predict(q, v, u, impulse=True).impulse
        return impulse[:, 0, 0], MASS * (r.jacobian[:, 5, 5] - 1)


@pytest.fixture
def point(tmp_path: Path) -> Callable[..., ComplementarityModel]:
    """``point(smoothing, mu=0, h=H)``: the model of the point mass, products solved to 1e-12 of kappa."""

    def build(smoothing: Smoothing, mu: float = 0.0, h: float = H, substeps: int = 1) -> ComplementarityModel:
        file = tmp_path / "point.xml"
        file.write_text(POINT.format(gravity=GRAVITY, mu=mu), encoding="utf-8")
        scene = Scene.from_mjcf(file, contact_law="rigid")
        return ComplementarityModel(
            scene, substeps, h, smoothing, integrator="semi-implicit", prune=np.inf, path_tolerance=1e-12
        )

    return build


@pytest.fixture
def law(point: Callable[..., ComplementarityModel]) -> Callable[[Smoothing], ScalarLaw]:
    """``law(smoothing)``: the scalar law under a smoothing."""
    return lambda smoothing: ScalarLaw(point(smoothing))
