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


@pytest.mark.parametrize(("times", "lines"), [([0.0, 61.0, 62.0], 2), ([0.0, 30.0, 31.0], 0)])
def test_the_end_of_a_long_work_is_told_at_once(
    times: list[float], lines: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What follows may take minutes, such as the trials of a policy; of short work nothing is told."""
    clock = iter(times)
    monkeypatch.setattr(progress, "monotonic", lambda: next(clock))
    with progress.fraction("train robot") as show:
        show(0.99, "return 3")
        show(1.0, "trials of the policy in the model")
    told = capsys.readouterr().err.splitlines()
    assert len(told) == lines
    assert all("100%, 62 s, trials" in line for line in told[1:])
