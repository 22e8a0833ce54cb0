"""Hulls of many vertices: the core climbs along their edges, and finds what looking at every vertex does."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.contact import Exact
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.collision import hull_graph
from cmbrl.scene.collision.hull_graph import HullGraph

from .test_hulls import OPTION, STATES, fallen
from .test_look_ahead import relative


def stone(rng: np.random.Generator, count: int) -> np.ndarray:
    """Vertices (n, 3) on an ellipsoid."""
    directions = rng.normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1)[:, None] * [0.05, 0.07, 0.06]


def drum(count: int) -> np.ndarray:
    """Vertices (n, 3) of a prism, also in the middle of its sides: whole sides are equally far along their normals."""
    turn = 2 * np.pi * np.arange(count) / count
    around = 0.06 * np.column_stack([np.cos(turn), np.sin(turn)])
    return np.concatenate([np.column_stack([around, np.full(count, z)]) for z in (-0.05, 0.0, 0.05)])


def pile() -> str:
    """Two stones and a drum above a table."""
    rng = np.random.default_rng(0)
    shapes = [stone(rng, 300), drum(60), stone(rng, 90)]
    meshes = "".join(
        f'<mesh name="{k}" vertex="{" ".join(f"{x:.5f}" for x in s.ravel())}"/>' for k, s in enumerate(shapes)
    )
    bodies = "".join(
        f'<body pos="{x} {y} {z}"><freejoint/><geom name="{k}" type="mesh" mesh="{k}" mass=".3"/></body>'
        for k, (x, y, z) in enumerate([(0, 0, 0.1), (0.03, 0.02, 0.25), (-0.14, 0, 0.08)])
    )
    option = OPTION.replace("implicitfast", "Euler")
    return f"""<mujoco>{option}<asset>{meshes}</asset>
<worldbody><geom type="box" size=".4 .4 .05" pos="0 0 -.05"/>{bodies}</worldbody></mujoco>"""


@pytest.mark.parametrize("points", [stone(np.random.default_rng(1), 500), drum(100)], ids=["stone", "drum"])
def test_what_has_no_higher_neighbour_is_the_farthest(points: np.ndarray) -> None:
    graph = HullGraph.of(points)
    assert graph is not None
    directions = np.concatenate([np.random.default_rng(2).normal(size=(200, 3)), np.eye(3), -np.eye(3)])
    heights = directions @ points.T
    degree = np.diff(graph.first)
    owner = np.repeat(np.arange(len(points)), degree)
    for along in heights:
        highest = np.full(len(points), -np.inf)
        np.maximum.at(highest, owner, along[graph.neighbours])
        ends = (along >= highest) & (degree > 0)
        assert ends.any()
        assert along[ends].min() > along.max() - 1e-12


def test_steps_are_those_of_looking_at_every_vertex(monkeypatch: pytest.MonkeyPatch) -> None:
    text = pile()
    q, v, expected = fallen(text)
    steps = []
    for many in (hull_graph._MANY, 10**6):
        monkeypatch.setattr(hull_graph, "_MANY", many)
        scene = Scene.from_mjcf(text)
        assert (scene.core.hull_graph >= 0).sum() == (3 if many < 100 else 0)
        model = ComplementarityModel(scene, sliding="convex", look_ahead=False, smoothing=Exact(1e-9))
        steps.append(model.predict(q, v, np.zeros((STATES, 0))).v_next)
    np.testing.assert_allclose(steps[0], steps[1], rtol=1e-6, atol=1e-7)
    assert np.median(relative(steps[0], expected, v)) < 1e-4


def test_few_vertices_and_flat_ones_have_no_graph() -> None:
    points = stone(np.random.default_rng(3), 500)
    assert HullGraph.of(points[: hull_graph._MANY - 1]) is None
    assert HullGraph.of(points * [1, 1, 0]) is None
