"""Objects that a robot pushes, seen by a capture of another rate: their clock, and several of them in one file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.data.importing import Options, import_logs
from cmbrl.data.importing.base import clock as base_clock
from cmbrl.data.importing.base.clock import Course, offset
from cmbrl.data.transitions import Transitions
from cmbrl.errors import UserError
from cmbrl.scene import Scene

DT, CAPTURE = 0.004, 0.01
SCENE = """<mujoco><worldbody><geom name="floor" type="plane" size="2 2 .1"/>
<body name="ram" pos="-.3 0 .06"><joint name="ram" type="slide" axis="1 0 0"/>
<geom type="box" size=".02 .08 .04"/></body>
<body name="lower" pos="0 0 .04"><freejoint name="lower"/><geom type="box" size=".05 .05 .04"/></body>
<body name="upper" pos="0 0 .11"><freejoint name="upper"/><geom type="box" size=".04 .04 .03"/></body>
</worldbody><actuator><position name="ram" joint="ram" kp="900"/></actuator></mujoco>"""


def moved(time: np.ndarray, parts: dict[float, float]) -> tuple[Course, Course]:
    """Velocities of two joints, and of an object that moves as they do, in ``parts`` of the time, each s later."""
    draw, mix = np.random.default_rng(5), np.random.default_rng(7).normal(size=(2, 6))

    def joints(at: np.ndarray) -> np.ndarray:
        return np.column_stack([np.sin(1.9 * at + np.sin(0.37 * at)), np.cos(2.6 * at + np.sin(0.53 * at))])

    turn, body, first = time % 2.0 / 2.0, np.zeros((len(time), 6)), 0.0
    for later, share in parts.items():
        now = (turn >= first) & (turn < first + share)
        body[now] = joints(time[now] - later) @ mix
        first += share
    return Course(time, joints(time)), Course(time, body + 0.1 * draw.normal(size=body.shape))


def test_pushes_that_resemble_each_other_do_not_tell_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    joints, body = moved(np.arange(0.0, 24.0, 0.02), {-3.5: 0.5, 2.5: 0.2})
    with pytest.raises(UserError, match=r"so neither is told: give it by --base-offset SECONDS \(0 if both have one"):
        offset(body, joints, joints, "capture.csv")
    monkeypatch.setattr(base_clock, "_HALF", 1.0)  # what was taken without a word
    assert offset(body, joints, joints, "capture.csv").sure


def test_an_object_that_is_held_for_most_of_the_log_tells_its_clock() -> None:
    joints, body = moved(np.arange(0.0, 24.0, 0.02), {0.321: 0.7})
    found = offset(body, joints, joints, "capture.csv")
    assert found.sure
    assert abs(found.seconds - 0.321) < 3.0 * found.error


def place_of(body: str, time: np.ndarray) -> np.ndarray:
    return {"lower": 0.1 * np.sin(time), "upper": 0.2 * np.cos(2.0 * time)}[body]


def written(folder: Path) -> Scene:
    """A ram at 250 Hz and two boxes at 100 Hz, with noise, as two files, and as one with empty fields."""
    (folder / "scene.xml").write_text(SCENE)
    draw, own, seen = np.random.default_rng(0), np.arange(0.0, 4.0, DT), np.arange(0.0, 4.0, CAPTURE)
    joints = {"time": own, "ram": 0.05 * np.sin(own), "ram_cmd": 0.05 * np.sin(own)}
    capture = {"time": seen}
    for body in ("lower", "upper"):
        turn = 1e-3 * draw.normal(size=(len(seen), 3))
        columns = [place_of(body, seen), 0 * seen, 0 * seen + 0.04, 0 * seen + 1.0, *turn.T]
        names = ("x", "y", "z", "qw", "qx", "qy", "qz")
        capture |= {f"{body}.{n}": c for n, c in zip(names, columns, strict=True)}
        capture[f"{body}.x"] = capture[f"{body}.x"] + 3e-4 * draw.normal(size=len(seen))
    for name, table in {"joints": joints, "capture": capture}.items():
        rows = np.column_stack(list(table.values()))
        np.savetxt(folder / f"{name}.csv", rows, delimiter=",", header=",".join(table), comments="", fmt="%.7g")
    both = [*joints, *list(capture)[1:]]
    rows = [dict(zip(t, row, strict=True)) for t in (joints, capture) for row in np.column_stack(list(t.values()))]
    rows.sort(key=lambda row: row["time"])
    lines = [",".join(f"{row[name]:.7g}" if name in row else "" for name in both) for row in rows]
    (folder / "both.csv").write_text("\n".join([",".join(both), *lines]) + "\n")
    return Scene.from_mjcf(folder / "scene.xml")


@pytest.mark.parametrize("files", [("joints.csv", "capture.csv"), ("both.csv",)])
def test_several_objects_of_one_capture_are_smoothed(tmp_path: Path, files: tuple[str, ...]) -> None:
    scene = written(tmp_path)
    poses = tuple(tmp_path / name for name in files[1:])
    options = Options(base=poses, base_offset=0.0 if poses else None)
    found = import_logs([tmp_path / files[0]], scene, options)
    log = found.log
    assert isinstance(log, Transitions)
    assert sum("poses every 0.01 s, smoothed" in note for note in found.notes) == 1
    assert not any("later than the joints'" in note for note in found.notes)
    time = DT * (2 + np.arange(len(log)))
    for k, body in enumerate(("lower", "upper")):
        off = log.q[:, 1 + 7 * k] - place_of(body, time)
        rate = log.v[:, 1 + 6 * k] - np.gradient(place_of(body, time), DT)
        assert off.std() < 2e-4, body  # the capture has 3e-4
        assert rate[5:-5].std() < 0.015, body  # differences of unsmoothed poses err by 0.04


def test_a_body_whose_pose_is_not_whole_is_named(tmp_path: Path) -> None:
    scene = written(tmp_path)
    with pytest.raises(UserError, match=r"no column for upper\.z"):
        import_logs(
            [tmp_path / "joints.csv"], scene,
            Options(base=(tmp_path / "capture.csv",), base_offset=0.0, columns={"upper.z": "-"}),
        )  # fmt: skip
