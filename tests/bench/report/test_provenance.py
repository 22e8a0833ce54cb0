"""A result names its code, and is called stale when that code has changed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from cmbrl import code_digest
from cmbrl.bench import provenance, stored
from cmbrl.bench.report.runs import run_studies
from cmbrl.bench.study import Section, Settings
from cmbrl.cli import main
from cmbrl.files import read_record, write_record
from cmbrl.jobs import Job, Runner

from .conftest import no_bar

QUICK = Settings(quick=True)


def states(*places: Path) -> dict[str, str]:
    return {Path(row[0]).name: row[2] for row in stored.results(places).rows}


def test_results_say_what_made_them(tmp_path: Path) -> None:
    Runner(tmp_path / "jobs").run([Job("digest", code_digest.code_digest, {"module": "cmbrl.errors"})])
    section = Section("Title", "Text", made=provenance.made("cmbrl.errors", 3))
    section.write(tmp_path / "study")
    text = section.terminal()
    assert "from 3 seeds on" in " ".join(text.split())
    (tmp_path / "study.txt").write_text(text)
    (tmp_path / "wrapped.txt").write_text("\n".join(provenance.line(section.made).split()))
    (tmp_path / "other.txt").write_text("no result")
    (tmp_path / "old.txt").write_text("Made by cmbrl 0.1.0 (commit daa32bc) from 3 seeds on a machine; numpy 2.")
    (tmp_path / "other.json").write_text(json.dumps({"key": 3}))
    assert states(tmp_path) == {
        "digest.json": stored.CURRENT,
        "section.json": stored.CURRENT,
        "study.txt": stored.CURRENT,
        "wrapped.txt": stored.CURRENT,
        "old.txt": stored.UNKNOWN,
    }
    changed = replace(section, made={**section.made, "code": "0" * 16})
    changed.write(tmp_path / "study")
    (tmp_path / "study.txt").write_text(changed.terminal())
    assert states(tmp_path / "study", tmp_path / "study.txt") == {
        "section.json": stored.CHANGED,
        "study.txt": stored.CHANGED,
    }


def test_the_digest_sees_code_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def digest(text: str) -> str:
        (tmp_path / "a_study.py").write_text(text)
        code_digest._read.cache_clear()
        code_digest.code_digest.cache_clear()
        return code_digest.code_digest("a_study")

    monkeypatch.syspath_prepend(tmp_path)
    first = digest("def f(x):\n    return x + 1\n")
    assert digest('"""Words."""\n\n\ndef f(x):  # a comment\n    """More."""\n    return x + 1\n') == digest(
        '"""Other words."""\n\n\ndef f(x):\n    """Others."""\n\n    return x + 1\n'
    )
    assert digest("def f(x):\n    return x + 2\n") != first
    one = digest("from cmbrl.errors import UserError\n")
    two = digest("if TYPE_CHECKING:\n    from cmbrl.fitting import fit\n")
    assert "cmbrl.errors" in code_digest._closure("cmbrl.files")
    assert "cmbrl.train.shac" in code_digest._closure("cmbrl.cli.train")  # named in a string
    assert "cmbrl.tasks.hopper.mdp" in code_digest._closure("cmbrl.registry")
    assert "cmbrl.contact.solvers.admm" in code_digest._closure("cmbrl.contact.solvers.registry")  # by its package
    assert "cmbrl.fitting.fit" in code_digest._closure("cmbrl.cli.fit")
    assert "cmbrl.fitting.fit" not in code_digest._closure("cmbrl.scene.scene")
    assert one != two


def test_remarks_in_the_core_do_not_count() -> None:
    def kept(text: str) -> str:
        return code_digest._NATIVE_REMARKS.sub(" ", text).strip()

    assert kept("T x = 1;  // why\n\n  T y;\n") == kept("T x = 1;\n// Why else.\nT y;") != kept("T x = 2;\nT y;")


def test_a_finished_study_runs_again_when_its_code_has_changed(fakes: dict[str, str], tmp_path: Path) -> None:
    good = {"good": fakes["good"]}
    run_studies(good, tmp_path, QUICK, no_bar)
    record = tmp_path / "good/run.json"
    held = read_record(record, "")
    write_record(record, {**held, "code": "other"})
    run_studies(good, tmp_path, replace(QUICK, accept="any"), no_bar)
    assert (tmp_path / "good/calls").read_text() == "1"
    assert run_studies(good, tmp_path, QUICK, no_bar)[0].code == held["code"]
    assert (tmp_path / "good/calls").read_text() == "11"
    interrupted = {**read_record(record, ""), "seconds": None}
    write_record(record, interrupted)
    resumed = run_studies(good, tmp_path, QUICK, no_bar)[0]
    assert resumed.environments[0] == interrupted["environments"][0]  # where it was begun
    assert len(resumed.environments) == 2


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["bench", "stale"]) == 0
    assert "No result here" in capsys.readouterr().out
    assert main(["bench", "stale", "nowhere"]) == 2
    assert main(["bench", "speed", "docs"]) == 2
    capsys.readouterr()
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/old.txt").write_text("Made by cmbrl 0.1.0 (no checkout) from 1 seed on a machine.")
    assert main(["bench", "stale", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["state"] == stored.UNKNOWN
