"""Columns of contact candidates: what loops over the candidates find, in scenes of many alike geoms."""

import numpy as np
import pytest

from cmbrl.scene import Scene
from cmbrl.scene.collision.candidate_table import CandidateTable, merge_points
from cmbrl.scene.collision.contact_records import Candidate, ContactKind, ContactLaw


def _law(friction: float) -> ContactLaw:
    return ContactLaw(3, friction, np.array([0.02, 1.0]), np.array([0.9, 0.95, 0.001, 0.5, 2.0]), 0.0, 1.0)


def _corner(geoms: tuple[int, int], place: np.ndarray, law: ContactLaw, weight: float = 1.0) -> Candidate:
    zero = np.zeros(3)
    kind = ContactKind.POINT_PLANE if geoms[1] == 0 else ContactKind.CORNER_BOX
    return Candidate(kind, geoms, 0, -1, place, zero, zero, zero, np.eye(3), zero, 0.25, 0.5, law, weight)


@pytest.fixture
def candidates() -> list[Candidate]:
    """Of four pairs of geoms, some at the same place."""
    rng = np.random.default_rng(0)
    places, laws = rng.normal(size=(5, 3)), [_law(0.5), _law(0.8)]
    geoms = [(3, 1), (1, 3), (2, 0), (5, 4)]
    drawn = rng.integers([4, 5, 2], size=(60, 3))
    return [_corner(geoms[a], places[b], laws[c], float(k + 1)) for k, (a, b, c) in enumerate(drawn)]


def test_columns_are_those_of_the_candidates(candidates: list[Candidate]) -> None:
    table = CandidateTable(candidates)
    np.testing.assert_array_equal(table.vectors("pos_a", (3,)), [c.pos_a for c in candidates])
    np.testing.assert_array_equal(table.of_laws("friction"), [c.law.friction for c in candidates])
    np.testing.assert_array_equal(table.of_laws("solimp"), [c.law.solimp for c in candidates])
    np.testing.assert_array_equal(table.on_plane, [c.kind.on_plane for c in candidates])
    pairs = list(dict.fromkeys(c.geoms for c in candidates))
    np.testing.assert_array_equal(table.pairs[0], pairs)
    np.testing.assert_array_equal(table.pairs[1], [pairs.index(c.geoms) for c in candidates])


def test_coinciding_points_of_a_pair_become_one(candidates: list[Candidate]) -> None:
    table, removed = merge_points(CandidateTable(candidates))
    merged = table.candidates
    places = {(c.geoms, *c.pos_a): 0.0 for c in candidates}
    for c in candidates:
        places[c.geoms, *c.pos_a] += c.weight
    assert [(c.geoms, *c.pos_a) for c in merged] == list(places)
    assert [c.weight for c in merged] == list(places.values())
    assert removed == len(candidates) - len(places)


def test_no_candidates() -> None:
    table = CandidateTable([])
    assert len(table) == 0
    assert table.vectors("rot_a", (3, 3)).shape == (0, 3, 3)
    assert table.pairs[0].shape == (0, 2)
    assert table.of_laws("dim").shape == (0,)
    assert merge_points(table) == (table, 0)


def test_a_scene_of_many_geoms_loads() -> None:
    """A kitchen: 300 boxes and cylinders that stand, 8 free bodies of 4 boxes each among them."""
    rng = np.random.default_rng(1)
    fixed = "".join(
        f'<geom type="{kind}" size=".1 .1 .1" pos="{x:.3f} {y:.3f} {z:.3f}"/>'
        for kind, (x, y, z) in zip(["box", "cylinder"] * 150, rng.uniform(-2, 2, (300, 3)), strict=True)
    )
    box = "".join(f'<geom type="box" size=".05 .05 .05" pos="{k / 10} 0 0"/>' for k in range(4))
    free = "".join(f'<body pos="0 0 {3 + k}"><freejoint/>{box}</body>' for k in range(8))
    scene = Scene.from_mjcf(f"<mujoco><worldbody>{fixed}{free}</worldbody></mujoco>")
    core = scene.core
    assert core.ncontact > 100_000
    assert len(scene.contact_names) == len(core.con_posA) == core.ncontact
    assert len({*scene.contact_names}) < core.ncontact / 4
