"""Ways to falsify a finished study, each a function on its folder.

Who cheats is well informed: digests are mended, tables are made anew so that they agree (`mend`), and the evidence in
the folder is made anew (`begin_anew`). Only a remote is out of reach.
"""

import csv
import hashlib
import io
import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.evidence.checkpoints import take_checkpoint
from feel321.study.folder import StudyFolder
from feel321.study.participants.answers import write_answers
from feel321.study.participants.roster import Tombstone, write_roster, write_tombstone
from feel321.study.ratings import write_matches, write_ratings
from feel321.study.session import journal as journals
from feel321.study.simulate import simulate_study
from feel321.study.withdrawal import withdraw_participant

Records = list[journals.Record]


@dataclass(frozen=True)
class Cheat:
    """is_real: of the study that was run on a rig; is_data: whether it changes what the data say."""

    act: Callable[[StudyFolder], object]
    mend: bool = False
    is_data: bool = True
    is_real: bool = False


def now() -> datetime:
    return datetime.now(UTC)


def journal(study: StudyFolder, name: str = "sim001") -> Path:
    return study.sessions / name / "session-01.jsonl"


def chain(path: Path, records: Records) -> None:
    """Write records as a chain that holds, whatever they say."""
    content, tip = b"", journals.START
    for sequence, record in enumerate(records):
        line = journals.write_line(replace(record, sequence=sequence), tip)
        content, tip = content + line, journals.digest(line.rstrip(b"\n"))
    path.write_bytes(content)


def rewrite(
    change: Callable[[Records], Records], name: str = "sim001"
) -> Callable[[StudyFolder], None]:
    """Write a journal anew as it would be had other things happened."""

    def act(study: StudyFolder) -> None:
        path = journal(study, name)
        chain(path, change(list(journals.read_journal(path).records)))

    return act


def edit(
    event: str, change: Callable[[dict[str, Any]], object], number: int = -1, name: str = "sim001"
) -> Callable[[StudyFolder], None]:
    """Change what one record of an event holds."""

    def turn(records: Records) -> Records:
        place = [place for place, one in enumerate(records) if one.event == event][number]
        data = json.loads(json.dumps(records[place].data))
        change(data)
        records[place] = replace(records[place], data=data)
        return records

    return rewrite(turn, name)


def rate_better(data: dict[str, Any]) -> None:
    for part, value in data["values"].items():
        if isinstance(value, float):
            data["values"][part] = min(value + 7.5, 100.0) if value <= 92 else 61.25


def reverse_all(records: Records) -> Records:
    for record in records:
        values = record.data.get("values", {})
        if record.event == "rated" and all(isinstance(one, float) for one in values.values()):
            values.update({part: 100.0 - value for part, value in values.items()})
    return records


def exchange_answers(records: Records) -> Records:
    rated = [one for one in records if one.event == "rated" and "test" in one.data["values"]]
    first, second = (dict(one.data["values"]) for one in rated[-2:])
    rated[-2].data["values"].update(second)
    rated[-1].data["values"].update(first)
    return records


def shift_ratings(records: Records) -> Records:
    """Give every trial the rating of the one before."""
    rated = [one for one in records if one.event == "rated" and "test" in one.data["values"]]
    values = [one.data["values"]["test"] for one in rated]
    for record, value in zip(rated, [values[-1], *values[:-1]], strict=True):
        record.data["values"]["test"] = value
    return records


def shift_times(records: Records) -> Records:
    """Set the time of day two hours ahead, from the first answer on."""
    first = next(place for place, one in enumerate(records) if one.event == "rated")
    for place, record in enumerate(records[first:], start=first):
        late = datetime.fromisoformat(record.utc) + timedelta(hours=2)
        records[place] = replace(record, utc=late.isoformat(timespec="milliseconds"))
    return records


def spoil(records: Records) -> Records:
    place = max(n for n, one in enumerate(records) if one.event == "rated")
    data = {name: records[place].data[name] for name in ("trial", "attempt", "time_s")}
    spoiled = replace(records[place], event="spoiled", data=data | {"flags": ["device_error"]})
    return [*records[:place], spoiled, *records[place:]]


def append(event: str, data: dict[str, Any]) -> Callable[[StudyFolder], None]:
    return rewrite(lambda records: [*records, replace(records[-1], event=event, data=data)])


def edit_answer(study: StudyFolder) -> None:
    path = study.sessions / "sim001" / "personal.jsonl"
    row, *rest = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    place = [row[name] for name in row if name not in {"salt", "sha256", "value"}]
    old, row["value"] = row["sha256"], 44
    own = json.dumps([row["salt"], "sim001", *place, row["value"]]).encode()
    row["sha256"] = hashlib.sha256(own).hexdigest()
    path.write_text("".join(json.dumps(one) + "\n" for one in (row, *rest)), encoding="utf-8")
    edited = journal(study).read_text(encoding="utf-8").replace(old, row["sha256"])
    records = [json.loads(line) for line in edited.splitlines()]
    chain(journal(study), [
        journals.Record(one["sequence"], one["utc"], one["event"], one["data"]) for one in records
    ])  # fmt: skip


def cut(study: StudyFolder, tail: bytes = b"") -> None:
    lines = journal(study).read_bytes().splitlines(keepends=True)
    journal(study).write_bytes(b"".join(lines[:-6]) + tail)


def remove(*names: str) -> Callable[[StudyFolder], None]:
    def act(study: StudyFolder) -> None:
        for path in (study.path / name for name in names):
            shutil.rmtree(path) if path.is_dir() else path.unlink()

    return act


def exchange(*names: str) -> Callable[[StudyFolder], None]:
    """Exchange a file or a folder of two participants."""

    def act(study: StudyFolder) -> None:
        one, other = (study.sessions / name for name in names)
        one.rename(study.path / "between")
        other.rename(one)
        (study.path / "between").rename(other)

    return act


def reseal(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change a plan and mend its digest."""
    body, _, _ = path.read_bytes().rpartition(b',\n "sha256"')
    entry = json.loads(body + b"\n}")
    change(entry)
    text = json.dumps(entry, indent=1, ensure_ascii=False).encode().removesuffix(b"\n}")
    path.write_bytes(
        text + b',\n "sha256": "' + journals.digest(text + b"\n}").encode() + b'"\n}\n'
    )


def edit_plan(
    change: Callable[[dict[str, Any]], object], name: str = "sim001", **header: Any
) -> Callable[[StudyFolder], None]:
    """Change a plan, mend its digest, and let the journal's header name it."""

    def act(study: StudyFolder) -> None:
        path = study.sessions / name / "plan.json"
        reseal(path, change)
        sha256 = json.loads(path.read_bytes())["sha256"]
        edit("begun", lambda data: data.update(plan_sha256=sha256, **header), 0, name)(study)

    return act


def copy_as(study: StudyFolder, old: str, new: str, number: int) -> None:
    shutil.copytree(study.sessions / old, study.sessions / new)
    edit_plan(lambda plan: plan.update(participant=new, number=number), new, participant=new)(study)


def make_anew(study: StudyFolder) -> None:
    remove("sessions", "ratings.csv", "participants.csv", "answers.csv")(study)
    simulate_study(study, participants=3, seed=77, now=now)


def forge_tombstone(study: StudyFolder) -> None:
    anchor = journals.read_anchor(journal(study, "sim002"))
    shutil.rmtree(study.sessions / "sim002")
    (study.sessions / "sim002").mkdir()
    stone = Tombstone("sim002", 2, True, now().isoformat(), "asked to", (anchor,), "removed")
    write_tombstone(study.sessions / "sim002", stone)


def edit_table(
    name: str, change: Callable[[list[list[str]]], object]
) -> Callable[[StudyFolder], None]:
    def act(study: StudyFolder) -> None:
        path = study.path / name
        rows = list(csv.reader(io.StringIO(path.read_text(encoding="utf-8"), newline="")))
        change(rows)
        text = io.StringIO(newline="")
        csv.writer(text).writerows(rows)
        path.write_text(text.getvalue(), encoding="utf-8", newline="")

    return act


def set_cell(name: str, column: str, value: str, line: int = 1) -> Callable[[StudyFolder], None]:
    def change(rows: list[list[str]]) -> None:
        place = next(n for n, one in enumerate(rows[0]) if one.startswith(column))
        rows[line][place] = value

    return edit_table(name, change)


def drop_slowest(rows: list[list[str]]) -> None:
    place = rows[0].index("response_time_s")
    slowest = sorted(rows[1:], key=lambda row: float(row[place]))[-len(rows) // 10 :]
    rows[:] = [row for row in rows if row not in slowest]


def replace_text(pattern: str, old: str, new: str) -> Callable[[StudyFolder], None]:
    def act(study: StudyFolder) -> None:
        path = min(study.path.glob(pattern))
        text = path.read_text(encoding="utf-8")
        assert old in text, path
        path.write_text(text.replace(old, new, 1), encoding="utf-8")

    return act


def change_bytes(path: Path) -> str:
    """Change a sample of a WAV; returns its new digest."""
    path.write_bytes(path.read_bytes()[:-4] + b"\x01\x00\x00\x00")
    return hashlib.sha256(path.read_bytes()).hexdigest()


def exchange_wave_everywhere(study: StudyFolder) -> None:
    wav = min(study.stimuli.glob("*.wav"))
    old = hashlib.sha256(wav.read_bytes()).hexdigest()
    new = change_bytes(wav)
    for path in (study.manifest, study.stimuli / "manifest.json"):
        path.write_bytes(path.read_bytes().replace(old.encode(), new.encode()))
    sha256 = read_stimuli(study.stimuli).sha256
    for own in study.participants:
        change = edit_plan(
            lambda plan: plan.update(stimuli_sha256=sha256), own.name, stimuli_sha256=sha256
        )
        change(study)


def exchange_delivered(study: StudyFolder) -> None:
    sha256 = change_bytes(study.sessions / "p01" / "delivered" / "0001.wav")
    edit("played", lambda data: data.update(delivered_sha256=sha256), 0, "p01")(study)


def edit_number(study: StudyFolder) -> None:
    path = study.report / "results.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    number = next(one for one in content["numbers"] if isinstance(one["value"], float))
    number["value"] *= 1.5
    path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def kill_analysis_and_edit(study: StudyFolder) -> None:
    take_checkpoint(study, "before analyze", now=now)
    edit_number(study)


def link(study: StudyFolder) -> None:
    target = study.path.parent / "elsewhere"
    shutil.rmtree(target, ignore_errors=True)
    (study.sessions / "sim001").rename(target)
    (study.sessions / "sim001").symlink_to(target)


CHEATS: dict[str, Cheat] = {
    "a rating is edited": Cheat(edit("rated", rate_better), mend=True),
    "all ratings of a participant are reversed": Cheat(rewrite(reverse_all), mend=True),
    "ratings are shifted by a trial": Cheat(rewrite(shift_ratings), mend=True),
    "two answers are exchanged": Cheat(rewrite(exchange_answers), mend=True),
    "a response time is edited": Cheat(
        edit("rated", lambda data: data.update(response_time_s=data["response_time_s"] + 1.5)),
        mend=True,
    ),
    "a rating is marked as rejected": Cheat(edit("rated", lambda data: data.update(rejected=True)), mend=True),
    "the flags of an answer are changed": Cheat(
        edit("rated", lambda data: data.update(flags=["underrun"])), mend=True
    ),
    "an answer to a question is edited": Cheat(edit_answer, mend=True),
    "the times of day are edited": Cheat(rewrite(shift_times), mend=True),
    "the times of day are edited in a session with people": Cheat(
        rewrite(shift_times, "p01"), mend=True, is_real=True
    ),
    "records are put into another order": Cheat(
        rewrite(lambda own: [*own[:-4], own[-3], own[-4], *own[-2:]]), mend=True
    ),
    "an attempt that was spoiled is invented": Cheat(rewrite(spoil), mend=True),
    "a note is put in": Cheat(append("note", {"text": "was tired"}), mend=True),
    "a finished session is shown as released": Cheat(append("released", {}), mend=True),
    "the last lines of a journal are cut off": Cheat(cut, mend=True),
    "a journal is cut, as if a crash had torn it": Cheat(lambda study: cut(study, b'{"sequence": 9'), mend=True),
    "a journal is emptied": Cheat(lambda study: journal(study).write_bytes(b""), mend=True),
    "a journal is removed": Cheat(remove("sessions/sim001/session-01.jsonl")),
    "a participant is removed everywhere": Cheat(remove("sessions/sim002"), mend=True),
    "sessions/ and the roster are removed": Cheat(remove("sessions", "participants.csv")),
    "two participants exchange their folders": Cheat(exchange("sim001", "sim002")),
    "two participants exchange their journals": Cheat(
        exchange("sim001/session-01.jsonl", "sim002/session-01.jsonl"), mend=True
    ),
    "a session is copied under another code": Cheat(lambda study: copy_as(study, "sim002", "sim009", 9), mend=True),
    "a participant's folder is a link": Cheat(link, is_data=False),
    "a second session is put beside the first": Cheat(
        lambda study: shutil.copy(journal(study), journal(study).with_name("session-02.jsonl"))
    ),
    "a rehearsal is taken for a session": Cheat(
        edit("begun", lambda data: data["presenter"].update(rehearsal=True), 0, "p01"),
        mend=True, is_real=True,
    ),
    "a simulated participant is passed as real": Cheat(
        edit_plan(
            lambda plan: plan.update(simulated=False),
            presenter={"simulated": False, "rehearsal": False, "rig": None},
        ),
        mend=True,
    ),
    "the whole study is made anew with another seed": Cheat(make_anew, mend=True),
    "the rules of a plan are changed": Cheat(
        edit_plan(lambda plan: plan["flow"].update(min_response_s=0.01)), mend=True
    ),
    "the group of a participant is changed": Cheat(
        edit_plan(lambda plan: plan.update(number=plan["number"] + 5)), mend=True
    ),
    "a bad rater is withdrawn, by the verb": Cheat(
        lambda study: withdraw_participant(study, "sim002", now=now), is_data=False
    ),
    "a tombstone is forged": Cheat(forge_tombstone, mend=True),
    "a cell of ratings.csv is edited": Cheat(set_cell("ratings.csv", "rating", "99.5", 3)),
    "the slowest tenth of ratings.csv is left out": Cheat(edit_table("ratings.csv", drop_slowest)),
    "the last row of ratings.csv is left out": Cheat(edit_table("ratings.csv", list.pop)),
    "a row of ratings.csv stands there twice": Cheat(edit_table("ratings.csv", lambda rows: rows.append(rows[2]))),
    "a threshold in participants.csv is edited": Cheat(set_cell("participants.csv", "threshold_db", "-31.5")),
    "an age in answers.csv is edited": Cheat(set_cell("answers.csv", "answer", "17")),
    "a number in results.json is edited": Cheat(edit_number),
    "a number is edited after an analysis that was killed": Cheat(kill_analysis_and_edit, is_data=False),
    "the page of the report is edited": Cheat(replace_text("report/index.html", "<h1", "<h1 ")),
    "a table of the report is edited": Cheat(replace_text("report/tables/*.csv", "1", "2")),
    "a match in manifest.csv is edited": Cheat(set_cell("stimuli/manifest.csv", "spectral_match", "0.99")),
    "the units in manifest.json are edited": Cheat(replace_text("stimuli/manifest.json", "m/s", "g")),
    "a WAV is exchanged everywhere": Cheat(exchange_wave_everywhere, mend=True),
    "settings of the analysis are changed afterwards": Cheat(
        replace_text("study.toml", "draws = 100", "draws = 51\nmargin = 20.0")
    ),
    "the texts of participants are changed afterwards": Cheat(
        replace_text("texts.toml", "#", "# changed\n#")
    ),
    "the code of a metric is changed afterwards": Cheat(replace_text("methods/strict.py", "0.5", "0.05")),
    "the rig's full scale is changed afterwards": Cheat(
        replace_text("rig.toml", "full_scale_m_s2 = 500.0", "full_scale_m_s2 = 250.0"),
        is_real=True,
    ),
    "a certificate is exchanged": Cheat(replace_text("calibration/*.json", "2026", "2025"), is_real=True),
    "a delivered recording is exchanged, with its digest": Cheat(exchange_delivered, mend=True, is_real=True),
}  # fmt: skip


def falsify(study: StudyFolder, cheat: Cheat) -> None:
    """Falsify a study, and make tables and evidence agree with it."""
    cheat.act(study)
    if cheat.mend:
        with suppress(ValueError):  # of journals that no longer make sense
            stimuli = read_stimuli(study.stimuli)
            write_roster(study)
            write_ratings(study, stimuli)
            write_matches(study, stimuli)
            write_answers(study)
    if cheat.is_data:
        shutil.rmtree(study.path / ".evidence", ignore_errors=True)
        take_checkpoint(study, "seal", remote=str(study.path.parent / "remote.git"), now=now)
