from __future__ import annotations

import hashlib
import json
import re
import shutil
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from feel321.analysis.page import render_template
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.cli import main
from feel321.study.folder import StudyFolder
from feel321.study.monitor import blind
from feel321.study.monitor.blind import HIDDEN, StudyWatch, list_names
from feel321.study.monitor.live import Monitor
from feel321.study.session import journal as journals
from feel321.study.session.plan import PLAN_FILE, require_plan

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

STATION = Path(__file__).with_name("station.py")
NOON = datetime(2026, 1, 1, 12, tzinfo=UTC)
GUARDED = """
import os, sys
def guard(event, given):
    if event == "open" and isinstance(given[0], (str, bytes)) and os.fsdecode(given[0]).startswith({path!r}):
        if given[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_TRUNC):
            print("WRITES", given, file=sys.stderr, flush=True)
    if event in {{"os.remove", "os.rename", "os.mkdir", "os.truncate", "os.utime"}}:
        print("CHANGES", event, given, file=sys.stderr, flush=True)
sys.addaudithook(guard)
from feel321.study.cli import main
sys.exit(main(["monitor", {path!r}]))
"""
"""Runs the verb in a process that says whenever it opens a file of the study for anything but reading."""


@pytest.fixture(scope="module")
def study(made: Path, tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    own = tmp_path_factory.mktemp("monitor") / "lab one"
    return StudyFolder(Path(shutil.copytree(made, own)))


def fetch(address: str, *, method: str = "GET", host: str = "") -> tuple[int, str]:
    request = urllib.request.Request(address, method=method, headers={"Host": host} if host else {})  # noqa: S310 - our own server
    try:
        with urllib.request.urlopen(request, timeout=30) as answer:  # noqa: S310 - our own server
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def find_state(address: str) -> dict[str, Any]:
    code, text = fetch(address.replace("/?", "/state.json?"))
    assert code == 200
    people = json.loads(text)["studies"][0]["participants"]
    return next((one for one in people if one["participant"] == "p01"), {})


def wait_until(find: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 300
    while not find():
        assert time.monotonic() < end_s
        time.sleep(0.05)


def digest(folder: Path) -> dict[str, tuple[int, str]]:
    return {
        str(path): (
            path.stat().st_mtime_ns,
            hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "",
        )
        for path in sorted(folder.rglob("*"))
    }


@dataclass
class Watching:
    """The server's process and address, and the process of a session that runs beside it."""

    study: StudyFolder
    server: subprocess.Popen[str]
    session: subprocess.Popen[str]
    address: str


@pytest.fixture(scope="module")
def watching(study: StudyFolder) -> Iterator[Watching]:
    session = subprocess.Popen(
        [sys.executable, STATION, str(study.path), "p01", "3", "0.1"], text=True
    )
    guarded = GUARDED.format(path=str(study.path))
    server = subprocess.Popen(
        [sys.executable, "-c", guarded], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert server.stdout is not None
    try:
        yield Watching(study, server, session, server.stdout.readline().strip())
    finally:
        for process in (session, server):
            process.kill()
            process.wait()
        server.stdout.close()


def test_a_session_is_watched_from_outside_until_it_is_killed(watching: Watching) -> None:
    address, journal = watching.address, watching.study.sessions / "p01" / "session-01.jsonl"
    wait_until(lambda: find_state(address).get("done", 0) >= 1)
    seen = find_state(address)
    assert (seen["state"], seen["underruns"], seen["total"]) == ("running", 1, 10)
    assert 0 < seen["left_min"] < 10
    assert seen["step"].startswith("realism") or seen["step"].startswith("page")
    watching.session.send_signal(signal.SIGKILL)
    watching.session.wait()
    assert find_state(address)["state"] == "aborted"
    # Nothing is written from here on, whatever is asked and however often.
    with journal.open("ab") as file:
        file.write(b'{"sequence": 9')
    before = digest(watching.study.path)
    pages = [fetch(address)[1] for _ in range(3)]
    assert (
        find_state(address)["flags"][0] == "14 bytes of an unfinished line, moved aside on resuming"
    )
    assert digest(watching.study.path) == before
    names = list_names(read_stimuli(watching.study.stimuli), None)
    assert len(names) > 8
    for text in (*pages, fetch(address.replace("/?", "/state.json?"))[1]):
        assert not re.search(rf"\b({'|'.join(map(re.escape, names))})\b", text)
    assert '<noscript><meta http-equiv="refresh"' in pages[0]
    lines = journal.read_bytes().split(b"\n")
    lines[4] = lines[4].replace(b'"event"', b'"evil"')
    journal.write_bytes(b"\n".join(lines))
    seen = find_state(address)
    told = "session-01.jsonl, line 5, cannot be read; run feel321 audit"
    assert (seen["state"], seen["problem"]) == ("unreadable", told)
    assert told in fetch(address)[1]


def test_who_has_no_token_or_comes_from_elsewhere_is_refused(watching: Watching) -> None:
    address = watching.address
    bare = address.partition("?")[0]
    port = re.search(r":(\d+)/", address)[1]
    assert address.startswith("http://127.0.0.1:")
    assert fetch(address)[0] == fetch(address, host=f"localhost:{port}")[0] == 200
    for refused in (
        bare, f"{bare}?token=", f"{address}x", f"{bare}nothing", f"{bare}state.json", f"{bare}state.json/",
    ):  # fmt: skip
        assert fetch(refused)[0] == 403
    for host in (f"lab.example:{port}", "127.0.0.1", f"127.0.0.1.nip.io:{port}"):
        assert fetch(address, host=host)[0] == 403
    for method in ("POST", "PUT", "DELETE", "PATCH", "OPTIONS"):
        assert fetch(address, method=method)[0] == 403


@pytest.mark.parametrize("host", ["lab.example", "192.168.1.5", "::"])
def test_only_this_machine_is_answered(
    study: StudyFolder, host: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["monitor", str(study.path), "--host", host]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "no other machine reaches" in told


def test_ctrl_c_ends_it_cleanly_and_it_wrote_nothing(watching: Watching) -> None:
    """The last one: it ends the server that the others ask."""
    watching.server.send_signal(signal.SIGINT)
    _, told = watching.server.communicate(timeout=120)
    assert (watching.server.returncode, told) == (0, "monitor: ended\n")


# Blindness, as a law: whatever is rated, the same is shown.


def rewrite(path: Path, change: Callable[[str, dict[str, Any]], None]) -> None:
    """Write a journal anew, as it would be had other things happened."""
    tip, lines = journals.START, []
    for record in journals.read_journal(path).records:
        data = json.loads(json.dumps(dict(record.data)))
        change(record.event, data)
        lines.append(journals.write_line(replace(record, data=data), tip))
        tip = journals.digest(lines[-1].rstrip(b"\n"))
    path.write_bytes(b"".join(lines))


def write_everything(study: StudyFolder) -> tuple[str, str]:
    monitor = Monitor([StudyWatch(study, lambda: NOON)], lambda: NOON)
    return monitor.write_page("nonce", {})[1], monitor.write_state("nonce", {})[1]


def test_other_ratings_show_the_same(copied: StudyFolder) -> None:
    before, changed = write_everything(copied), 0
    for folder in copied.participants:
        plan = require_plan(folder / PLAN_FILE)
        free = {trial.number for trial in plan.trials if trial.phase == "main" and not trial.catch}

        def change(event: str, data: dict[str, Any], free: set[int] = free) -> None:
            nonlocal changed
            if event == "rated" and data["trial"] in free:
                data["values"] = {key: 100 - value for key, value in data["values"].items()}
                changed += 1

        for path in journals.list_journals(folder):
            rewrite(path, change)
    assert changed == 8  # of two participants
    assert write_everything(copied) == before


def test_names_of_conditions_are_hidden_in_notes_and_reasons(copied: StudyFolder) -> None:
    journal = journals.require_journal(
        copied.sessions / "sim001" / "session-01.jsonl", now=lambda: NOON
    )
    journal.write("note", {"text": "the MAG321 of bumps at as is felt odd; bumpy all the same"})
    journal.write("note", {"text": "Sax-321, sax 321, mag_3 21, as-is, hard-taps; magnet 321"})
    settings = copied.settings.read_text(encoding="utf-8")
    copied.settings.write_text(f'{settings}\n[[recordings]]\nscene = "bumps"\nname = "hard_taps"\n')
    told = f"the {HIDDEN} of {HIDDEN} at {HIDDEN} felt odd; bumpy all the same"
    ways = f"{HIDDEN}, {HIDDEN}, mag_3 21, {HIDDEN}, {HIDDEN}; magnet 321"
    for text in write_everything(copied):
        assert told in text
        assert ways in text
    assert "hidden as a whole" not in write_everything(copied)[0]
    for damage in (
        "stimulus_id\n",
        None,
    ):  # without its names nothing written in free words is shown
        copied.manifest.write_text(damage) if damage else copied.manifest.unlink()
        page, state = write_everything(copied)
        assert "felt odd" not in page + state
        assert "magnet" not in page + state
        assert HIDDEN in page
        assert "hidden as a whole" in page


def test_unchanged_files_are_read_once_and_a_participant_may_be_called_anything(
    copied: StudyFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads: list[Path] = []
    read = blind.read_settings
    monkeypatch.setattr(blind, "read_settings", lambda path: reads.append(path) or read(path))
    monitor = Monitor([StudyWatch(copied, lambda: NOON)], lambda: NOON)
    study = monitor.look()["studies"][0]
    study["live"] = study["participants"] = [study["participants"][0] | {"participant": "counts"}]
    page = render_template("monitor.html", nonce="", clock="", quiet_s=9.0, studies=[study])
    parts = re.findall(r'data-part="([^"]+)"', page)
    assert len(parts) == len(set(parts)) == 4
    copied.settings.write_text(
        copied.settings.read_text(encoding="utf-8").replace("Pilot", "Renamed"), encoding="utf-8"
    )
    assert [monitor.look()["studies"][0]["name"] for _ in range(3)] == ["Renamed"] * 3
    assert len(reads) == 2


@pytest.mark.soak
def test_a_page_of_several_studies_fits_a_phone(copied: StudyFolder, tmp_path: Path) -> None:
    browser = shutil.which("chromium") or pytest.skip(
        "PAGE NOT RENDERED: chromium is not installed"
    )
    (copied.sessions / "sim002" / PLAN_FILE).write_text("{}", encoding="utf-8")
    watches = [
        StudyWatch(copied, lambda: NOON),
        StudyWatch(replace(copied, is_rehearsal=True), lambda: NOON),
    ]
    page = Monitor(watches, lambda: NOON).write_page("nonce", {})[1]
    assert page.count("<section") == 2
    probe = "document.title = document.documentElement.scrollWidth + ' of ' + innerWidth"
    text = page.replace("</body>", f"<script>{probe}</script></body>")
    (tmp_path / "page.html").write_text(text, encoding="utf-8")
    command = [
        browser, "--headless", "--no-sandbox", "--disable-gpu", "--window-size=500,900", "--no-first-run",
        f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", (tmp_path / "page.html").as_uri(),
    ]  # fmt: skip
    shown = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout
    wide, window = map(int, re.search(r"<title>(\d+) of (\d+)</title>", shown).groups())
    assert wide <= window
