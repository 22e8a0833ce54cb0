"""Motions from files: what is read, how it is resampled, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.errors import UserError
from cmbrl.imitation.motion import Motion
from cmbrl.imitation.reading import read_motion
from cmbrl.registry import load_task
from cmbrl.scene import Scene

DT = 0.02


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_task("g1").load_scene()


@pytest.fixture(scope="module")
def frames(scene: Scene) -> np.ndarray:
    """A walk of joints and a turn of the root, at 30 frames a second, 2 s."""
    t = np.arange(61) / 30
    dv = np.zeros((61, scene.nv))
    dv[:, 0], dv[:, 5], dv[:, 6:] = 0.5 * t, 0.8 * t, 0.2 * np.sin(2 * t)[:, None]
    return scene.integrate(np.tile(scene.q0, (61, 1)), dv)


def write_csv(path: Path, q: np.ndarray) -> Path:
    np.savetxt(path, np.concatenate([q[:, :3], q[:, 4:7], q[:, 3:4], q[:, 7:]], axis=1), delimiter=",")
    return path


def test_csv_and_npz_are_the_same_motion(scene: Scene, frames: np.ndarray, tmp_path: Path) -> None:
    csv = read_motion(write_csv(tmp_path / "a.csv", frames), scene, DT)
    order = np.random.default_rng(0).permutation(scene.nu)
    names = np.array(scene.joint_names[1:])
    shuffled = np.concatenate([frames[:, :7], frames[:, 7:][:, order]], axis=1)
    np.savez(tmp_path / "a.npz", q=shuffled, rate=30.0, joint_names=names[order])
    npz = read_motion(tmp_path / "a.npz", scene, DT)
    assert csv.q.shape == (101, scene.nq)
    assert csv.duration == pytest.approx(2.0)
    np.testing.assert_allclose(csv.q, npz.q, atol=1e-12)
    np.testing.assert_allclose(csv.v, npz.v, atol=1e-9)


def test_resampled_between_frames_at_constant_speed(scene: Scene, frames: np.ndarray) -> None:
    motion = Motion.of_frames(scene, frames, 30.0, DT, "frames")
    np.testing.assert_allclose(motion.q[0], frames[0])
    np.testing.assert_allclose(motion.q[50], frames[30], atol=1e-9)
    np.testing.assert_allclose(motion.v[:, 0], 0.5, atol=1e-9)
    np.testing.assert_allclose(motion.v[:, 5], 0.8, atol=1e-9)  # the root turns about the vertical
    t = np.arange(len(motion.q)) * DT
    np.testing.assert_allclose(motion.v[1:-1, 6], 0.4 * np.cos(2 * t[1:-1]), atol=0.02)
    np.testing.assert_allclose(np.linalg.norm(motion.q[:, 3:7], axis=1), 1, atol=1e-12)


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda q: q[:10], "0.3 s of motion"),
        (lambda q: q[:, :-1], "35 columns.*another robot"),
        (lambda q: np.where(np.arange(36) == 20, np.nan, q), "row 1, column 21 is nan"),
        (lambda q: q - np.eye(36)[2], "under the floor"),
        (lambda q: q * np.where((np.arange(36) > 2) & (np.arange(36) < 7), 2, 1), "length 2, not 1"),
    ],
)
def test_what_is_no_motion_is_refused(scene: Scene, frames: np.ndarray, tmp_path: Path, spoil, told) -> None:  # type: ignore[no-untyped-def]
    np.savez(tmp_path / "a.npz", q=spoil(frames), rate=30.0)
    with pytest.raises(UserError, match=told) as caught:
        read_motion(tmp_path / "a.npz", scene, DT)
    assert str(tmp_path / "a.npz") in str(caught.value)


def test_files_that_are_no_motions(scene: Scene, frames: np.ndarray, tmp_path: Path) -> None:
    (tmp_path / "words.csv").write_text("a,b\n1,2\n")
    (tmp_path / "broken.npz").write_bytes(b"PK")
    np.savez(tmp_path / "rate.npz", q=frames)
    np.savez(tmp_path / "names.npz", q=frames, rate=30.0, joint_names=["a"] * 29)
    (tmp_path / "motion.txt").touch()
    (tmp_path / "empty.csv").touch()
    np.savez(tmp_path / "slow.npz", q=frames, rate=1e-6)
    np.savez(tmp_path / "rates.npz", q=frames, rate=[30.0, 30.0])
    np.savez(tmp_path / "deep.npz", q=frames[None], rate=30.0)
    np.savez(tmp_path / "far.npz", q=1e9 * frames, rate=30.0)
    np.savez(tmp_path / "no_names.npz", q=frames, rate=30.0, joint_names="a")
    np.savez(tmp_path / "none.npz", q=frames[:0], rate=30.0)
    for name, told in {
        "words.csv": "not a table", "broken.npz": "not readable as npz", "rate.npz": "'rate'", "names.npz": "no joint",
        "motion.txt": "are .csv or .npz", "empty.csv": "no frames", "slow.npz": "s of motion", "rates.npz": "'rate'",
        "deep.npz": "'q'", "far.npz": "column 3 is", "no_names.npz": "no joint", "none.npz": "no frames",
        "missing.csv": "missing.csv",
    }.items():  # fmt: skip
        with pytest.raises(UserError, match=told):
            read_motion(tmp_path / name, scene, DT)


def test_a_number_that_is_none_is_named_by_its_place_in_the_file(
    scene: Scene, frames: np.ndarray, tmp_path: Path
) -> None:
    table = np.loadtxt(write_csv(tmp_path / "a.csv", frames), delimiter=",")
    table[5, 3] = np.nan  # of the quaternion, whose numbers stand in another order than the model's
    np.savetxt(tmp_path / "a.csv", table, delimiter=",")
    with pytest.raises(UserError, match="row 6, column 4 is nan"):
        read_motion(tmp_path / "a.csv", scene, DT)
    q = frames.copy()
    q[5, 20] = np.inf
    np.savez(tmp_path / "a.npz", q=q, rate=30.0)
    with pytest.raises(UserError, match="row 6, column 21 is inf"):
        read_motion(tmp_path / "a.npz", scene, DT)
