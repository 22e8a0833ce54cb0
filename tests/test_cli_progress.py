"""Progress where no terminal shows a bar."""

from __future__ import annotations

import pytest

from cmbrl.cli import progress


def test_a_file_gets_a_line_a_minute(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """None for what is done sooner."""
    clock = iter([0.0, 59.0, 61.0, 90.0, 125.0])
    monkeypatch.setattr(progress, "monotonic", lambda: next(clock))
    with progress.fraction("fit robot") as show:
        for k in range(4):
            show(0.1 * k, f"part {k}")
    assert capsys.readouterr().err.splitlines() == ["fit robot: 10%, 61 s, part 1", "fit robot: 30%, 125 s, part 3"]
