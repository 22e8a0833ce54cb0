"""Many bodies: memory follows what touches, and pairs that are far apart are left out, no other ones."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

RADIUS = 0.05

STEPS = """
import resource, sys
import numpy as np
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 if sys.platform == "linux" else 1024**2)

before = peak()
scene = Scene.from_mjcf(sys.argv[1])
model = ComplementarityModel(scene)
q, v = scene.q0[None], np.random.default_rng(0).normal(size=(1, scene.nv)) * 0.3
for _ in range(3):
    result = model.predict(q, v, np.zeros((1, 0)))
    q, v = result.q_next, result.v_next
    assert result.status[0] == 0
assert q[0, 2::7].min() > 0.045
print(peak() - before)
"""


def spheres(file: Path, places: np.ndarray, ground: bool = True) -> Path:
    """Writes a scene of free spheres at ``places`` (n, 3)."""
    bodies = "".join(
        f'<body pos="{x} {y} {z}"><freejoint/><geom size="{RADIUS}" mass="0.5"/></body>' for x, y, z in places
    )
    plane = '<geom type="plane" size="50 50 1"/>' if ground else ""
    file.write_text(f"<mujoco><worldbody>{plane}{bodies}</worldbody></mujoco>")
    return file


@pytest.mark.parametrize(("count", "megabytes"), [(300, 200), pytest.param(1000, 1024, marks=pytest.mark.slow)])
def test_free_spheres_on_a_plane_step_within_memory(tmp_path: Path, count: int, megabytes: float) -> None:
    side = int(np.ceil(np.sqrt(count)))
    rows, columns = np.divmod(np.arange(count), side)
    places = np.column_stack([2.2 * RADIUS * columns, 2.2 * RADIUS * rows, np.full(count, RADIUS - 1e-4)])
    file = spheres(tmp_path / "spheres.xml", places)
    ran = subprocess.run([sys.executable, "-P", "-c", STEPS, str(file)], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    assert float(ran.stdout) < megabytes


@pytest.mark.parametrize("count", [4, 40])
def test_pairs_that_are_passed_over_change_nothing(tmp_path: Path, count: int) -> None:
    """Few bodies are compared pair by pair, many along an axis; both keep each row that matters."""
    rng = np.random.default_rng(0)
    places = rng.uniform(0, 0.2 * count ** (1 / 3), size=(count, 3))
    scene = Scene.from_mjcf(spheres(tmp_path / "cloud.xml", places, ground=False))
    model = ComplementarityModel(scene, time_step=0.02)
    q = scene.integrate(np.tile(scene.q0, (16, 1)), rng.normal(size=(16, scene.nv)) * 0.1)
    v = rng.normal(size=(16, scene.nv)) * rng.choice([0.3, 10.0], size=(16, 1))
    u = np.zeros((16, 0))
    wider = scene.parameter_vector()
    wider[[p.group == "radius" for p in scene.parameters]] = 0.02
    for theta in (scene.parameter_vector(), wider):
        whole = model.with_settings(prune=np.inf)
        ours, all_rows = model.predict(q, v, u, theta), whole.predict(q, v, u, theta)
        assert not ours.status.any()
        np.testing.assert_allclose(ours.v_next, all_rows.v_next, rtol=0, atol=1e-7)
        active = model.stepper.core.rows(q, v, u, theta, model.stepper.options)["active"]
        assert 0 < active.mean() < 1
