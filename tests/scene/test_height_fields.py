"""Height fields with hills: where their heights come from, what touches them, and what `info` tells of them."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

from cmbrl.errors import UserError
from cmbrl.scene import Scene
from cmbrl.scene.collision.contact_records import ContactKind
from cmbrl.scene.collision.height_fields import MOST, read_field

HEIGHTS = np.array([[0.0, 51, 102, 153], [204, 255, 0, 51], [102, 153, 204, 255]]) / 255  # rows along y
ROBOT = """<mujoco><asset><hfield name="h" size="1.5 1 .4 .1" {source}/></asset><worldbody>
<geom name="field" type="hfield" hfield="h" pos=".1 0 -.2"/><body pos="0 0 1"><freejoint/>
<geom name="ball" size=".1"/><geom name="brick" type="box" size=".6 .1 .1" pos="0 0 .1"/></body>
<body name="far" pos="0 0 9"><joint axis="0 1 0"/><geom name="flag" size=".1"/></body></worldbody></mujoco>"""


def sources(folder: Path) -> dict[str, str]:
    """The same heights, as a file may give them."""
    levels = np.flipud(np.round(255 * HEIGHTS)).astype(np.uint8)  # the first row of a picture is the farthest
    Image.fromarray(levels, mode="L").save(folder / "hills.png")
    data = np.array(HEIGHTS.shape, dtype=np.int32).tobytes() + HEIGHTS.astype(np.float32).tobytes()
    (folder / "hills.bin").write_bytes(data)
    numbers = " ".join(f"{x:.9f}" for x in np.flipud(HEIGHTS).ravel())
    return {
        "elevation": f'nrow="3" ncol="4" elevation="{numbers}"',
        "png": 'file="hills.png"',
        "bin": 'file="hills.bin" content_type="image/vnd.mujoco.hfield"',
    }


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ('nrow="2" ncol="2" elevation="0 1 nan 0"', "hfield 'h': heights are not finite"),
        ('nrow="1" ncol="4" elevation="0 1 2 0"', "hfield 'h': 1 x 4 heights make no cell: give 2 x 2"),
    ],
)
def test_a_field_of_no_surface_is_refused(source: str, words: str) -> None:
    with pytest.raises(UserError, match=words):
        Scene.from_mjcf(ROBOT.format(source=source))


@pytest.mark.parametrize("kind", ["elevation", "png", "bin"])
def test_heights_are_those_of_the_file(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(ROBOT.format(source=sources(tmp_path)[kind]))
    model = mujoco.MjModel.from_xml_path(str(path))
    field = read_field(model, 0)
    np.testing.assert_allclose(field.heights, 0.4 * HEIGHTS, atol=1e-6)
    np.testing.assert_allclose(field.steps, [1.0, 1.0])
    for source in (path, model):  # a file, or what a program has compiled
        core = Scene.from_mjcf(source).core
        assert core.nfield == 1
        np.testing.assert_allclose(core.field_height, 0.4 * HEIGHTS.ravel() + 0.1, atol=1e-6)
        np.testing.assert_array_equal(core.field_size, [3, 4])


def test_what_may_touch_and_what_is_told(tmp_path: Path) -> None:
    scene = Scene.from_mjcf(ROBOT.format(source=sources(tmp_path)["elevation"]))
    assert {name for name in scene.contact_names if "field" in name} == {"ball - field", "brick - field"}
    on_field = ["field" in name for name in scene.contact_names]
    assert np.all(scene.core.con_type[on_field] == ContactKind.HULLS)
    assert scene.contact_names.count("ball - field") <= 2 * 2 * 2  # triangles that it can reach at once
    assert scene.contact_names.count("brick - field") <= MOST
    assert [drop.name for drop in scene.dropped_contacts] == ["flag - field"]
    told = [x for x in scene.differences if x.kind == "height field"]
    assert [x.name for x in told] == ["field", "boxes and meshes on field"]
    assert "1e+03 x 1e+03 mm" in told[0].why


def test_gaps_are_seen_near_the_surface(tmp_path: Path) -> None:
    scene = Scene.from_mjcf(ROBOT.format(source=sources(tmp_path)["elevation"]))
    balls = [name == "ball - field" for name in scene.contact_names]
    q = np.tile(scene.q0, (3, 1))
    q[:, :2] = -0.4, 1e-6  # on the hill in the second row and column, 0.4 - 0.2 m high
    q[:, 2] = 0.2 + 0.1 + np.array([0.02, -0.01, 3.0])
    gaps = scene.gaps(q)[:, balls].min(axis=1)
    np.testing.assert_allclose(gaps[:2], [0.02, -0.01], atol=1e-6)
    assert gaps[2] > 1.0
