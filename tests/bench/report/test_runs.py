"""A run of several studies: what fails stops no other, what is finished stays, what was begun otherwise is refused."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from html.parser import HTMLParser
from pathlib import Path

import pytest

from cmbrl import UserError
from cmbrl.bench.report.page import write_page
from cmbrl.bench.report.runs import StudyRun, run_studies, summary
from cmbrl.bench.study import Section, Settings
from cmbrl.cli import main
from cmbrl.files import read_json, read_record, write_json, write_record

from .conftest import no_bar

QUICK = Settings(quick=True)


@pytest.fixture
def runs(fakes: dict[str, str], tmp_path: Path) -> list[StudyRun]:
    return run_studies(fakes, tmp_path / "out", QUICK, no_bar)


def test_each_ends_in_its_own_way(runs: list[StudyRun], tmp_path: Path) -> None:
    good, raising, dying, refusing = runs
    assert [run.status for run in runs] == ["finished", "failed", "failed", "failed"]
    section = Section.read(tmp_path / "out/good")
    assert section.tables[0].rows[3] == ["none", None, "inf", "fail: 3 of 5"]
    assert section.values == {"x": "nan"}
    assert (tmp_path / "out/good/table_0.csv").read_text().splitlines()[2] == "a,0.1,1,fail"
    assert "noise of a C library" in (tmp_path / "out/good/output.txt").read_text()
    assert raising.error == "ZeroDivisionError: no <such> number"
    assert "raising_study.py" in raising.details
    assert "SIGSEGV" in str(dying.error)
    assert "last words" in dying.details
    assert (refusing.error, refusing.details) == ("solver missing: pip install it", "")
    assert good.seconds is not None
    assert "SIGSEGV" in summary(runs)


def test_goes_on_where_it_was_killed(runs: list[StudyRun], fakes: dict[str, str], tmp_path: Path) -> None:
    again = run_studies(fakes, tmp_path / "out", QUICK, no_bar)
    assert again[0] == runs[0]  # not run again
    assert again[1].environment["started"] >= runs[1].environment["started"]
    assert (tmp_path / "out/good/calls").read_text() == "1"  # one call, with one thread for BLAS
    record = tmp_path / "out/good/run.json"
    write_record(record, read_record(record, "") | {"seconds": None})  # as a killed run leaves it
    assert "interrupted" in write_page(tmp_path / "out").read_text()
    assert run_studies({"good": fakes["good"]}, tmp_path / "out", QUICK, no_bar)[0].status == "finished"
    assert (tmp_path / "out/good/calls").read_text() == "11"


def test_a_section_of_another_run_is_refused(fakes: dict[str, str], tmp_path: Path) -> None:
    for seed in (0, 1):
        run_studies({"good": fakes["good"]}, tmp_path / str(seed), Settings(quick=True, seed=seed), no_bar)
    section = tmp_path / "0/good/section.json"
    write_json(section, read_json(section) | {"title": "of another run"})
    for use in (write_page, lambda out: run_studies({"good": fakes["good"]}, out, QUICK, no_bar)):
        with pytest.raises(UserError, match=r"section\.json: missing, damaged or of another run"):
            use(tmp_path / "0")
    assert write_page(tmp_path / "1").exists()


def test_other_settings_are_refused_before_anything_runs(fakes: dict[str, str], tmp_path: Path) -> None:
    run_studies({"good": fakes["good"]}, tmp_path, QUICK, no_bar)
    with pytest.raises(UserError, match=r"good: was begun with other options \(seed\)"):
        run_studies(fakes, tmp_path, Settings(quick=True, seed=1), no_bar)
    assert not (tmp_path / "raising").exists()


def test_progress_comes_through(fakes: dict[str, str], tmp_path: Path) -> None:
    seen: list[tuple[float, str]] = []

    @contextmanager
    def bar(name: str):
        yield lambda share, text: seen.append((share, text))

    run_studies({"good": fakes["good"]}, tmp_path, QUICK, bar)
    assert seen[0] == (0.0, "picture 0")


class Page(HTMLParser):
    """What stands in a page: its tags with their attributes, and which are still open at the end."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "link", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def test_page_is_self_contained_and_accessible(runs: list[StudyRun], tmp_path: Path) -> None:
    text = write_page(tmp_path / "out").read_text(encoding="utf-8")
    page = Page(text)
    assert page.open == []
    assert [image["alt"] for image in page.all("img")] == ["Curve 0", "Curve 1", "Curve 2"]
    links = [a.get(key) or "" for _, a in page.tags for key in ("src", "href") if key in a]
    assert all(link.startswith(("data:", "#")) for link in links)
    targets = {a["id"] for _, a in page.tags if "id" in a}
    assert {link[1:] for link in links if link.startswith("#")} <= targets
    assert "no &lt;such&gt; number" in text
    assert "An &lt;i&gt;escaped&lt;/i&gt; caption." in text
    assert "<p>Second.</p>" in text
    assert text.count("solver missing: pip install it") == 1


def test_command(fakes: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["bench", "all", "--out", str(out)]) == 1
    said = capsys.readouterr()
    assert [line.split()[:2] for line in said.out.splitlines()] == [
        ["good", "finished"], ["raising", "failed"], ["dying", "failed"], ["refusing", "failed"]
    ]  # fmt: skip
    assert "report.html" in said.err
    assert main(["bench", "good", "--json", "--scene", "hopper"]) == 0
    assert json.loads(capsys.readouterr().out)["good"]["title"] == "Good <study>"
    assert main(["bench", "refusing"]) == 2
    assert capsys.readouterr().err == "cmbrl: solver missing: pip install it\n"
    assert main(["bench", "raising"]) == 1
    assert 'raise ZeroDivisionError("no <such> number")' in capsys.readouterr().err
    assert main(["bench", "all"]) == 2
    with pytest.raises(SystemExit):
        main(["bench", "--help"])
    assert "a study whose process dies" in capsys.readouterr().out


@pytest.mark.slow
def test_ctrl_c_is_one_line_and_goes_on(command, tmp_path: Path) -> None:
    typed = ["bench", "robustness", "--quick", "--scene", "hopper", "--out", "out"]
    running = subprocess.Popen([sys.executable, "-m", "cmbrl", *typed], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    while not (tmp_path / "out/robustness/output.txt").exists():  # the study's own process has started
        assert running.poll() is None, running.communicate()
        time.sleep(0.02)
    running.send_signal(signal.SIGINT)  # to the command alone; it has to end the study's process
    assert running.communicate(timeout=60)[1] == "cmbrl: interrupted\n"
    assert running.returncode == 130
    assert StudyRun.read(tmp_path / "out/robustness").status == "interrupted"
    done = command(*typed)
    assert done.returncode == 0, done.stderr
    assert StudyRun.read(tmp_path / "out/robustness").status == "finished"


def test_a_killed_command_leaves_no_process_behind(tmp_path: Path) -> None:
    code = (
        "import pathlib, sys; from cmbrl.bench.report.runs import run_studies; from cmbrl.bench.study import Settings;"
        "from contextlib import nullcontext; sys.path.insert(0, '.');"
        "run_studies({'slow': 'slow_study'}, pathlib.Path('out'), Settings(), lambda name: nullcontext(print))"
    )
    slow = """
import os, time
from cmbrl.bench.study import Study
def run(folder, settings, progress):
    (folder / "pid").write_text(str(os.getpid()))
    time.sleep(60)
STUDY = Study("slow", "a study that takes its time", run)
"""
    (tmp_path / "slow_study.py").write_text(slow, encoding="utf-8")
    running = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path)
    pid = tmp_path / "out/slow/pid"
    while not (pid.exists() and pid.read_text()):
        assert running.poll() is None
        time.sleep(0.02)
    running.kill()
    running.wait()
    end = time.monotonic() + 20
    while _lives(int(pid.read_text())):
        assert time.monotonic() < end
        time.sleep(0.05)


def _lives(pid: int) -> bool:
    state = Path(f"/proc/{pid}/stat")
    try:
        return state.read_text().rpartition(")")[2].split()[0] != "Z"  # an orphan may wait for a reaper
    except OSError:
        return False
