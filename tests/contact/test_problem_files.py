"""Files of contact problems: what comes back, and what is refused in one line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cmbrl.contact.problem import FIELDS, ContactProblem, load, save
from cmbrl.errors import UserError


def problem(name: str) -> ContactProblem:
    J, none = np.array([[[0.0, 1.0], [1.0, 0.0]]]), np.zeros((1, 2))
    return ContactProblem(2 * np.eye(2), J, np.array([1.0, -0.01]), none, np.array([0.4]), none, 1.0, name)


def test_a_file_gives_back_its_problems(tmp_path: Path) -> None:
    save([problem("one"), problem("two")], tmp_path / "problems.npz")
    back = load(tmp_path / "problems.npz")
    assert [p.name for p in back] == ["one", "two"]
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(back[1], field), getattr(problem("two"), field))


@pytest.mark.parametrize("content", [b"", b"junk", b"PK\x03\x04 cut short"])
def test_what_is_no_such_file_is_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "problems.npz"
    file.write_bytes(content)
    with pytest.raises(UserError, match=r"problems\.npz: not a file of contact problems") as caught:
        load(file)
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_another_archive_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such file"):
        load(tmp_path / "problems.npz")
    np.savez(tmp_path / "other.npz", q=np.zeros(3))
    with pytest.raises(UserError, match="not a file of contact problems"):
        load(tmp_path / "other.npz")


def test_a_problem_with_nan_is_named(tmp_path: Path) -> None:
    save([problem("one")], tmp_path / "problems.npz")
    with np.load(tmp_path / "problems.npz") as held:
        arrays = dict(held)
    arrays["0/M"] = np.full((2, 2), np.nan)
    np.savez(tmp_path / "problems.npz", **arrays)
    with pytest.raises(UserError, match="one: M is not finite"):
        load(tmp_path / "problems.npz")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"speed": 0.0}, "speed is 0; give a positive"),
        ({"speed": np.inf}, "speed is inf; give a positive"),
        ({"mu": np.array([-0.1])}, r"mu \(friction\) is negative"),
        ({"R": np.full((1, 2), -1.0)}, r"R \(compliance\) is negative"),
    ],
)
def test_the_wrong_field_is_named(change: dict, message: str) -> None:
    with pytest.raises(UserError, match=message):
        replace(problem("one"), **change)
