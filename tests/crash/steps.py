"""What is recorded, and done again after a power cut; `main` marks what it acknowledges."""

from __future__ import annotations

import os
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feel321.protocols.tasks import make_task
from feel321.protocols.texts import read_scales
from feel321.protocols.trial import Flow
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.collect import collect_sessions
from feel321.study.folder import StudyFolder
from feel321.study.ledger.progress import write_roster
from feel321.study.ledger.slots import claim_slots, open_study_ledger, rebuild_ledger
from feel321.study.observer.participant import ObserverModel, identify_observer
from feel321.study.observer.simulated import SimulatedObserver
from feel321.study.persons.withdrawal import withdraw_participant
from feel321.study.ratings import write_ratings
from feel321.study.session import journal as journals
from feel321.study.session.plan import Design, Stale, make_plan
from feel321.study.session.ports import Abort
from feel321.study.sessions import Room, lead_session
from feel321.study.settings.schema import ObserverTable
from feel321.study.study import Study
from tests.crash.record import MARKS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

STUDY = """
[[recordings]]
scene = "bumps"
duration_s = 0.1
[stimuli]
reducers = ["sax321", "dft321"]
anchors = false
"""
MORE = '[[recordings]]\nscene = "hard_taps"\nduration_s = 0.1\n' + STUDY.strip() + "\n"

MODEL = ObserverModel(**ObserverTable().model_dump())
NOW = datetime(2026, 3, 1, 12, tzinfo=UTC)
GONE = "sim002"
"""Who withdraws."""


def mark(text: str) -> None:
    """Leave a trace in the log of system calls, and none on the disk."""
    with suppress(FileNotFoundError):
        os.close(os.open(f"{MARKS}{text}", os.O_RDONLY))


class Tired(SimulatedObserver):
    """An observer who leaves once, in the middle."""

    left = False

    def wait(self, limit_s: float | None = None) -> Any:
        act = super().wait(limit_s)
        if not Tired.left and self.pages >= 3:
            Tired.left = True
            return Abort(act.time_s, "tired")
        return act

    pages = 0

    def show_trial(self, *given: Any, **named: Any) -> Any:
        self.pages += 1
        return super().show_trial(*given, **named)


def note_records() -> None:
    """Mark each record of a journal once `write` has returned."""
    keep = journals.Journal._keep

    def keep_and_mark(self: journals.Journal, record: journals.Record) -> None:
        keep(self, record)
        mark(f"record/{self.path.parent.name}/{self.path.name}/{len(self.records)}/{self.tip}")

    journals.Journal._keep = keep_and_mark  # type: ignore[method-assign]  # the product stays as it is


DESIGN = Design(
    seed=7, order="williams", repeats=1, tasks=(make_task("realism"),), between={},
    flow=Flow(break_trials=3, break_min=None, training_rounds=1),
)  # fmt: skip


def lead(folder: Path, participant: str = "sim001") -> None:
    """Lead one participant through a session, with a way out and back in the middle."""
    study = StudyFolder(folder)
    stimuli = read_stimuli(study.stimuli)
    ledger, _ = open_study_ledger(study)
    number = claim_slots(ledger, [participant], simulated=True, now=journals.utc_now)[participant]
    mark(f"slot/{participant}/{number}")
    plan = make_plan(DESIGN, stimuli, participant, number=number, simulated=True)
    room = Room(
        study, stimuli, read_scales("en"), ledger, Stale(None, "continue"), journals.utc_now
    )
    present = partial(_present)
    identity = {"presenter": identify_observer(MODEL, seed=3)}
    while lead_session(room, plan, identity=identity, make_presenter=present)[0].stopped:
        pass
    write_roster(study)
    write_ratings(study, stimuli)
    mark(f"finished/{participant}")


def _present(plan: Any, journal: journals.Journal, stimuli: Any) -> Any:
    from contextlib import nullcontext

    observer = Tired(MODEL, seed=3, number=1, elapsed_s=journal.records.find_elapsed())
    observer.recall(journal.records, plan.trials, stimuli=stimuli)
    return nullcontext(observer)


def build(folder: Path) -> None:
    """Build the set, once with what there is and once with one more recording."""
    study = StudyFolder(folder)
    Study.open(folder).build(page=False)
    mark(f"built/{study.manifest.stat().st_size}")


def build_more(folder: Path) -> None:
    StudyFolder(folder).settings.write_text(MORE, encoding="utf-8")
    build(folder)


def withdraw(folder: Path) -> None:
    withdraw_participant(StudyFolder(folder), GONE, now=lambda: NOW, reason="asked")
    mark("withdrawn")


def rebuild(folder: Path) -> None:
    study = StudyFolder(folder)
    study.ledger.unlink(missing_ok=True)
    rebuild_ledger(study)
    mark("rebuilt")


def collect(folder: Path) -> None:
    collect_sessions(StudyFolder(folder / "main"), [folder / "station"], now=lambda: NOW)
    mark("collected")


def prepare(step: str, folder: Path) -> None:
    """Make what is there before a step."""
    folder.mkdir(parents=True)
    if step == "collect":
        for name in ("main", "station"):
            prepare("session", folder / name)
        lead(folder / "station")
        return
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    if step != "build":
        Study.open(folder).build(page=False)
    if step in {"withdraw", "rebuild"}:
        for participant in ("sim001", GONE):
            lead(folder, participant)


STEPS: dict[str, Callable[[Path], None]] = {
    "session": lead, "build": build, "build more": build_more, "withdraw": withdraw, "rebuild": rebuild,
    "collect": collect,
}  # fmt: skip


def list_files(folder: Path) -> Iterator[Path]:
    return (path for path in folder.rglob("*") if path.is_file())


def main(step: str, folder: str) -> None:
    """Do a step, and mark what it acknowledges."""
    note_records()
    STEPS[step](Path(folder))
