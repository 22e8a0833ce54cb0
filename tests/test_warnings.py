"""Warnings of the command line: one line each, and each once."""

from __future__ import annotations

import sys
import warnings

import pytest

from cmbrl.cli import main


def test_a_warning_is_shown_once_by_each_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def warn(_: object) -> None:
        for told in ("a log", "a log", "another"):
            warnings.warn(told, stacklevel=1)
            warnings.warn_explicit(told, UserWarning, "elsewhere.py", 1)

    monkeypatch.setattr(sys.modules["cmbrl.cli.main"], "_dispatch", warn)
    for _ in range(2):
        main(["info"])
        assert capsys.readouterr().err == "cmbrl: warning: a log\ncmbrl: warning: another\n"
