"""Progress where no terminal shows a bar."""

from __future__ import annotations

from time import sleep

import pytest

from cmbrl.cli import progress


class Clock:
    """Seconds, as a test sets them."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(progress, "monotonic", clock)
    return clock


def test_lines_tell_what_is_new_ever_more_rarely(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    """None of what is done sooner; a stage that began before its line was due has it when it is."""
    lines = progress.Lines("fit robot")
    shown = {0.5: "reading", 1.9: "checking", 8.0: "part 1", 9.0: "part 2", 100.0: "part 3", 110.0: "part 4"}
    for k in range(1, 2000):
        clock.now = k / 10
        if clock.now in shown:
            lines.show(clock.now / 200, shown[clock.now])
        lines.tell()
    told = [line.split(", ", 1)[1] for line in capsys.readouterr().err.splitlines()]
    later = "73 s, part 2", "100 s, part 3", "125 s, part 4", "185 s, part 4"
    assert told == ["2 s, checking", "8 s, part 1", "13 s, part 2", *later]


@pytest.mark.parametrize(("times", "lines"), [((61.0, 62.0), 2), ((1.0, 1.5), 0)])
def test_the_end_of_a_long_work_is_told_at_once(
    times: tuple[float, float], lines: int, clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    """What follows may take minutes, such as the trials of a policy; of short work nothing is told."""
    teller = progress.Lines("train robot")
    for clock.now, done, text in zip(times, (0.99, 1.0), ("return 3", "trials of the policy"), strict=True):
        teller.show(done, text)
    told = capsys.readouterr().err.splitlines()
    assert len(told) == lines
    assert all("100%, 62 s, trials" in line for line in told[1:])


def test_what_runs_is_told_without_another_word(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "FIRST", 0.0)
    with progress.fraction("fit robot") as show:
        show(0.0, "checking")
        monkeypatch.setattr(progress, "OFTEN", 0.5)
        show(0.1, "the first part")
        sleep(1.2)
    assert [line.split(", ")[-1] for line in capsys.readouterr().err.splitlines()] == ["checking", "the first part"]
