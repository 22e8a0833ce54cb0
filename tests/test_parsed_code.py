"""What modules say is remembered, and nothing that is remembered wrongly is believed."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest

from cmbrl.parsed_code import Memory, Parsed

TEXT = b'"""Words."""\nimport cmbrl.errors\nfrom cmbrl import files\nimport numpy\n\nNAME = "cmbrl.fitting.fit:fit"\n'


def _by_another_process(memory: Memory, text: bytes, monkeypatch: pytest.MonkeyPatch) -> Parsed:
    """What one that cannot parse says, once ``memory`` has read it."""
    memory.of(text)
    memory.keep()
    with monkeypatch.context() as only:
        only.setattr("cmbrl.parsed_code._parsed", None)
        return Memory(memory.file).of(text)


def test_a_text_that_is_remembered_says_what_it_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    memory = Memory(tmp_path / "__pycache__" / "memory.json.gz")
    first = memory.of(TEXT)
    assert first.imports == ("cmbrl.errors", "cmbrl", "cmbrl.files")
    assert first.strings == ("cmbrl.fitting.fit",)
    assert _by_another_process(memory, TEXT, monkeypatch) == first
    assert memory.of(TEXT.replace(b"Words", b"Others")) == first  # no other code, but another text


CUT = gzip.compress(b"{}")[:-9]
DAMAGED = [b"", CUT, CUT[:12] + b"??????", *map(gzip.compress, (b"{", b"[]", b'{"key": 3}', b'{"key": ["a"]}'))]


@pytest.mark.parametrize("damage", DAMAGED, ids=range(len(DAMAGED)))
def test_a_damaged_memory_is_made_anew(damage: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "memory.json.gz"
    file.write_bytes(damage)
    memory = Memory(file)
    assert _by_another_process(memory, TEXT, monkeypatch) == memory.of(TEXT)


def test_it_does_not_grow_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cmbrl.parsed_code._MOST", 2)
    memory = Memory(tmp_path / "memory.json.gz")
    for k in range(3):
        memory.of(f"x = {k}".encode())
        memory.keep()
        assert memory.file.exists() == (k < 2)


def test_a_place_that_cannot_be_written_is_no_matter(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    memory = Memory(tmp_path / "file" / "memory.json.gz")
    memory.of(TEXT)
    memory.keep()
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]
