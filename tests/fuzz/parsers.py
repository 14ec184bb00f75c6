"""Every parser: what turns bytes from outside into objects, and the valid files that fuzzing starts from.

A parser reads one file of a scratch folder; `beside` names what of the seed study lies beside it. `dress` makes a file
of an input: it seals what carries a digest or a checksum, for else every change would end there.
"""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import shutil
import sqlite3
import struct
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from feel321.analysis import published
from feel321.analysis.mixed.design import build_design
from feel321.analysis.table import metrics, roster, sheets
from feel321.analysis.table.reading import read_table
from feel321.analysis.tradeoff.benchmark import card, leaderboard
from feel321.extensions import split_command
from feel321.files import write_text
from feel321.protocols.texts import list_borrowed, make_scales, read_pages, read_texts
from feel321.stimuli import port, wav
from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.sets.build import read_history
from feel321.stimuli.sets.manifest import check_stimuli, find_methods, read_stimuli
from feel321.study import collect, folder, server
from feel321.study.actuator import certificate, rig
from feel321.study.auditing.study import audit_study
from feel321.study.cli import feel321
from feel321.study.commands import signals
from feel321.study.ledger import progress, rigs, slots
from feel321.study.monitor.hand import BrowserWindow
from feel321.study.monitor.server import Door, make_app
from feel321.study.persons.answers import read_answers
from feel321.study.ratings import read_judgements
from feel321.study.session import journal, plan
from feel321.study.settings import read as settings
from feel321.study.settings.edit import change_settings
from tests.fuzz import seeds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping


def _unchanged(content: bytes) -> bytes:
    return content


@dataclass(frozen=True)
class Parser:
    """One way of reading bytes.

    file: under which name they lie in the scratch folder. beside: parts of the seed study that are copied there. write:
    writes a value again, where the product can. lines: of a message, at most: a settings' file lists all its faults.
    typed: by whom the message is for, who may see the own words again as they are. bounded: in memory.
    """

    read: Callable[[Path], object]
    seeds: Callable[[Path], list[bytes]]
    file: str
    beside: tuple[str, ...] = ()
    dress: Callable[[bytes], bytes] = _unchanged
    write: Callable[[Any, Path], object] | None = None
    lines: int = 1
    typed: bool = False
    bounded: bool = True

    def prepare(self, scratch: Path, study: Path) -> Path:
        """Lay out the scratch folder, and return where the input goes."""
        for name in self.beside:
            source, target = study / name, scratch / name
            target.parent.mkdir(parents=True, exist_ok=True)
            copy = shutil.copytree if source.is_dir() else shutil.copy
            copy(source, target)
        (scratch / self.file).parent.mkdir(parents=True, exist_ok=True)
        return scratch / self.file


# Where the seeds are.


def of(*patterns: str) -> Callable[[Path], list[bytes]]:
    """Take files of the seed study."""
    return lambda study: [p.read_bytes() for one in patterns for p in sorted(study.glob(one))]


def given(*contents: bytes) -> Callable[[Path], list[bytes]]:
    return lambda _study: list(contents)


def lazily(make: Callable[[], Iterable[bytes]]) -> Callable[[Path], list[bytes]]:
    return lambda _study: list(make())


def first_lines(path: str, n: int) -> Callable[[Path], list[bytes]]:
    return lambda study: [b"".join(next(study.glob(path)).read_bytes().splitlines(True)[:n])]


# How inputs become files whose digests are right.


def seal_plan(body: bytes) -> bytes:
    return plan._seal(body)


def take_plan(study: Path) -> list[bytes]:
    content = (study / "sessions/sim001/plan.json").read_bytes()
    return [content.rpartition(plan._SEAL)[0] + b"\n}"]


def seal_json(entry: bytes, digest: Callable[[dict[str, Any]], str]) -> bytes:
    """Give a JSON object the digest of its content; what is no object stays as it is."""
    with contextlib.suppress(ValueError, TypeError, RecursionError, AttributeError, KeyError):
        content = json.loads(entry)
        content.pop("sha256", None)
        return json.dumps({**content, "sha256": digest(content)}).encode()
    return entry


def chain_lines(content: bytes) -> bytes:
    """Make a journal of lines of which only event, data and time count: the chain is forged anew."""
    lines, previous = [], journal.START
    for number, line in enumerate(content.split(b"\n")):
        with contextlib.suppress(ValueError, TypeError, RecursionError, KeyError):
            entry = json.loads(line)
            record = journal.Record(number, entry["utc"], entry["event"], entry["data"])
            lines.append(journal.write_line(record, previous))
            previous = journal.digest(lines[-1].rstrip(b"\n"))
    return b"".join(lines)


KINDS = (("<q", int), ("<d", float))


def change_cell(content: bytes, database: bytes) -> bytes:
    """Put a value of any type into a cell of the ledger: the first three bytes say where and of which type."""
    if len(content) < 3:
        return database
    at, raw = content[:3], content[3:]
    value: object = None
    if at[2] % 5 < 2:
        value = struct.unpack(KINDS[at[2] % 5][0], raw[:8].ljust(8, b"\0"))[0]
    elif at[2] % 5 < 4:
        value = raw.decode("utf-8", "replace") if at[2] % 5 == 2 else raw
    with contextlib.closing(sqlite3.connect(":memory:")) as connection:
        connection.deserialize(database)
        connection.execute("PRAGMA writable_schema = ON")
        table = ("participants", "anchors")[at[0] % 2]
        columns = [row[1] for row in connection.execute(f"PRAGMA table_info({table})")]
        with contextlib.suppress(sqlite3.Error):
            connection.execute(
                f"UPDATE {table} SET {columns[at[1] % len(columns)]} = ? WHERE rowid = 1",  # noqa: S608 - our own names
                (value,),
            )
            connection.commit()
        return connection.serialize()


@cache
def _seed_ledger() -> bytes:
    with contextlib.closing(sqlite3.connect(":memory:")) as connection:
        connection.executescript(LEDGER)
        return connection.serialize()


LEDGER = """
CREATE TABLE participants (participant VARCHAR NOT NULL, simulated BOOLEAN NOT NULL, number INTEGER NOT NULL,
state VARCHAR NOT NULL, done INTEGER NOT NULL, total INTEGER NOT NULL, claimed_utc VARCHAR NOT NULL,
PRIMARY KEY (participant));
CREATE TABLE anchors (participant VARCHAR NOT NULL, journal VARCHAR NOT NULL, lines INTEGER NOT NULL, tip VARCHAR NOT
NULL, PRIMARY KEY (participant, journal));
INSERT INTO participants VALUES ('sim001', 1, 1, 'finished', 4, 4, '2026-03-01T12:00:00+00:00');
INSERT INTO anchors VALUES ('sim001', 'session-01.jsonl', 3, 'ab');
"""


# What reads them.


def read_sidecar(path: Path) -> object:
    return read_recording(path.with_suffix(".wav"))


def read_study_toml(path: Path) -> object:
    found = settings.read_settings(path)
    server.find_server(path)
    settings.find_conflicts(found)
    return found


def read_texts_toml(path: Path) -> object:
    texts = read_texts(path)
    return make_scales(texts), read_pages(path), list_borrowed(path)


def read_people(path: Path) -> object:
    rows = pd.DataFrame({"participant": ["sim001", "sim002"]})
    ratings = path.with_name("ratings.csv")
    return roster.join_labels(rows, ratings), roster.join_rigs(rows, ratings)


def read_means(path: Path) -> object:
    return published.read_matrix(path) if published.is_matrix(path) else published._read_means(path)


def read_ratings_csv(path: Path) -> object:
    return read_table(path, path.parent / "stimuli" / "manifest.csv")


def read_manifest_csv(path: Path) -> object:
    return check_stimuli(path.parent), read_table(path.parents[1] / "rated.csv", path)


def read_manifest_json(path: Path) -> object:
    methods = find_methods(path.parent), read_history(path.parent)
    known = metrics.gather_info(["gain"], None, path.with_name("manifest.csv"))
    return methods, known, folder.read_origin(path.parent)


def read_participant(path: Path) -> object:
    """Read a participant's folder in all ways; what the audit finds is words, never an exception."""
    home = path.parent
    study = folder.StudyFolder(home.parents[1])
    findings = audit_study(study)
    assert all(isinstance(finding, str) for finding in findings)
    collect.read_holding(home)
    progress.read_progress(home)
    rows = read_judgements(home, read_stimuli(study.stimuli)), list(read_answers(home))
    return findings, rows, list(progress.list_notes(plan.read_dossier(home).chains))


def read_ledger(path: Path) -> object:
    study = folder.StudyFolder(path.parents[1])
    entries = slots.read_study_ledger(study)
    return entries, slots.find_lost(study)


def read_own_plan(path: Path) -> plan.Plan:
    found = plan.require_plan(path)
    plan.compare_plans(found, found)
    return found


def read_header_rig(path: Path) -> object:
    """Read the rig of a journal's header: JSON that was parsed before."""
    try:
        entry = json.loads(path.read_bytes())
    except RecursionError:
        return None
    return rigs.digest_settings.__wrapped__(json.dumps(entry)) if isinstance(entry, dict) else None


def read_arrays(path: Path) -> object:
    entry = json.loads(path.with_suffix(".json").read_bytes())
    facts = {
        name: value
        for name, value in entry.items()
        if name not in {"format", "sha256", "arrays_sha256"}
    }
    return certificate._unpack(facts, path.read_bytes(), seal="")


def read_chain_file(path: Path) -> journal.Chain:
    return journal.read_chain(path.read_bytes(), path.name)


FRAME = pd.DataFrame({
    "y": np.arange(12.0), "a": np.sin(np.arange(12.0)), "b": np.arange(12.0) % 5, "k": list("uvw") * 4,
    "g": list("aabb") * 3, "h": list("abcd") * 3,
})  # fmt: skip


def read_formula(path: Path) -> object:
    return build_design(path.read_bytes().decode("utf-8", "replace"), FRAME)


def read_arguments(path: Path) -> object:
    """Take the words of a command line as far as click and our checks go, without doing what they ask for."""
    import click

    verb, *words = path.read_bytes().decode("utf-8", "replace").split("\0")
    if verb not in feel321.commands:
        return None
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            return feel321.commands[verb].make_context(verb, words).params
    except click.exceptions.Exit:
        return None
    except click.ClickException as error:
        raise ValueError(error.format_message()) from None


TOKEN = "t" * 32
WINDOW = BrowserWindow(lambda: 0.0)


@cache
def _app() -> Any:
    pages = {"/": lambda _nonce, query: ("text/html", str(len(query)))}
    return make_app(Door("127.0.0.1", 8321, TOKEN), pages, {"/act": WINDOW.take})


def read_request(path: Path) -> object:
    """Ask the monitor's site; whatever is asked, it answers, and never with an error of its own."""
    head, _, body = path.read_bytes().replace(b"@", TOKEN.encode()).partition(b"\n\n")
    first, *lines = head.split(b"\n")
    method, target, *_ = [*first.split(b" "), b"", b""]
    place, _, query = target.partition(b"?")
    pairs = (line.partition(b":") for line in lines)
    scope = {
        "type": "http", "method": method.decode("latin-1"), "path": place.decode("utf-8", "replace"), "raw_path": place,
        "query_string": query, "headers": [(n.strip().lower(), v.strip()) for n, _, v in pairs], "root_path": "",
        "scheme": "http", "http_version": "1.1", "client": ("127.0.0.1", 1), "server": ("127.0.0.1", 8321),
    }  # fmt: skip
    sent: list[Mapping[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": body, "more_body": False}

    async def send(message: Mapping[str, Any]) -> None:
        sent.append(message)

    asyncio.run(_app()(scope, receive, send))
    status = sent[0]["status"]
    assert status in {200, 204, 403, 413}, status
    return status


def read_act(path: Path) -> object:
    return WINDOW.take(path.read_bytes())


def read_command(path: Path) -> object:
    text = path.read_bytes().decode("utf-8", "replace")
    return split_command("reducer", "mine", text)


def edit_study(path: Path) -> object:
    text = path.read_bytes().decode("utf-8", "replace")
    return change_settings(text, {"session.repeats": 2, "study.name": "another"})


# How values are written again.


def write_own_plan(value: plan.Plan, path: Path) -> None:
    path.unlink()
    plan.create_plan(path, value)


def write_lines(value: journal.Chain, path: Path) -> None:
    lines, previous = [], journal.START
    for record in value.records:
        lines.append(journal.write_line(record, previous))
        previous = journal.digest(lines[-1].rstrip(b"\n"))
    path.write_bytes(b"".join(lines) + value.torn)


def write_own_card(value: card.Card, path: Path) -> None:
    write_text(path, card.format_card(value))


def write_tomb(value: progress.Tombstone, path: Path) -> None:
    progress.write_tombstone(path.parent, value)


LMT = "G1_Movement_X_train1.txt"
PERSON = ("study.toml", "stimuli", "sessions")
TOMB = "sessions/sim003/withdrawn.json"

PARSERS: dict[str, Parser] = {
    "wav": Parser(
        wav.read_wav, lazily(seeds.make_wavs), "a.wav", write=lambda v, p: wav.write_wav(p, *v)
    ),
    "recording.wav": Parser(read_recording, lazily(seeds.make_wavs), "a.wav"),
    "recording.npz": Parser(read_recording, lazily(lambda: [seeds.make_npz()]), "a.npz"),
    "recording.npz, packed": Parser(
        read_recording,
        lazily(lambda: [seeds.make_npy(seeds.make_signal())]),
        "a.npz",
        dress=seeds.wrap_npy,
    ),
    "recording.npy": Parser(
        partial(read_recording, rate_hz=1000, unit="g"),
        lazily(lambda: [seeds.make_npy(seeds.make_signal())]),
        "a.npy",
    ),
    "recording.mat": Parser(read_recording, lazily(seeds.make_mats), "a.mat"),
    "recording.csv": Parser(
        partial(read_recording, rate_hz=1000, unit="g", resample=True),
        lazily(seeds.make_tables),
        "a.csv",
    ),
    "recording.csv, columns": Parser(
        partial(read_recording, rate_hz=1000, unit="g", columns=("x", "y", "z")),
        lazily(seeds.make_tables),
        "a.csv",
    ),
    "recording.xml": Parser(read_recording, lazily(lambda: [seeds.make_hatt()]), "a.xml"),
    "recording.txt, LMT": Parser(
        partial(read_recording, unit="g"),
        given(b"0.5\n-1.25\n3e-2\n", b"1,5\r\n2,5\r\n-4,0\r\n"),
        LMT,
        tuple(LMT.replace("_X_", f"_{axis}_") for axis in "YZ"),
    ),
    "recording.ide": Parser(read_recording, lazily(seeds.make_ides), "a.ide"),
    "sidecar.json": Parser(
        read_sidecar,
        given(seeds.SIDECAR, b'{"full_scale": 160, "unit": "g"}'),
        "a.json",
        ("a.wav",),
    ),
    "sidecar.toml": Parser(
        read_sidecar,
        given(b'unit = "g"\nrate_hz = 1000.0\naxes = ["z", "y", "x"]\n'),
        "a.toml",
        ("a.wav",),
    ),
    "sidecar of reduce": Parser(
        signals._read_sidecar,
        given(b'{"recording_sha256": "ab", "reducer": "dft321", "conditioning": {}}'),
        "a.json",
    ),
    "study.toml": Parser(
        read_study_toml, of("study.toml", "template.toml"), "study.toml", lines=100
    ),
    "study.toml, edited": Parser(edit_study, of("study.toml", "template.toml"), "study.toml"),
    "rig.toml": Parser(rig.read_rig, of("rig.toml", "rig_all.toml"), "rig.toml", lines=100),
    "rig of a header": Parser(read_header_rig, of("rig.json"), "rig.json"),
    "texts.toml": Parser(read_texts_toml, of("texts.toml"), "texts.toml", lines=100),
    "manifest.csv": Parser(
        read_manifest_csv,
        of("stimuli/manifest.csv"),
        "stimuli/manifest.csv",
        ("stimuli", "rated.csv"),
    ),
    "manifest.json": Parser(
        read_manifest_json,
        of("stimuli/manifest.json"),
        "stimuli/manifest.json",
        ("stimuli/manifest.csv",),
    ),
    "ratings.csv": Parser(
        read_ratings_csv, of("rated.csv", "ratings.csv"), "ratings.csv", ("stimuli",)
    ),
    "ratings.parquet": Parser(
        sheets.open_parquet, lazily(lambda: [seeds.make_parquet()]), "ratings.parquet"
    ),
    "participants.csv": Parser(
        read_people, of("participants.csv", "people.csv"), "participants.csv"
    ),
    "published.csv": Parser(read_means, given(seeds.MATRIX, seeds.MEANS), "published.csv"),
    "journal": Parser(
        read_chain_file,
        first_lines("sessions/sim001/session-01.jsonl", 6),
        "session-01.jsonl",
        write=write_lines,
    ),
    "journal, chained": Parser(
        read_participant,
        lambda study: [
            *first_lines("sessions/sim001/session-01.jsonl", 14)(study),
            *of("sessions/sim001/*.jsonl")(study),
        ],
        "sessions/sim001/session-01.jsonl",
        PERSON,
        dress=chain_lines,
    ),
    "plan.json": Parser(
        read_own_plan,
        of("sessions/sim001/plan.json"),
        "sessions/sim001/plan.json",
        ("study.toml",),
        write=write_own_plan,
    ),
    "plan.json, sealed": Parser(
        read_participant, take_plan, "sessions/sim001/plan.json", PERSON, dress=seal_plan
    ),
    "withdrawn.json": Parser(
        lambda path: progress.read_tombstone(path.parent),
        of(TOMB),
        TOMB,
        write=write_tomb,
        dress=partial(seal_json, digest=progress._digest),
    ),
    "certificate.json": Parser(
        certificate.read_certificate,
        of("calibration/*.json"),
        "calibration/c.json",
        ("calibration/c.npz",),
        dress=partial(seal_json, digest=certificate._seal),
    ),
    "certificate.npz": Parser(
        read_arrays, of("calibration/c.npz"), "calibration/c.npz", ("calibration/c.json",)
    ),
    "ledger.sqlite": Parser(
        read_ledger,
        of("sessions/ledger.sqlite"),
        "sessions/ledger.sqlite",
        ("study.toml", "sessions"),
    ),
    "ledger.sqlite, a cell": Parser(
        read_ledger,
        given(*seeds.CELLS),
        "sessions/ledger.sqlite",
        ("study.toml", "sessions"),
        dress=lambda content: change_cell(content, _seed_ledger()),
    ),
    "benchmark card": Parser(
        card.read_card,
        of("*.card.json"),
        "a.card.json",
        write=write_own_card,
        dress=partial(seal_json, digest=card._digest),
    ),
    "leaderboard": Parser(
        lambda path: leaderboard.read_leaderboard(path.parent), of("*.card.json"), "a.card.json"
    ),
    "answer of a port": Parser(
        lambda path: port._read_answer(path.parent, "v"), given(seeds.ANSWER), "v.out.csv"
    ),
    "answer of a program": Parser(
        lambda path: port._read_answer(path.parent, "v"), lazily(seeds.make_wavs), "v.out.wav"
    ),
    "formula": Parser(read_formula, given(*seeds.FORMULAS), "formula", typed=True),
    "command line": Parser(read_arguments, given(*seeds.ARGUMENTS), "words", typed=True),
    "command of a method": Parser(
        read_command, given(b"./my321 {input} {output} --n '3 4'"), "command", typed=True
    ),
    "request of a browser": Parser(read_request, given(*seeds.REQUESTS), "request"),
    "act of a browser": Parser(
        read_act, given(b'{"kind": "press", "key": "enter", "x": 0.5, "y": -1e3}'), "act"
    ),
}
