"""Ways to falsify a finished study, each a function on its folder; `seen.csv` says which are seen, and how.

`knows` says how well informed a cheat is: it edits files; mends the digests of what it edits; makes the tables anew,
so that they agree. On top of that, `begin_anew` makes the evidence anew.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.checkpoints import take_checkpoint
from feel321.study.people import Tombstone, write_roster, write_tombstone
from feel321.study.persons.answers import write_answers
from feel321.study.persons.withdrawal import withdraw_participant
from feel321.study.ratings import write_matches, write_ratings
from feel321.study.session.journal import (
    START,
    Anchor,
    Record,
    digest,
    read_anchor,
    read_journal,
    write_line,
)
from feel321.study.simulation import simulate_study

if TYPE_CHECKING:
    from feel321.study.folder import StudyFolder

EDITS, DIGESTS, TABLES = "edits", "mends digests", "mends tables"


@dataclass(frozen=True)
class Cheat:
    """One way; is_real: of the study that was run on a rig; is_data: whether it changes what the data say."""

    name: str
    act: Callable[[StudyFolder], None]
    knows: str
    is_data: bool
    is_real: bool


CHEATS: dict[str, Cheat] = {}


def cheat(
    name: str, knows: str = EDITS, *, is_data: bool = True, is_real: bool = False
) -> Callable[[Callable[[StudyFolder], None]], Callable[[StudyFolder], None]]:
    def register(act: Callable[[StudyFolder], None]) -> Callable[[StudyFolder], None]:
        def do(study: StudyFolder) -> None:
            act(study)
            if knows == TABLES:
                take_as_it_is(study)

        CHEATS[name] = Cheat(name, do, knows, is_data, is_real)
        return act

    return register


# What cheats are made of.


def now() -> datetime:
    return datetime.now(UTC)


def folder(study: StudyFolder, name: str = "sim001") -> Path:
    return study.sessions / name


def journal(study: StudyFolder, name: str = "sim001") -> Path:
    return folder(study, name) / "session-01.jsonl"


def chain(path: Path, records: list[Record]) -> None:
    """Write records as a chain that holds, whatever they say."""
    content, tip = b"", START
    for sequence, record in enumerate(records):
        line = write_line(replace(record, sequence=sequence), tip)
        content, tip = content + line, digest(line.rstrip(b"\n"))
    path.write_bytes(content)


def edit_record(
    path: Path, event: str, change: Callable[[dict[str, Any]], dict[str, Any]], *, number: int = -1
) -> None:
    records = list(read_journal(path).records)
    places = [place for place, record in enumerate(records) if record.event == event]
    place = places[number]
    records[place] = replace(
        records[place], data=change(json.loads(json.dumps(records[place].data)))
    )
    chain(path, records)


def better(data: dict[str, Any]) -> dict[str, Any]:
    """Raise a rating by a few points."""
    values = {
        part: min(value + 7.5, 100.0) if isinstance(value, float) and value <= 92 else 61.25
        for part, value in data["values"].items()
    }
    return {**data, "values": values}


def take_as_it_is(study: StudyFolder) -> None:
    """Make tables agree with whatever stands in the sessions."""
    with suppress(ValueError):  # of journals that no longer make sense
        derive(study)


def derive(study: StudyFolder) -> None:
    stimuli = read_stimuli(study.stimuli)
    write_roster(study)
    write_ratings(study, stimuli)
    write_matches(study, stimuli)
    write_answers(study)


def reseal(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Change a plan and mend its digest."""
    body, _, _ = path.read_bytes().rpartition(b',\n "sha256"')
    entry = json.loads(body + b"\n}")
    change(entry)
    text = json.dumps(entry, indent=1, ensure_ascii=False).encode().removesuffix(b"\n}")
    path.write_bytes(text + b',\n "sha256": "' + digest(text + b"\n}").encode() + b'"\n}\n')


def edit_header(study: StudyFolder, name: str = "sim001", **changes: Any) -> None:
    edit_record(journal(study, name), "begun", lambda data: {**data, **changes}, number=0)


def follow_plan(study: StudyFolder, name: str = "sim001") -> None:
    """Make a journal's header name the plan beside it as it is now."""
    sha256 = json.loads((folder(study, name) / "plan.json").read_bytes())["sha256"]
    edit_header(study, name, plan_sha256=sha256)


def edit_table(path: Path, change: Callable[[list[list[str]]], object]) -> None:
    rows = list(csv.reader(io.StringIO(path.read_text(encoding="utf-8"), newline="")))
    change(rows)
    text = io.StringIO(newline="")
    csv.writer(text).writerows(rows)
    path.write_text(text.getvalue(), encoding="utf-8", newline="")


def set_cell(rows: list[list[str]], column: str, value: str, line: int = 1) -> None:
    rows[line][rows[0].index(column)] = value


def replace_text(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text, path
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def begin_anew(study: StudyFolder) -> None:
    """Make the evidence anew, as if the study had always been what it is now, and push it."""
    shutil.rmtree(study.path / ".evidence", ignore_errors=True)
    remote = study.path.parent / "remote.git"
    take_checkpoint(study, "seal", remote=str(remote) if remote.is_dir() else "", now=now)


# Ratings in the journal.


@cheat("a rating is edited")
def _(study: StudyFolder) -> None:
    path = journal(study)
    lines = path.read_bytes().split(b"\n")
    place = max(n for n, line in enumerate(lines) if b'"event": "rated"' in line)
    lines[place] = lines[place].replace(b'"values": {', b'"values": {"test": 99.0, ', 1)
    path.write_bytes(b"\n".join(lines))


@cheat("a rating is edited and the chain made anew", DIGESTS)
def _(study: StudyFolder) -> None:
    edit_record(journal(study), "rated", better)


@cheat("a rating is edited, chain and tables made anew", TABLES)
def _(study: StudyFolder) -> None:
    edit_record(journal(study), "rated", better)


@cheat("all ratings of a participant are reversed", TABLES)
def _(study: StudyFolder) -> None:
    records = list(read_journal(journal(study)).records)
    for place, record in enumerate(records):
        values = record.data.get("values", {})
        if record.event == "rated" and all(isinstance(value, float) for value in values.values()):
            turned = {part: 100.0 - value for part, value in values.items()}
            records[place] = replace(record, data={**record.data, "values": turned})
    chain(journal(study), records)


@cheat("a response time is edited", TABLES)
def _(study: StudyFolder) -> None:
    edit_record(
        journal(study),
        "rated",
        lambda data: {**data, "response_time_s": data["response_time_s"] + 1.5},
    )


@cheat("a rating is marked as rejected", TABLES)
def _(study: StudyFolder) -> None:
    edit_record(journal(study), "rated", lambda data: {**data, "rejected": True})


@cheat("underruns of a playback are taken out", TABLES, is_data=False)
def _(study: StudyFolder) -> None:
    edit_record(journal(study), "played", lambda data: {**data, "dac_source": "device"})


@cheat("two answers are exchanged", TABLES)
def _(study: StudyFolder) -> None:
    path = journal(study)
    records = list(read_journal(path).records)
    one, other = [
        n for n, r in enumerate(records) if r.event == "rated" and "test" in r.data["values"]
    ][-2:]
    first, second = records[one].data["values"], records[other].data["values"]
    records[one] = replace(records[one], data={**records[one].data, "values": second})
    records[other] = replace(records[other], data={**records[other].data, "values": first})
    chain(path, records)


@cheat("an answer to a question is edited", TABLES)
def _(study: StudyFolder) -> None:
    path = folder(study) / "personal.jsonl"
    row, *rest = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    place = [row[name] for name in row if name not in {"salt", "sha256", "value"}]
    old, row["value"] = row["sha256"], 44
    own = json.dumps([row["salt"], "sim001", *place, row["value"]]).encode()
    row["sha256"] = hashlib.sha256(own).hexdigest()
    path.write_text("".join(json.dumps(one) + "\n" for one in (row, *rest)), encoding="utf-8")
    records = list(read_journal(journal(study)).records)
    chain(journal(study), [
        replace(r, data={**r.data, "sha256": row["sha256"]}) if r.data.get("sha256") == old else r for r in records
    ])  # fmt: skip


@cheat("an answer of the threshold block is edited", TABLES)
def _(study: StudyFolder) -> None:
    def turn(data: dict[str, Any]) -> dict[str, Any]:
        other = {"first": "second", "second": "first"}
        values = data["values"].items()
        return {**data, "values": {part: other.get(str(value), value) for part, value in values}}

    edit_record(journal(study), "rated", turn, number=0)


def shift_times(path: Path, first: int) -> None:
    """Set the time of day two hours ahead from a record on."""
    records = list(read_journal(path).records)
    for place, record in enumerate(records[first:], start=first):
        late = datetime.fromisoformat(record.utc) + timedelta(hours=2)
        records[place] = replace(record, utc=late.isoformat(timespec="milliseconds"))
    chain(path, records)


@cheat("the time of day of a record is edited, not the time of the session", TABLES)
def _(study: StudyFolder) -> None:
    shift_times(journal(study), len(read_journal(journal(study)).records) - 3)


@cheat("the time of day is edited in a session with people", TABLES, is_real=True)
def _(study: StudyFolder) -> None:
    records = read_journal(journal(study, "p01")).records
    shift_times(journal(study, "p01"), next(n for n, r in enumerate(records) if r.event == "rated"))


@cheat("the records of a journal are put into another order", TABLES)
def _(study: StudyFolder) -> None:
    path = journal(study)
    records = list(read_journal(path).records)
    records[-4], records[-3] = records[-3], records[-4]
    chain(path, records)


@cheat("an attempt that was spoiled is invented", TABLES)
def _(study: StudyFolder) -> None:
    path = journal(study)
    records = list(read_journal(path).records)
    place = max(n for n, r in enumerate(records) if r.event == "rated")
    spoiled = replace(
        records[place],
        event="spoiled",
        data={
            **{k: records[place].data[k] for k in ("trial", "attempt", "time_s")},
            "flags": ["device_error"],
        },
    )
    chain(path, [*records[:place], spoiled, *records[place:]])


@cheat("the flags of an answer are taken out", TABLES)
def _(study: StudyFolder) -> None:
    edit_record(journal(study), "rated", lambda data: {**data, "flags": ["underrun"]})


@cheat("an experimenter's note is put in", TABLES)
def _(study: StudyFolder) -> None:
    path = journal(study)
    records = list(read_journal(path).records)
    chain(path, [*records, replace(records[-1], event="note", data={"text": "was tired"})])


# Ends of journals, sessions and participants.


@cheat("the last lines of a journal are cut off")
def _(study: StudyFolder) -> None:
    lines = journal(study).read_bytes().splitlines(keepends=True)
    journal(study).write_bytes(b"".join(lines[:-6]))


@cheat("the last lines are cut off, and the tables made anew", TABLES)
def _(study: StudyFolder) -> None:
    lines = journal(study).read_bytes().splitlines(keepends=True)
    journal(study).write_bytes(b"".join(lines[:-6]))
    derive(study)


@cheat("a journal is cut, the rest shown as a line that a crash tore", TABLES)
def _(study: StudyFolder) -> None:
    lines = journal(study).read_bytes().splitlines(keepends=True)
    journal(study).write_bytes(b"".join(lines[:-6]) + lines[-6][:20])


@cheat("a journal is emptied", TABLES)
def _(study: StudyFolder) -> None:
    journal(study).write_bytes(b"")


@cheat("a journal is removed")
def _(study: StudyFolder) -> None:
    journal(study).unlink()


@cheat("a participant is removed")
def _(study: StudyFolder) -> None:
    shutil.rmtree(folder(study, "sim002"))


@cheat("a participant is removed everywhere", TABLES)
def _(study: StudyFolder) -> None:
    shutil.rmtree(folder(study, "sim002"))


@cheat("sessions/ is removed (rm -rf sessions)")
def _(study: StudyFolder) -> None:
    shutil.rmtree(study.sessions)


@cheat("sessions/ and the roster are removed")
def _(study: StudyFolder) -> None:
    shutil.rmtree(study.sessions)
    (study.path / "participants.csv").unlink()


@cheat("sessions/, the roster and the evidence are removed", is_data=False)
def _(study: StudyFolder) -> None:
    shutil.rmtree(study.sessions)
    (study.path / "participants.csv").unlink()
    shutil.rmtree(study.path / ".evidence", ignore_errors=True)


@cheat("two participants exchange their folders")
def _(study: StudyFolder) -> None:
    one, other, third = (folder(study, name) for name in ("sim001", "sim002", "sim009"))
    one.rename(third)
    other.rename(one)
    third.rename(other)


@cheat("two participants exchange their journals", TABLES)
def _(study: StudyFolder) -> None:
    one, other = (journal(study, name).read_bytes() for name in ("sim001", "sim002"))
    journal(study, "sim001").write_bytes(other)
    journal(study, "sim002").write_bytes(one)


def copy_as(study: StudyFolder, old: str, new: str, number: int) -> None:
    """Copy a participant under another code and number, with all digests mended."""
    shutil.copytree(folder(study, old), folder(study, new))
    reseal(
        folder(study, new) / "plan.json", lambda plan: plan.update(participant=new, number=number)
    )
    edit_header(study, new, participant=new)
    follow_plan(study, new)


@cheat("a session is copied under another code")
def _(study: StudyFolder) -> None:
    shutil.copytree(folder(study, "sim002"), folder(study, "sim009"))


@cheat("a session is copied under another code, with all digests", TABLES)
def _(study: StudyFolder) -> None:
    copy_as(study, "sim002", "sim009", 9)


@cheat("a participant is taken for another (renamed)", TABLES)
def _(study: StudyFolder) -> None:
    copy_as(study, "sim002", "sim009", 2)
    shutil.rmtree(folder(study, "sim002"))


@cheat("a participant's folder is a link", is_data=False)
def _(study: StudyFolder) -> None:
    target = study.path.parent / f"{study.path.name}-elsewhere"
    shutil.rmtree(target, ignore_errors=True)
    folder(study).rename(target)
    folder(study).symlink_to(target)


@cheat("a journal is a hard link to another one")
def _(study: StudyFolder) -> None:
    journal(study).unlink()
    os.link(journal(study, "sim002"), journal(study))


@cheat("a second session is put beside the first")
def _(study: StudyFolder) -> None:
    shutil.copy(journal(study), folder(study) / "session-02.jsonl")


@cheat("a second session is put beside the first, with all digests", TABLES)
def _(study: StudyFolder) -> None:
    target = folder(study) / "session-02.jsonl"
    shutil.copy(journal(study), target)
    edit_record(target, "begun", lambda data: {**data, "session": 2}, number=0)


def change_presenter(study: StudyFolder, name: str, **changes: Any) -> None:
    header = read_journal(journal(study, name)).records[0].data
    edit_header(study, name, presenter={**header["presenter"], **changes})


@cheat("a rehearsal is taken for a session", TABLES, is_real=True)
def _(study: StudyFolder) -> None:
    change_presenter(study, "p01", rehearsal=True)


def pass_as_real(study: StudyFolder, **presenter: Any) -> None:
    reseal(folder(study) / "plan.json", lambda plan: plan.update(simulated=False))
    change_presenter(study, "sim001", simulated=False)
    if presenter:
        edit_header(study, presenter=presenter)
    follow_plan(study)


@cheat("`simulated` is false in the header", DIGESTS)
def _(study: StudyFolder) -> None:
    change_presenter(study, "sim001", simulated=False)


@cheat("`simulated` is false in the plan", DIGESTS)
def _(study: StudyFolder) -> None:
    reseal(folder(study) / "plan.json", lambda plan: plan.update(simulated=False))


@cheat("a simulated participant is passed as real, everywhere", TABLES)
def _(study: StudyFolder) -> None:
    pass_as_real(study)


@cheat("a simulated participant is passed as real, without a trace of the observer", TABLES)
def _(study: StudyFolder) -> None:
    pass_as_real(study, simulated=False, rehearsal=False, rig=None)


@cheat("the whole study is made anew with another seed", TABLES)
def _(study: StudyFolder) -> None:
    shutil.rmtree(study.sessions)
    for name in ("ratings.csv", "participants.csv", "answers.csv"):
        (study.path / name).unlink(missing_ok=True)
    simulate_study(study, participants=3, seed=77, now=now)


@cheat("the versions in a header are edited", TABLES, is_data=False)
def _(study: StudyFolder) -> None:
    versions = read_journal(journal(study)).records[0].data["versions"]
    edit_header(study, versions={**versions, "feel321": "9.9"})


# Plans, tombstones.


@cheat("the order of a plan is changed, and the plan sealed", TABLES)
def _(study: StudyFolder) -> None:
    reseal(folder(study) / "plan.json", lambda plan: plan.update(order="random"))
    follow_plan(study)


@cheat("the rules of a plan (fastest answer) are changed, and the plan sealed", TABLES)
def _(study: StudyFolder) -> None:
    reseal(folder(study) / "plan.json", lambda plan: plan["flow"].update(min_response_s=0.01))
    follow_plan(study)


@cheat("the group of a participant is changed", TABLES)
def _(study: StudyFolder) -> None:
    reseal(folder(study) / "plan.json", lambda plan: plan.update(number=plan["number"] + 5))
    follow_plan(study)


@cheat("a bad rater is withdrawn, by the verb", TABLES, is_data=False)
def _(study: StudyFolder) -> None:
    withdraw_participant(study, "sim002", now=now)


@cheat("a finished session is shown as released", TABLES)
def _(study: StudyFolder) -> None:
    records = list(read_journal(journal(study)).records)
    chain(journal(study), [*records, replace(records[-1], event="released", data={})])


def forge_tombstone(study: StudyFolder, *journals: Anchor) -> None:
    shutil.rmtree(folder(study, "sim002"))
    folder(study, "sim002").mkdir()
    stone = Tombstone("sim002", 2, True, now().isoformat(), "asked for it", journals, "removed")
    write_tombstone(folder(study, "sim002"), stone)


@cheat("a tombstone is forged", TABLES)
def _(study: StudyFolder) -> None:
    forge_tombstone(study)


@cheat("a tombstone is forged with the digests of the journals", TABLES)
def _(study: StudyFolder) -> None:
    forge_tombstone(study, read_anchor(journal(study, "sim002")))


@cheat("a tombstone is removed")
def _(study: StudyFolder) -> None:
    withdraw_participant(study, "sim002", now=now)
    shutil.rmtree(folder(study, "sim002"))


# Tables and the report.


@cheat("a cell of ratings.csv is edited")
def _(study: StudyFolder) -> None:
    edit_table(study.ratings, lambda rows: set_cell(rows, "rating", "99.5", 3))


@cheat("a row of ratings.csv is left out")
def _(study: StudyFolder) -> None:
    edit_table(study.ratings, lambda rows: rows.pop(2))


@cheat("the last row of ratings.csv is left out")
def _(study: StudyFolder) -> None:
    edit_table(study.ratings, lambda rows: rows.pop())


@cheat("a row of ratings.csv stands there twice")
def _(study: StudyFolder) -> None:
    edit_table(study.ratings, lambda rows: rows.append(rows[2]))


@cheat("`simulated` is false in ratings.csv")
def _(study: StudyFolder) -> None:
    text = study.ratings.read_text(encoding="utf-8")
    study.ratings.write_text(text.replace(",true,", ",false,"), encoding="utf-8", newline="")


@cheat("a threshold in participants.csv is edited")
def _(study: StudyFolder) -> None:
    edit_table(
        study.path / "participants.csv",
        lambda rows: set_cell(
            rows, next(c for c in rows[0] if c.startswith("threshold_db")), "-31.5"
        ),
    )


@cheat("the state in participants.csv is edited")
def _(study: StudyFolder) -> None:
    edit_table(study.path / "participants.csv", lambda rows: set_cell(rows, "state", "released"))


@cheat("a participant is left out of participants.csv")
def _(study: StudyFolder) -> None:
    edit_table(study.path / "participants.csv", lambda rows: rows.pop(1))


@cheat("an age in answers.csv is edited")
def _(study: StudyFolder) -> None:
    edit_table(study.path / "answers.csv", lambda rows: set_cell(rows, "answer", "17"))


@cheat("a number in results.json is edited")
def _(study: StudyFolder) -> None:
    path = study.report / "results.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    number = next(one for one in content["numbers"] if isinstance(one["value"], float))
    number["value"] *= 1.5
    path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


@cheat("a number in results.json is edited after an analysis that was killed", is_data=False)
def _(study: StudyFolder) -> None:
    take_checkpoint(study, "before analyze", now=now)
    CHEATS["a number in results.json is edited"].act(study)


@cheat("the headline of the report's page is edited")
def _(study: StudyFolder) -> None:
    path = study.report / "index.html"
    headline = json.loads((study.report / "results.json").read_text(encoding="utf-8"))["headline"]
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace(headline[-25:], "so it is."), encoding="utf-8")


@cheat("a table of the report is edited")
def _(study: StudyFolder) -> None:
    path = min(study.report.glob("tables/*.csv"))
    path.write_text(path.read_text(encoding="utf-8").replace("1", "2", 1), encoding="utf-8")


# Stimuli, settings, rig, methods.


@cheat("a match in manifest.csv is edited")
def _(study: StudyFolder) -> None:
    edit_table(study.manifest, lambda rows: set_cell(rows, "spectral_match", "0.99"))


@cheat("the recipe in manifest.json is edited")
def _(study: StudyFolder) -> None:
    path = study.stimuli / "manifest.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    content["recipe"]["seed"] = 999
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")


@cheat("the units in manifest.json are edited")
def _(study: StudyFolder) -> None:
    path = study.stimuli / "manifest.json"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("m/s", "g", 1), encoding="utf-8")


@cheat("a WAV is exchanged")
def _(study: StudyFolder) -> None:
    wav = min(study.stimuli.glob("*.wav"))
    wav.write_bytes(wav.read_bytes()[:-4] + b"\x01\x00\x00\x00")


@cheat("a WAV is exchanged, with manifest, plans and headers", TABLES)
def _(study: StudyFolder) -> None:
    wav = min(study.stimuli.glob("*.wav"))
    old = hashlib.sha256(wav.read_bytes()).hexdigest()
    wav.write_bytes(wav.read_bytes()[:-4] + b"\x01\x00\x00\x00")
    new = hashlib.sha256(wav.read_bytes()).hexdigest()
    for path in (study.manifest, study.stimuli / "manifest.json"):
        path.write_bytes(path.read_bytes().replace(old.encode(), new.encode()))
    sha256 = read_stimuli(study.stimuli).sha256
    for own in study.participants:
        reseal(own / "plan.json", lambda plan: plan.update(stimuli_sha256=sha256))
        edit_header(study, own.name, stimuli_sha256=sha256)
        follow_plan(study, own.name)


@cheat("limits of the analysis in study.toml are changed afterwards")
def _(study: StudyFolder) -> None:
    replace_text(study.settings, "draws = 100", "draws = 51\nmargin = 20.0")


@cheat("the texts of participants are changed afterwards")
def _(study: StudyFolder) -> None:
    replace_text(study.path / "texts.toml", "#", "# changed\n#")


@cheat("the code of a screening rule is changed afterwards")
def _(study: StudyFolder) -> None:
    replace_text(study.path / "methods" / "strict.py", "0.5", "0.05")


@cheat("the rig's full scale is changed afterwards", is_real=True)
def _(study: StudyFolder) -> None:
    replace_text(study.rig, "full_scale_m_s2 = 500.0", "full_scale_m_s2 = 250.0")


@cheat("a certificate is exchanged and sealed", DIGESTS, is_real=True)
def _(study: StudyFolder) -> None:
    path = min(study.calibration.glob("*.json"))
    path.write_text(path.read_text(encoding="utf-8").replace("2026", "2025"), encoding="utf-8")


@cheat("a delivered recording is exchanged", is_real=True)
def _(study: StudyFolder) -> None:
    path = folder(study, "p01") / "delivered" / "0001.wav"
    path.write_bytes(path.read_bytes()[:-4] + b"\x01\x00\x00\x00")


@cheat("a delivered recording is exchanged, with its digest in the journal", TABLES, is_real=True)
def _(study: StudyFolder) -> None:
    path = folder(study, "p01") / "delivered" / "0001.wav"
    path.write_bytes(path.read_bytes()[:-4] + b"\x01\x00\x00\x00")
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    edit_record(
        journal(study, "p01"), "played", lambda data: {**data, "delivered_sha256": sha256}, number=0
    )


@cheat("times of files are changed", is_data=False)
def _(study: StudyFolder) -> None:
    for path in study.path.rglob("*"):
        os.utime(path, (1, 1))
