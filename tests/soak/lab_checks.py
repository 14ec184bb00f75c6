"""What must hold after a day in the lab, and the table of what happened."""

from __future__ import annotations

import csv
import json
import signal
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.study.folder import StudyFolder
from feel321.study.session.journal import list_journals, read_journal
from feel321.study.session.plan import TOMBSTONE_FILE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lab_day import Day

MOST_GROWTH = {
    "session": 10.0,
    "monitor": 4.0,
    "monitor, nobody there": 1.0,
    "server": 2.0,
    "cable": 2.0,
}
"""MiB that a process may grow in the day; the live page besides keeps the records of all journals in memory."""

MARKS = ("resumed", "device_failed", "clock_stepped", "aborted", "warm_up")
"""Events that a day must leave in some journal, or nothing happened."""


def read_rated(folder: Path) -> tuple[Counter[str], Counter[int]]:
    """Read the answers in a participant's journals; and of each main trial, how many were accepted."""
    plan = {one["number"]: one for one in json.loads((folder / "plan.json").read_text())["trials"]}
    rated, accepted = Counter[str](), Counter[int]()
    for path in list_journals(folder):
        for record in read_journal(path).records:
            if record.event == "rated":
                told = record.data
                key = json.dumps([told["trial"], told["attempt"], told["values"]], sort_keys=True)
                rated[key] += 1
                is_main = plan[told["trial"]]["phase"] == "main"
                accepted[told["trial"]] += is_main and not told["rejected"]
    wanted = {number for number, one in plan.items() if one["phase"] == "main"}
    return rated, Counter({number: accepted[number] for number in wanted})


def count_answers(day: Day, place: Path) -> tuple[int, int, int, int]:
    """Count acknowledged answers, those found, lost and double ones, in one folder of sessions."""
    acknowledged = found = lost = doubled = 0
    for path in sorted(day.control.glob("acks-*")):
        folder = place / path.name.removeprefix("acks-")
        if not folder.exists() or (folder / TOMBSTONE_FILE).exists():
            continue
        lines = [json.loads(line) for line in path.read_text().splitlines()]
        seen = Counter(json.dumps(line, sort_keys=True) for line in lines)
        rated, accepted = read_rated(folder)
        acknowledged += seen.total()
        found += (seen & rated).total()
        lost += (seen - rated).total()
        lost += sum(n == 0 for n in accepted.values())
        doubled += sum(n > 1 for n in accepted.values())
    return acknowledged, found, lost, doubled


def find_growth(points: list[tuple[float, float, int]]) -> tuple[float, float, float, int, int]:
    """Start, end and slope (MiB per lab hour) of the memory, and open files at start and end."""
    hours, sizes, files = (np.array(one) for one in zip(*points, strict=True))
    first = len(hours) // 10
    early, late, later = slice(first, first + 5), slice(-5, None), slice(first, None)
    slope = np.polyfit(hours[later], sizes[later], 1)[0]
    return (
        float(np.median(sizes[early])), float(np.median(sizes[late])), float(slope),
        int(np.median(files[early])), int(np.median(files[late])),
    )  # fmt: skip


def find_processes(day: Day) -> Iterator[tuple[str, tuple[float, float, float, int, int], float]]:
    """The long-lived processes: those seen at least 20 times."""
    for name, points in sorted(day.samples.items()):
        watched_h = points[-1][0] - points[0][0]
        if len(points) >= 20:
            yield name, find_growth(points), watched_h


def count_marks(day: Day) -> Counter[str]:
    """Count the records of what went wrong, in the office's journals."""
    marks = Counter[str]()
    for path in StudyFolder(day.root / "office").journals:
        marks.update(record.event for record in read_journal(path).records)
    found = Counter({event: marks[event] for event in MARKS})
    if missing := [event for event in MARKS if not found[event]]:
        day.faults.append(f"no journal knows of {missing}: the day did not reach the sessions")
    return found


def collect(day: Day) -> None:
    """Collect both stations, killed once on the way; then again, which copies nothing."""
    office = day.root / "office"
    words = ["collect", *(str(one.folder) for one in day.stations), "--into", str(office), "--json"]
    first = (
        day.start(None, Path(day.stations[0].folder).parent / "feel321", *words) if False else None
    )
    del first
    from lab_day import FEEL321

    killed = day.start(None, FEEL321, *words)
    time.sleep(1.2)
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    day.events["SIGKILL to collect"] += 1
    for repeat in ("collect", "collect again"):
        done = day.call(None, *words)
        if done.returncode:
            day.faults.append(f"{repeat}: {done.stdout}{done.stderr}")
            return
        if repeat == "collect again" and json.loads(done.stdout)["files"]:
            day.faults.append(f"{repeat} copied something: {done.stdout}")


def list_leftovers(day: Day) -> list[str]:
    """Temporary files that the day left behind."""
    places = [*(one.folder for one in day.stations), day.root / "office", day.root / "tmp"]
    return [
        str(path.relative_to(day.root))
        for place in places
        for path in place.rglob("*")
        if path.name.endswith((".part", ".tmp")) or path.name.startswith(("feel321-", "tmp"))
    ]


def check_office(day: Day) -> dict[str, Any]:
    """Audit everywhere, analyze the collected study, and compare its tables with its journals."""
    office = StudyFolder(day.root / "office")
    for station in (*day.stations, None):
        folder = station.folder if station else office.path
        done = day.call(station, "audit", folder)
        if done.returncode:
            day.faults.append(f"audit {folder.name}: {done.stdout}{done.stderr}")
    done = day.call(None, "analyze", office.path)
    if done.returncode:
        day.faults.append(f"analyze: {done.stderr}")
    with (office.path / "ratings.csv").open(newline="") as file:
        kept = [row for row in csv.DictReader(file) if row["rejected"] == "false"]
    trials = sum(
        read_rated(folder)[1].total()
        for folder in office.participants
        if (folder / "plan.json").exists()
    )
    if len(kept) != trials:
        day.faults.append(f"ratings.csv holds {len(kept)} accepted rows, the journals {trials}")
    size = sum(path.stat().st_size for path in (office.path / "stimuli").rglob("*.wav"))
    with (office.path / "stimuli" / "manifest.csv").open(newline="") as file:
        listed = {row["file"]: int(row["n_samples"]) for row in csv.DictReader(file)}
    return {"rows": len(kept), "wav bytes": size, "wav listed": len(listed)}


def check_withdrawn(day: Day) -> None:
    """Nothing of whoever withdrew is left but the tombstone and the ledger's line."""
    places = [*(one.folder for one in day.stations), day.root / "office"]
    graves = [one for place in places for one in place.glob(f"sessions/*/{TOMBSTONE_FILE}")]
    if len(graves) != 2:
        day.faults.append(f"{len(graves)} tombstones, of one person at a station and in the office")
    for grave in graves:
        left = {path.name for path in grave.parent.iterdir()} - {TOMBSTONE_FILE}
        if [name for name in left if "lock" not in name]:
            day.faults.append(f"{grave.parent} still holds {sorted(left)}")


def check(day: Day) -> bool:
    """Check everything and print the table."""
    passed_h = day.hour
    collect(day)
    told = check_office(day)
    check_withdrawn(day)
    leftovers = list_leftovers(day)
    print(f"\n{passed_h:.1f} lab hours, {day.speed:g} times as fast, {len(day.finished)} people\n")
    print("events injected:", ", ".join(f"{n} {name}" for name, n in sorted(day.events.items())))
    print("sessions' processes ended:", dict(sorted(day.ends.items())))
    for name, place in (
        *((one.name, one.folder / "sessions") for one in day.stations),
        ("office", day.root / "office" / "sessions"),
    ):
        acknowledged, found, lost, doubled = count_answers(day, place)
        print(f"{name:8} acknowledged {acknowledged}, found {found}, lost {lost}, twice {doubled}")
        if lost or doubled or found != acknowledged or not acknowledged:
            day.faults.append(f"{name}: {lost} lost, {doubled} twice")
    print("journals:", dict(count_marks(day)))
    print("analyzed:", told)
    print(f"{'process':24} {'h':>5} {'MiB':>7} {'MiB':>7} {'MiB/h':>7} {'files':>6} {'files':>6}")
    for name, (start, end, slope, opened, still), watched_h in find_processes(day):
        print(
            f"{name:24} {watched_h:5.2f} {start:7.1f} {end:7.1f} {slope:7.2f} {opened:6} {still:6}"
        )
        most = MOST_GROWTH["session" if "session" in name else name]
        if name == "monitor":
            journals = StudyFolder(day.root / "office").journals
            most += 4 * sum(path.stat().st_size for path in journals) / 2**20
        if end - start > most or still > opened + 8:
            day.faults.append(
                f"{name} grows: {start:.1f} to {end:.1f} MiB, {opened} to {still} files"
            )
    print("left behind:", leftovers or "nothing")
    for line in day.said:
        print("said:", line.strip()[:300])
    for fault in day.faults:
        print("FAULT:", fault.strip()[:2000])
    return not day.faults
