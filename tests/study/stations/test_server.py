"""Ledgers that several stations share, on a real server and on a file."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import time
import warnings
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from feel321.protocols.trial import place_in_groups
from feel321.study import cli
from feel321.study import server as servers
from feel321.study.auditing.study import audit_study
from feel321.study.collect import collect_sessions
from feel321.study.ledger import database, slots, stations
from feel321.study.persons.withdrawal import release_participant, take_note, withdraw_participant
from feel321.study.server import Server, check_url, find_server, name_schema
from feel321.study.settings.read import read_settings
from feel321.study.simulation import simulate_study
from feel321.study.status import read_status

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.study.folder import StudyFolder


def tell_time() -> datetime:
    return datetime.now(UTC)


def race(place: str, folder: Path, *, count: int, thinking_s: float) -> list[int]:
    """Let eight processes claim at once, each thinking between reading and writing; returns the numbers given."""
    context = multiprocessing.get_context("fork")
    start, read = context.Barrier(8), database.read_entries

    def read_slowly(*arguments: Any) -> list[database.Entry]:
        entries = read(*arguments)
        time.sleep(thinking_s)
        return entries

    def work(name: str) -> None:
        is_file = "://" not in place
        station = slots.ALONE if is_file else slots.Station(name)
        database.read_entries = read_slowly
        start.wait()
        ledger = database.open_ledger(
            Path(place) if is_file else Server(place, "feel321_race", name)
        )
        with (folder / name).open("w") as given:
            for number in range(count):
                names = [f"{name}-{number}"]
                claimed = slots.claim_slots(
                    ledger, names, simulated=False, now=tell_time, station=station
                )
                given.write(f"{claimed[names[0]]}\n")

    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", DeprecationWarning
        )  # of threads, which the children do not need
        processes = [context.Process(target=work, args=(f"p{number}",)) for number in range(8)]
        for process in processes:
            process.start()
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0] * 8
    return [int(line) for path in folder.glob("p?") for line in path.read_text().split()]


@pytest.fixture(params=["file", "server"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "file":
        return str(tmp_path / "ledger.sqlite")
    server = request.getfixturevalue("login")
    ledger = database.connect_ledger(Server(server.url, "feel321_race", "one"))
    with database.transact(ledger) as connection:
        connection.exec_driver_sql("DROP SCHEMA IF EXISTS feel321_race CASCADE")
    return str(server.url)


@pytest.mark.parametrize(
    ("count", "thinking_s"), [(3, 0.02), pytest.param(500, 0.0, marks=pytest.mark.soak)]
)
def test_eight_processes_never_get_one_slot_and_leave_no_gap(
    place: str, tmp_path: Path, count: int, thinking_s: float
) -> None:
    given = race(place, tmp_path, count=count, thinking_s=thinking_s)
    assert sorted(given) == list(range(1, 8 * count + 1))


def test_no_other_program_can_give_a_slot_twice(
    login: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = Server(login.url, "feel321_unlocked", "one")
    monkeypatch.setattr(database, "_begin", lambda _connection: None)
    ledger = database.open_ledger(place)
    entry = database.Entry("p1", simulated=False, number=1, state="claimed", station="one")
    with database.transact(ledger) as connection:
        database.write_entries(connection, [entry])
    with pytest.raises(OSError, match="one_participant_per_slot"), database.transact(ledger) as own:
        database.write_entries(own, [replace(entry, participant="p2")])


def claim(study: StudyFolder, *names: str) -> dict[str, int]:
    ledger, _ = slots.open_study_ledger(study)
    return slots.claim_numbers(study, ledger, names, simulated=False, now=tell_time)


def test_stations_share_a_study_and_studies_share_a_server(
    login: Any, make_station: Callable[..., StudyFolder], monkeypatch: pytest.MonkeyPatch
) -> None:
    one, two = make_station("one", login.url), make_station("two", login.url)
    other = make_station("other", login.url)
    text = other.settings.read_text().replace('name = "', 'name = "another ')
    other.settings.write_text(text)
    assert claim(one, "p01") == {"p01": 1}
    monkeypatch.setenv("FEEL321_STATION", "two")
    assert claim(two, "p02") == {"p02": 2}
    assert claim(other, "p01") == {"p01": 1}
    with pytest.raises(ValueError, match="p01: the session is at station one, this one is two"):
        claim(two, "p01")
    with pytest.raises(ValueError, match="p01: is at station one; release"):
        release_participant(two, "p01", now=tell_time)
    with pytest.raises(ValueError, match="p01: is at station one; withdraw"):
        withdraw_participant(two, "p01", now=tell_time)
    assert not (two.sessions / "p01").exists()
    assert [entry.participant for entry in slots.read_study_ledger(two)] == ["p01", "p02"]
    assert audit_study(two) == []  # What is at another station is not missed here.


def test_a_station_that_plans_otherwise_is_refused(
    login: Any, make_station: Callable[..., StudyFolder], monkeypatch: pytest.MonkeyPatch
) -> None:
    one, two = make_station("one", login.url), make_station("two", login.url)
    simulate_study(one, participants=1, seed=1, now=tell_time)
    monkeypatch.setenv("FEEL321_STATION", "two")
    text = two.settings.read_text()
    two.settings.write_text(
        text.replace("repeats = 2", "repeats = 3\n[session.breaks]\nbreak_s = 40")
    )
    with pytest.raises(ValueError, match="the other stations run this study otherwise") as refusal:
        simulate_study(two, participants=1, seed=1, now=tell_time)
    assert "repeats 2 -> 3" in str(refusal.value)
    assert "flow.break_s" in str(refusal.value)
    assert login.url.partition("?")[0] in str(refusal.value)
    two.settings.write_text(text)
    with pytest.raises(ValueError, match="sim001: the session is at station one"):
        simulate_study(two, participants=1, seed=1, now=tell_time)


def test_without_the_server_nobody_new_begins(
    login: Any, make_station: Callable[..., StudyFolder], monkeypatch: pytest.MonkeyPatch
) -> None:
    study = make_station("one", login.url)
    simulate_study(study, participants=1, seed=1, now=tell_time)
    monkeypatch.setenv("FEEL321_LEDGER", "postgresql://lab@/postgres?host=/nowhere")
    warnings: list[str] = []
    simulate_study(study, participants=1, seed=1, now=tell_time, warn=warnings.append)
    assert "out of reach" in " ".join(warnings)
    with pytest.raises(
        ConnectionError, match=r"planned at this station can continue, got sim002"
    ) as refusal:
        simulate_study(study, participants=2, seed=1, now=tell_time)
    assert "\n" not in str(refusal.value)
    assert not (study.sessions / "sim002").exists()


def test_the_clock_of_claims_is_the_servers(
    login: Any, make_station: Callable[..., StudyFolder]
) -> None:
    study = make_station("one", login.url)
    ledger, _ = slots.open_study_ledger(study)
    late = lambda: tell_time() + timedelta(seconds=90)  # noqa: E731 - a clock is passed as a function
    slots.claim_numbers(study, ledger, ["p01"], simulated=False, now=late)
    (entry,) = slots.read_study_ledger(study)
    assert abs(datetime.fromisoformat(entry.claimed_utc) - tell_time()) < timedelta(seconds=45)
    (line,) = stations.describe_clocks(stations.read_clocks(ledger))
    assert line.startswith("station one: its clock was 90 s ahead of the server's at 2")
    claim(study, "p02")
    assert list(stations.describe_clocks(stations.read_clocks(ledger))) == []


def test_a_rebuild_keeps_what_other_stations_did(
    login: Any, make_station: Callable[..., StudyFolder], monkeypatch: pytest.MonkeyPatch
) -> None:
    one, two = make_station("one", login.url), make_station("two", login.url)
    simulate_study(one, participants=1, seed=1, now=tell_time)
    monkeypatch.setenv("FEEL321_STATION", "two")
    claim(two, "p02")
    before = slots.read_study_ledger(one)
    assert slots.rebuild_ledger(two) == []
    assert slots.read_study_ledger(one) == before
    monkeypatch.setenv("FEEL321_STATION", "one")
    assert slots.rebuild_ledger(one) == []
    assert [e.station for e in slots.read_study_ledger(one)] == ["two", "one"]
    withdraw_participant(one, "sim001", now=tell_time)
    assert [e.state for e in slots.read_study_ledger(two)] == ["claimed", "withdrawn"]
    assert audit_study(one) == []
    monkeypatch.setenv("FEEL321_STATION", "two")
    assert audit_study(two) == []


def test_stations_without_a_network_divide_the_numbers(
    make_station: Callable[..., StudyFolder],
) -> None:
    given = {
        station: claim(
            make_station(f"s{station}", more=f"[ledger]\nstation = {station}\nof = 3\n"),
            "a",
            "b",
            "c",
        )
        for station in (1, 2, 3)
    }
    assert [list(numbers.values()) for numbers in given.values()] == [
        [1, 4, 7],
        [2, 5, 8],
        [3, 6, 9],
    ]


def test_one_session_is_at_one_station_whatever_was_copied(
    login: Any, make_station: Callable[..., StudyFolder], monkeypatch: pytest.MonkeyPatch
) -> None:
    one = make_station("one", login.url)
    simulate_study(one, participants=1, seed=1, now=tell_time)
    monkeypatch.setenv("FEEL321_STATION", "two")
    two = make_station("two", login.url)
    assert collect_sessions(two, [one.path], now=tell_time).refused == []
    before = slots.read_study_ledger(two)
    doings: dict[str, Callable[[], object]] = {
        "the session is": lambda: simulate_study(two, participants=1, seed=1, now=tell_time),
        "release": lambda: release_participant(two, "sim001", now=tell_time),
        "take the note": lambda: take_note(two, "sim001", "a word", now=tell_time),
    }
    for what, do in doings.items():
        with pytest.raises(ValueError, match=f"at station one.*{what}|{what} at station one"):
            do()
    assert slots.read_study_ledger(two) == before
    assert audit_study(two) == []
    monkeypatch.setenv("FEEL321_STATION", "one")  # Said explicitly, it may.
    take_note(two, "sim001", "a word", now=tell_time)


def test_two_computers_of_one_name_are_not_one_station(
    login: Any, make_station: Callable[..., StudyFolder], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("FEEL321_STATION")
    monkeypatch.setattr(servers, "node", lambda: "pc")
    one, two = make_station("one", login.url), make_station("two", login.url)
    assert [claim(one, name)[name] for name in ("p01", "p02")] == [1, 2]
    for do in (lambda: claim(two, "p01"), lambda: slots.rebuild_ledger(two)):
        with pytest.raises(ValueError, match="station pc: another study folder has this name"):
            do()
    assert [entry.participant for entry in slots.read_study_ledger(two)] == ["p01", "p02"]
    monkeypatch.setenv("FEEL321_STATION", "pc")
    assert claim(two, "p01") == {"p01": 1}
    monkeypatch.setenv("FEEL321_STATION", "pc2")
    assert claim(two, "p03") == {"p03": 3}


@pytest.mark.parametrize("name", ["pilot", "  ", " pilot"])
def test_a_study_without_a_name_of_its_own_shares_no_server(
    name: str, login: Any, make_station: Callable[..., StudyFolder]
) -> None:
    study = make_station("one", login.url)
    own = study.settings.read_text().split("\n", 2)
    for text in (own[2], "\n".join(["[study]", f'name = "{name}"', own[2]])):
        study.settings.write_text(text)
        with pytest.raises(ValueError, match=r"study.name must be the study's own on a server"):
            claim(study, "p01")
    study.settings.write_text("\n".join([own[0], 'name = " x "', own[2]]))
    found = find_server(study.settings)
    assert found is not None
    assert found.schema == name_schema("x")


def test_reading_makes_no_schema(login: Any, make_station: Callable[..., StudyFolder]) -> None:
    study = make_station("one", login.url)
    assert slots.read_study_ledger(study) == []
    assert slots.read_others(study) == ([], ())
    place = slots.find_place(study)
    assert isinstance(place, Server)
    with database.transact(database.connect_ledger(place), writes=False) as connection:
        known = connection.exec_driver_sql("SELECT nspname FROM pg_namespace").scalars().all()
    assert place.schema not in known


def test_a_move_to_a_server_forgets_nothing_unseen(
    login: Any, make_station: Callable[..., StudyFolder]
) -> None:
    study = make_station("one")
    simulate_study(study, participants=2, seed=1, now=tell_time)
    claim(study, "p07", "p08")
    journal = study.sessions / "sim001" / "session-01.jsonl"
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:-3]))
    shutil.rmtree(study.sessions / "sim002")
    with study.settings.open("a") as file:
        file.write(f'[ledger]\nurl = "{login.url}"\n')
    assert "was empty; 3 participants" in slots.open_study_ledger(study)[1]
    assert {entry.participant for entry in slots.read_study_ledger(study)} == {
        "sim001", "p07", "p08",
    }  # fmt: skip
    for name, line in zip(("sim001", "sim002"), slots.find_lost(study), strict=True):
        assert "forgot: sessions/" + name in line
    assert len(slots.find_lost(study)) == 2


def test_a_lost_stations_numbers_are_freed_in_its_name(
    login: Any, make_station: Callable[..., StudyFolder], monkeypatch: pytest.MonkeyPatch
) -> None:
    one, two = make_station("one", login.url), make_station("two", login.url)
    simulate_study(one, participants=1, seed=1, now=tell_time)
    claim(one, "p01")
    monkeypatch.setenv("FEEL321_STATION", "two")
    claim(two, "p02")
    monkeypatch.setenv("FEEL321_STATION", "one")
    assert "sim001: is gone without a tombstone" in slots.rebuild_ledger(two)[0]
    assert release_participant(two, "p01", now=tell_time) == 1
    assert [entry.participant for entry in slots.read_study_ledger(two)] == ["p02"]
    assert "forgot: sessions/sim001" in slots.list_forgotten(two)[0]
    monkeypatch.setenv("FEEL321_STATION", "two")
    assert claim(two, "p03") == {"p03": 1}


def test_a_damaged_plan_keeps_nobody_else_from_a_session(
    login: Any, make_station: Callable[..., StudyFolder]
) -> None:
    study = make_station("one", login.url)
    simulate_study(study, participants=1, seed=1, now=tell_time)
    ledger, notice = slots.open_study_ledger(study)
    database.rewrite_ledger(ledger, lambda known: [replace(one, state="running") for one in known])
    plan = study.sessions / "sim001" / "plan.json"
    plan.write_bytes(plan.read_bytes()[:200])
    assert claim(study, "p02") == {"p02": 1}
    assert notice == ""
    assert str(plan) in slots.open_study_ledger(study)[1]


def test_every_station_without_a_network_has_every_group(
    make_station: Callable[..., StudyFolder],
) -> None:
    groups = {"hand": ("left", "right"), "coil": ("a", "b", "c")}
    table = "".join(f"{name} = {list(levels)}\n" for name, levels in groups.items())
    for station in (1, 2):
        more = f"[between]\n{table}[ledger]\nstation = {station}\nof = 2\n"
        study = make_station(f"s{station}", more=more)
        numbers = [*claim(study, *(f"p{one}" for one in range(12))).values()]
        assert numbers[:7] == [n + 6 * (station - 1) for n in (1, 2, 3, 4, 5, 6, 13)]
        seen = [tuple(place_in_groups(groups, number)[0].values()) for number in numbers]
        assert {seen.count(one) for one in seen} == {2}
        assert len(set(seen)) == 6


def test_what_is_collected_and_the_server_agree(
    login: Any, make_station: Callable[..., StudyFolder], monkeypatch: pytest.MonkeyPatch
) -> None:
    one, two = make_station("one", login.url), make_station("two", login.url)
    simulate_study(one, participants=1, seed=1, now=tell_time)
    whole = (one.sessions / "sim001" / "session-01.jsonl").read_bytes()
    before = slots.read_study_ledger(one)
    monkeypatch.setenv("FEEL321_STATION", "two")
    (one.sessions / "sim001" / "session-01.jsonl").write_bytes(
        b"".join(whole.splitlines(keepends=True)[:4])
    )
    found = collect_sessions(
        two, [one.path], now=tell_time
    )  # from a copy that is older than the ledger
    assert "ends with line 4" in found.notes[0]
    assert slots.read_study_ledger(two) == before
    assert "ends with line 4" in audit_study(two)[0]
    (one.sessions / "sim001" / "session-01.jsonl").write_bytes(whole)
    monkeypatch.setenv("FEEL321_LEDGER", "postgresql://lab@/postgres?host=/nowhere")
    found = collect_sessions(two, [one.path], now=tell_time)  # Files need no server.
    assert (found.files, len(found.notes)) == (5, 1)
    assert "out of reach" in found.notes[0]
    monkeypatch.delenv("FEEL321_LEDGER")
    assert collect_sessions(two, [one.path], now=tell_time).notes == []
    assert slots.read_study_ledger(two) == before
    assert [entry.station for entry in slots.read_study_ledger(two)] == ["one"]
    assert audit_study(two) == []
    assert [one.state for one in read_status(two).participants] == ["finished"]
    withdraw_participant(two, "sim001", now=tell_time)
    monkeypatch.setenv("FEEL321_STATION", "one")
    (finding,) = audit_study(one)
    assert "was withdrawn at station two; remove the data here too: feel321 withdraw" in finding
    withdraw_participant(one, "sim001", now=tell_time)
    assert audit_study(one) == []


# Passwords.


@pytest.mark.parametrize(
    "url",
    [
        "postgresql://lab:s3cret@host/db",
        "postgresql+psycopg://lab:s3#c@r/e?t@host/db",
        "postgresql://lab@host/db?password=s3cret",
        "postgresql://host/db?dbname=host%3Dh%20password%3Ds3cret",
        "postgresql://host/db?options=-c%20a=b;password=s3cret",
        "postgresql://lab%3As3cret@host/db",
        "postgresql://lab%253As3cret@host/db",
        "postgresql://lab@host/db?sslmode=require&SSLPassword=s3cret",
        "mysql://lab:s3cret@host/db",
    ],
)
def test_a_password_in_a_url_is_refused_and_not_repeated(
    url: str, make_station: Callable[..., StudyFolder], monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ValueError, match="must hold no password, got one") as refusal:
        check_url(url)
    assert "s3" not in str(refusal.value)
    study = make_station("one", url)
    for read in (lambda own: find_server(own.settings), lambda own: read_settings(own.settings)):
        with pytest.raises(ValueError, match="must hold no password, got one") as refusal:
            read(study)
        assert "s3" not in str(refusal.value)
    monkeypatch.setenv("FEEL321_LEDGER", url)
    with pytest.raises(ValueError, match="FEEL321_LEDGER must hold no password") as refusal:
        find_server(study.settings)
    assert "s3" not in str(refusal.value)


@pytest.mark.parametrize(
    "slip", ['url = ["s3"]', 'uri = "s3"', 'url = "sqlite:///s3"', "of = 2", "station = 3\nof = 2"]
)
def test_a_slip_leads_to_no_other_ledger(
    slip: str, make_station: Callable[..., StudyFolder]
) -> None:
    study = make_station("one", more=f"[ledger]\n{slip}\n")
    for read in (slots.read_study_ledger, lambda own: read_settings(own.settings)):
        with pytest.raises(ValueError, match=r"ledger.* must") as refusal:
            read(study)
        assert "s3" not in str(refusal.value)


@pytest.mark.parametrize("name", ["PGPASSFILE", "PGSERVICEFILE"])
def test_a_file_of_passwords_that_others_may_read_is_refused(
    name: str,
    login: Any,
    tmp_path: Path,
    make_station: Callable[..., StudyFolder],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = tmp_path / "secrets"
    secret = os.environ["PGPASSWORD"]
    path.write_text(
        f"*:*:*:*:{secret}\n" if name == "PGPASSFILE" else f"[lab]\npassword={secret}\n"
    )
    monkeypatch.delenv("PGPASSWORD")
    monkeypatch.setenv(name, str(path))
    query = "&service=lab" if name == "PGSERVICEFILE" else ""
    study = make_station("one", login.url + query)
    path.chmod(0o640)
    with pytest.raises(ValueError, match="secrets: must be readable by you alone, got mode 0640"):
        claim(study, "p01")
    path.chmod(0o600)
    assert claim(study, "p01") == {"p01": 1}


def test_the_password_is_nowhere_written_or_printed(
    login: Any,
    make_station: Callable[..., StudyFolder],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    study, secret = make_station("one", login.url), os.environ["PGPASSWORD"]
    calls = [
        ("simulate", "--participants", "1"),
        ("ledger", "--json"),
        ("audit",),
        ("status", "--json"),
    ]
    printed = []
    for verb, *options in calls:
        assert cli.main([verb, str(study.path), *options]) == 0
        printed.append(capfd.readouterr())
    assert json.loads(printed[1].out)[0]["station"] == "one"
    monkeypatch.setenv("PGPASSWORD", f"{secret}-but-wrong")
    assert cli.main(["ledger", str(study.path)]) == 1
    printed.append(capfd.readouterr())
    assert "password authentication failed" in printed[-1].err
    assert printed[-1].err.count("\n") == 1
    everything = "".join(one.out + one.err for one in printed)
    files = [path for path in study.path.rglob("*") if path.is_file()]
    assert (
        secret in everything,
        [path for path in files if secret.encode() in path.read_bytes()],
    ) == (False, [])
    assert servers.scrub(f"a {secret}-but-wrong\n b") == "a *** b"


def test_a_study_is_the_same_on_every_computer() -> None:
    assert name_schema("Holz") == name_schema("Holz") != name_schema("holz")
    assert len(name_schema("x" * 500)) < 64  # PostgreSQL would cut longer ones
