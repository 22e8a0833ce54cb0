"""Pictures with and without a graphics driver: what is in view, and what a driver that does not start leads to."""

from __future__ import annotations

import subprocess

import mujoco
import numpy as np
import pytest

from cmbrl import UserError
from cmbrl.envs import renderer
from cmbrl.envs.drawing import Drawer
from cmbrl.envs.renderer import choose_renderer
from cmbrl.envs.side_view import GROUND, SKY

SCENE = """
<mujoco>
  <worldbody>
    <geom type="plane" size="5 5 1" pos="0 0 -2"/>
    <body>
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
      <geom type="sphere" size="0.4"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def scene(tmp_path, monkeypatch) -> str:
    """A ball over a plane, without a camera; no graphics."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    (tmp_path / "scene.xml").write_text(SCENE)
    return str(tmp_path / "scene.xml")


def test_all_that_was_seen_is_in_view(scene):
    places = [np.array([x, z]) for x in (-3.0, 9.0) for z in (0.0, 1.0)]
    drawer = Drawer(scene, 120, 40, places)
    shown = []
    for q in places:
        picture = drawer.draw(q).astype(int)
        assert picture.shape == (40, 120, 3)
        ball = (np.abs(picture - SKY).sum(axis=2) > 150) & (np.abs(picture - GROUND).sum(axis=2) > 60)
        rows, columns = np.nonzero(ball[:30])  # the marks on the ground are below
        assert columns.min() > 0
        assert columns.max() < 119
        assert rows.min() > 0
        shown.append((columns.mean(), rows.mean()))
    (left, low), (_, high), (right, _), _ = shown
    assert right - left > 70, "as large as it may be"
    assert low - high > 4, "upwards is up"


def test_a_body_of_which_nothing_would_be_drawn_shows_what_collides(tmp_path):
    hidden = '<body>{}<geom type="sphere" size="0.1" group="3"/></body>'
    looks = '<geom type="box" size="0.1 0.1 0.1" group="2"/>'
    path = tmp_path / "groups.xml"
    path.write_text(f"<mujoco><worldbody>{hidden.format('')}{hidden.format(looks)}</worldbody></mujoco>")
    assert Drawer(str(path), 40, 30).model.geom_group.tolist() == [0, 2, 3]


def test_without_a_driver_pictures_are_flat_and_a_broken_one_is_told(scene, monkeypatch):
    flat = Drawer(scene, 60, 40).draw(np.zeros(2))

    def broken(*arguments):
        raise RuntimeError("no driver")

    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setattr(mujoco, "Renderer", broken)
    with pytest.warns(UserWarning, match="drawn flat.*no driver.*apt-get install"):
        again = Drawer(scene, 60, 40)
    assert np.array_equal(again.draw(np.zeros(2)), flat)


def test_the_driver_is_chosen_by_trying(scene, monkeypatch):
    """The second that is tried draws; none does; the one that is named does not."""
    tried = []

    def attempt(command, env, **_):
        tried.append(env["MUJOCO_GL"])
        return subprocess.CompletedProcess(command, 0 if env["MUJOCO_GL"] == works else 1)

    monkeypatch.setattr(renderer.subprocess, "run", attempt)
    environment: dict[str, str] = {}
    monkeypatch.setattr(renderer.os, "environ", environment)
    works = "osmesa"
    choose_renderer()
    assert tried == ["egl", "osmesa"]
    assert environment == {"MUJOCO_GL": "osmesa"}
    works = ""
    with pytest.raises(UserError, match="MUJOCO_GL=osmesa does not draw here: unset it"):
        choose_renderer()
    environment.clear()
    with pytest.warns(UserWarning, match="drawn flat.*apt-get install libegl1"):
        choose_renderer()
    assert not environment
