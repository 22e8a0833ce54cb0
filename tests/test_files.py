"""Files are whole or absent, and a place that cannot be written is found out before work starts."""

from __future__ import annotations

import math
import os
from pathlib import Path

import pytest

from cmbrl.errors import UserError, did_you_mean
from cmbrl.files import atomic_path, check_writable, read_json, write_json, write_text
from cmbrl.reading import regular_file


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "log.npz"
    write_text(target, "old")
    with pytest.raises(RuntimeError, match="halfway"), atomic_path(target) as temporary:
        temporary.write_text("half", encoding="utf-8")
        raise RuntimeError("halfway")
    assert target.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_parents_are_made_and_the_suffix_is_kept(tmp_path: Path) -> None:
    target = tmp_path / "a" / "b" / "plot.png"
    with atomic_path(target) as temporary:
        assert temporary.suffix == ".png"
        assert temporary.parent == target.parent
        temporary.write_bytes(b"x")
    assert target.read_bytes() == b"x"


def test_a_folder_is_renamed_or_removed_as_a_whole(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), atomic_path(tmp_path / "run") as temporary:
        temporary.mkdir()
        (temporary / "part").write_text("x", encoding="utf-8")
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    write_text(tmp_path / "file", "x")
    with pytest.raises(UserError, match="cannot be written"):
        check_writable(tmp_path / "file" / "log.npz")
    with pytest.raises(UserError, match="is a folder"):
        check_writable(tmp_path)
    with pytest.raises(UserError, match="is a file"):
        check_writable(tmp_path / "file", folder=True)
    check_writable(tmp_path / "new" / "log.npz")
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]  # asking writes nothing
    (tmp_path / "link").symlink_to(tmp_path / "absent")
    with pytest.raises(UserError, match=r"link: links to .*absent, which is not there"):
        check_writable(tmp_path / "link" / "log.npz")


def test_a_file_that_may_not_be_read_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_text(tmp_path / "log.npz", "x")
    monkeypatch.setattr("os.access", lambda path, mode: mode != os.R_OK)  # whoever runs the tests may read it
    with pytest.raises(UserError, match=r"log\.npz: cannot be read \(Permission denied\); check its permissions"):
        regular_file(tmp_path / "log.npz")


def test_json_is_read_back_and_a_bad_file_is_named(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"x": [1, 2.5, None]})
    assert read_json(tmp_path / "a.json") == {"x": [1, 2.5, None]}
    write_text(tmp_path / "b.json", "{")
    with pytest.raises(UserError, match=r"b\.json.*JSON"):
        read_json(tmp_path / "b.json")
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "c.json", math.nan)
    assert not (tmp_path / "c.json").exists()


def test_an_unknown_name_brings_the_nearest() -> None:
    assert did_you_mean("hoper", ["hopper", "cheetah"]) == "did you mean 'hopper'?"
    assert did_you_mean("zzz", ["hopper", "cheetah"]) == "known: cheetah, hopper"
    assert did_you_mean("zzz", map(str, range(100))).endswith(" and 60 more")
    assert "\n" not in str(UserError("two\nlines"))
