"""A full disk is one line that names the file and the remedy; nothing is half-written, and old files stay."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from cmbrl.errors import UserError
from cmbrl.files import FULL, atomic_path, remove_leftovers, write_record, writing

from .disk_writers import WRITERS, full, inputs, limited

NEEDS = {"record minari": "h5py", "play mp4": "imageio_ffmpeg", "export": "onnxscript", "bench": "sklearn"}
QUICK = ("record minari", "fit", "train")
SIZES = (10, 100, 1000, 3000, 10_000, 40_000)  # bytes; where not even 4 fit, Python finds no temporary folder


def _check(name: str, size: int, place: Path) -> bool:
    """Whether the disk was too small; asserts that then there is one line and nothing half-written."""
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    out = place / f"out_{name.replace(' ', '_')}_{size}"
    out.mkdir()
    ended = limited(WRITERS[name], out, size, place)
    left = [str(file) for file in out.rglob(".*tmp*")]
    assert not left
    if ended.returncode == 0:
        return False
    told = [line for line in ended.stderr.splitlines() if line.startswith("cmbrl: ") and "warning" not in line]
    assert ended.returncode == 2, ended.stderr
    assert len(told) == 1, ended.stderr
    assert "Traceback" not in ended.stderr
    assert "cannot be written" in told[0], told
    assert "choose another place" in told[0], told
    assert str(out) in told[0] or "scene.xml" in told[0], told  # a scene that bench makes in a temporary folder
    for file in out.rglob("*.json"):
        assert file.read_bytes().endswith((b"}\n", b"]\n")), file
    return True


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the commands read."""
    pytest.importorskip("gymnasium")
    found = tmp_path_factory.mktemp("disk")
    inputs(found)
    return found


@pytest.mark.parametrize("name", QUICK)
def test_a_full_disk_is_one_line(name: str, place: Path) -> None:
    assert _check(name, 1000, place)


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_a_disk_that_is_full_sooner_or_later(name: str, place: Path) -> None:
    assert any([_check(name, size, place) for size in SIZES])


@pytest.mark.parametrize("number", sorted(FULL))
def test_what_the_disk_refuses_is_a_user_error(number: int, tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")
    told = r"a: cannot be written .* free space there, or choose another place"
    with pytest.raises(UserError, match=told), atomic_path(tmp_path / "a") as temporary:
        temporary.write_text("half")
        raise OSError(number, "full")
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("a", "old")]
    with pytest.raises(UserError, match="choose another place"), writing(tmp_path):
        raise OSError("encoder error")


def test_a_folder_that_cannot_be_made_is_a_user_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "mkdir", full)
    with pytest.raises(UserError, match="cannot be written"):
        write_record(tmp_path / "new" / "a.json", {})


def test_files_that_belong_together_change_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A policy's two files: where the second does not fit on the disk, the first stays as it was."""
    import torch

    from cmbrl.train.policies.file import load_policy, save_policy
    from cmbrl.train.policies.policy import Architecture, Policy

    policy = Policy(Architecture(3, 2, (4,)))
    save_policy(policy, tmp_path, {"task": "a"})
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    with torch.no_grad():
        policy.net[0].weight.add_(1.0)
    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(UserError, match="cannot be written"):
        save_policy(policy, tmp_path, {"task": "a"})
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before
    assert load_policy(tmp_path).task == "a"


def test_what_a_killed_process_left_is_removed(tmp_path: Path) -> None:
    ended = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    import os

    dead, alive = tmp_path / f".fit.{ended.stdout.strip()}.tmp.json", tmp_path / f".fit.{os.getpid()}.tmp.json"
    kept = [alive, tmp_path / ".notes.tmp", tmp_path / "fit.json"]
    for file in (dead, *kept):
        file.write_text("{}")
    remove_leftovers(tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted(kept)


def test_output_that_goes_to_a_full_disk_is_one_line() -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    with open("/dev/full", "w") as device:
        ended = subprocess.run(
            [sys.executable, "-m", "cmbrl", "info", "hopper"], stdout=device, stderr=subprocess.PIPE, text=True
        )
    assert ended.returncode == 2
    assert ended.stderr.count("\n") == 1
    assert "standard output: cannot be written" in ended.stderr
