"""A participant's seat, seat.py STUDY ID NUMBER CONTROL: a simulated participant's session.

Session, engine, journal, ledger and files are the real ones; only the person and the device are simulated. What the
folder CONTROL holds happens to them: `day.json` (when the day began, how fast it passes), `lost-STATION` (the device is
gone), `clock-STATION` (seconds by which the station's clock is wrong), `tired-ID` (the person leaves). Each answer that
the engine took is appended to `acks-ID`, outside the study: this is the witness of what must not be lost.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study import sessions
from feel321.study.commands import lab
from feel321.study.folder import StudyFolder
from feel321.study.observer.casting import cast_observers
from feel321.study.observer.participant import identify_observer
from feel321.study.observer.simulated import SimulatedObserver
from feel321.study.session.ports import Abort, Act, Confirm, Pause, Playback
from feel321.study.settings.read import make_identity, read_settings

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from feel321.protocols.questions import Question
    from feel321.protocols.trial import Page, Part, Scale, Trial
    from feel321.stimuli.sets.manifest import Stimulus
    from feel321.study.session.journal import Journal
    from feel321.study.session.plan import Plan
    from feel321.study.session.ports import Place


class Control:
    """What happens in the lab, as files of a folder."""

    def __init__(self, folder: Path, station: str, person: str) -> None:
        day = json.loads((folder / "day.json").read_text())
        self.folder, self.station, self.person = folder, station, person
        self.speed: float = day["speed"]
        self._began_s, self._began = day["began_s"], datetime.fromisoformat(day["began"])

    def now(self) -> datetime:
        passed_s = (time.time() - self._began_s) * self.speed
        return self._began + timedelta(seconds=passed_s + self._read_step())

    def _read_step(self) -> float:
        try:
            return float((self.folder / f"clock-{self.station}").read_text() or 0)
        except FileNotFoundError:
            return 0.0

    @property
    def has_device(self) -> bool:
        return not (self.folder / f"lost-{self.station}").exists()

    @property
    def is_tired(self) -> bool:
        return (self.folder / f"tired-{self.person}").exists()

    def acknowledge(self, answer: tuple[int, int, Mapping[str, Any]]) -> None:
        line = json.dumps(answer) + "\n"
        path = self.folder / f"acks-{self.person}"
        file = os.open(path, os.O_CREAT | os.O_APPEND | os.O_WRONLY)
        os.write(file, line.encode())
        os.close(file)


class Person(SimulatedObserver):
    """Takes their time, may find the device gone, calls the operator, may be tired."""

    control: Control
    _answer: tuple[int, int, Mapping[str, Any]] | None = None
    _shown: tuple[int, int] = (0, 0)
    began_s: float = 0.0

    def pace(self) -> None:
        """Let the time pass that the observer says it took; where the computer took longer, so did the person."""
        passed_s = (time.monotonic() - self.began_s) * self.control.speed
        time.sleep(max(0.0, self._time_s - passed_s) / self.control.speed)
        self._time_s = max(self._time_s, round(passed_s, 3))

    def settle(self) -> None:
        """Note an answer once the engine goes on: it is on the disk."""
        if self._answer is not None:
            self.control.acknowledge(self._answer)
            self._answer = None

    def show_page(self, page: Page, place: Place) -> Confirm | Pause | Abort:
        self.settle()
        if page.key == "call_us":  # The operator presses F12 when the device is back.
            while not self.control.has_device:
                time.sleep(0.02)
            self.pace()
        if self.control.is_tired:
            return Abort(self._time_s, "tired")
        act = super().show_page(page, place)
        self.pace()
        return act

    def show_question(self, question: Question, place: Place) -> Confirm:
        self.settle()
        act = super().show_question(question, place)
        self.pace()
        return act

    def show_trial(self, trial: Trial, scale: Scale, place: Place) -> None:
        self.settle()
        self._shown = (trial.number, place.attempt)
        super().show_trial(trial, scale, place)

    def play(self, part: Part, stimulus: Any, **options: Any) -> Playback:
        there = self.control.has_device
        playback = super().play(part, stimulus, **options)
        self.pace()
        if there and self.control.has_device:
            return playback
        onset_s = playback.onset_s if there else None
        return replace(playback, onset_s=onset_s, completed=False, error="the device is gone")

    def wait(self, limit_s: float | None = None) -> Act:
        act = Abort(self._time_s, "tired") if self.control.is_tired else super().wait(limit_s)
        self.pace()
        if isinstance(act, Confirm):
            self._answer = (*self._shown, dict(act.values))
        return act

    def refuse(self, reason: str, parts: tuple[str, ...]) -> None:
        self._answer = None
        super().refuse(reason, parts)


def lead(study: StudyFolder, name: str, number: int, control: Control) -> str:
    settings, stimuli = read_settings(study.settings), read_stimuli(study.stimuli)
    room, _ = sessions.open_room(study, settings, stimuli, now=control.now)
    plan = sessions.plan_sessions(room, settings, [name], simulated=True)[0]
    casting = cast_observers(settings, stimuli, seed=settings.study.seed)

    @contextmanager
    def sit(plan: Plan, journal: Journal, stimuli: Mapping[str, Stimulus]) -> Iterator[Person]:
        elapsed_s = journal.records.find_elapsed()
        person = Person(
            casting.model,
            seed=casting.seed,
            number=number,
            percepts=casting.percepts,
            elapsed_s=elapsed_s,
        )
        person.control = control
        person.began_s = time.monotonic() - elapsed_s / control.speed
        person.recall(journal.records, plan.trials, stimuli=stimuli)
        (control.folder / f"seated-{os.getpid()}").touch()
        yield person
        person.settle()

    identity = make_identity(
        settings, study.path, identify_observer(casting.model, seed=casting.seed)
    )
    outcome, notice = sessions.lead_session(room, plan, identity=identity, make_presenter=sit)
    return json.dumps({"stopped": outcome.stopped, "done": outcome.done, "notice": notice})


def end(_number: int, _frame: object) -> NoReturn:
    """As `run` takes it."""
    raise lab.Terminated


def main(path: str, name: str, number: str, folder: str) -> int:
    sessions.TRIALS_BETWEEN_NOTES = 1  # as for people
    control = Control(Path(folder), os.environ["FEEL321_STATION"], name)
    signal.signal(signal.SIGTERM, end)
    try:
        print(lead(StudyFolder(Path(path)), name, int(number), control), flush=True)
    except lab.Terminated:
        return 143
    except (OSError, ValueError) as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
