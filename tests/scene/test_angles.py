"""Ranges of hinges in the wrong unit are told."""

from __future__ import annotations

from pathlib import Path

import pytest

from cmbrl.scene import Scene
from cmbrl.scene.info.inventory import to_dict
from cmbrl.scene.info.report import describe


def arm(folder: Path, angle: str, *ranges: str) -> Scene:
    """Two hinges with these ranges, in a file whose angles are ``angle``."""
    links = [
        f'<body name="{name}" pos=".3 0 0"><joint name="{name}" axis="0 1 0" range="{limits}"/>'
        '<geom type="sphere" size=".05" mass="1"/></body>'
        for name, limits in zip(("shoulder", "elbow"), ranges, strict=True)
    ]
    file = folder / "arm.xml"
    file.write_text(
        f'<mujoco><compiler angle="{angle}" autolimits="true"/><worldbody>{"".join(links)}</worldbody></mujoco>'
    )
    return Scene.from_mjcf(file)


@pytest.mark.parametrize(
    ("angle", "ranges", "told"),
    [
        ("radian", ("-90 90", "-3.14 3.14"), "range of shoulder [-90, 90] rad is more than two turns"),
        ("degree", ("-3.14 3.14", "-1.57 0"), "all ranges of hinges are 6.3 degrees or less"),
        ("radian", ("-1.57 1.57", "-6.28 6.28"), None),
        ("degree", ("-180 180", "-2 2"), None),
    ],
)
def test_ranges_in_the_wrong_unit(tmp_path: Path, angle: str, ranges: tuple[str, str], told: str | None) -> None:
    scene = arm(tmp_path, angle, *ranges)
    found = to_dict(scene)["doubts"]
    assert len(found) == (told is not None)
    assert ("doubtful" in describe(scene)) is (told is not None)
    if told:
        assert told in found[0]
