"""Leading one participant through a session, with the ledger kept beside the journal.

What simulated and real sessions have in common; only who presents differs.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from study.ledger.sightings import check_anchors
from study.ledger.slots import note_progress, read_ledger
from study.session.conduct import Stage
from study.session.engine import run_session
from study.session.opening import open_session
from study.session.plan import list_codes
from study.session.replay import has_event

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from contextlib import AbstractContextManager
    from pathlib import Path

    from sqlalchemy import Engine

    from protocols.trial import Scale
    from stimuli.manifest import Stimulus, StimulusSet
    from study.folder import StudyFolder
    from study.session.engine import Outcome
    from study.session.journal import Clock, Journal
    from study.session.opening import Stale
    from study.session.plan import Plan
    from study.session.ports import Place, Presenter

    MakePresenter = Callable[[Plan, Journal, Mapping[str, Stimulus]], AbstractContextManager[Presenter]]


TRIALS_BETWEEN_NOTES = 25
"""How far the ledger may be behind the journals of simulated participants; it follows real ones trial by trial."""


@dataclass(frozen=True, slots=True)
class Room:
    """What the sessions of a study share.

    Parameters
    ----------
    study : StudyFolder
        Where it lies.
    stimuli : StimulusSet
        What is felt.
    scales : mapping of str to Scale
        The texts by name of scale.
    ledger : Engine
        Where slots and progress are kept.
    stale : Stale
        What becomes of a session that was left for long.
    now : callable
        Gives the time of day, with its zone.
    """

    study: StudyFolder
    stimuli: StimulusSet
    scales: Mapping[str, Scale]
    ledger: Engine
    stale: Stale
    now: Clock


def lead_session(
    room: Room,
    plan: Plan,
    *,
    identity: Mapping[str, Any],
    make_presenter: MakePresenter,
    on_step: Callable[[Place], None] | None = None,
) -> tuple[Outcome, str]:
    """Begin or resume the session of one participant and lead it as far as it goes.

    Parameters
    ----------
    room : Room
        What the sessions of the study share.
    plan : Plan
        The plan that today's settings give.
    identity : mapping
        What must not change within the session besides its plan.
    make_presenter : callable
        Takes the stored plan, the open journal and the stimuli by blind code; gives a context manager that opens the
        presenter, and closes it whatever happens.
    on_step : callable, optional
        Called with how far the session has come, at its opening and after every page and trial.

    Returns
    -------
    outcome : Outcome
        How the session ended.
    notice : str
        What had to be mended when it was opened, and whether the ledger could not follow; mostly empty.

    Raises
    ------
    ValueError
        If the session was begun otherwise, saying what differs.
    BlockingIOError
        If it is running elsewhere.
    """
    folder = room.study.sessions / plan.participant
    _check_whole(room, folder)
    with open_session(folder, plan, identity=identity, now=room.now, stale=room.stale) as (stored, journal):
        codes = list_codes(room.stimuli, seed=stored.seed)
        by_code = {codes[row.stimulus_id]: row for row in room.stimuli.stimuli}
        keeper = _Keeper(room.ledger, journal, every=TRIALS_BETWEEN_NOTES if stored.simulated else 1)

        def note(place: Place) -> None:
            keeper.see(place)
            if on_step is not None:
                on_step(place)

        with ExitStack() as stack:
            stack.callback(keeper.write)
            presenter = stack.enter_context(make_presenter(stored, journal, by_code))
            stage = Stage(presenter, by_code, room.scales, journal, stored.flow)
            outcome = run_session(stored, stage, on_step=note)
        return outcome, "; ".join(filter(None, (journal.notice, keeper.notice)))


def _check_whole(room: Room, folder: Path) -> None:
    """Refuse to go on with a journal of which less is there than was seen."""
    for entry in read_ledger(room.ledger, folder.name):
        check_anchors(entry.anchors, folder)


@dataclass(slots=True)
class _Keeper:
    """Notes in the ledger how far a session has come: at its opening, now and then, and at its end.

    The journal is the truth: a ledger that cannot be written is told, and ends nobody's session.
    """

    ledger: Engine
    journal: Journal
    every: int
    place: Place | None = None
    noted: int | None = None
    notice: str = ""

    def see(self, place: Place) -> None:
        self.place = place
        if self.noted is None or place.done - self.noted >= self.every:
            self.write()

    def write(self) -> None:
        if self.place is None:
            return
        self.noted = self.place.done
        try:
            self._note(self.place)
        except (OSError, ValueError) as error:
            self.notice = str(error)
        else:
            self.notice = ""

    def _note(self, place: Place) -> None:
        note_progress(
            self.ledger,
            self.journal.path.parent.name,
            journal=self.journal.path.name,
            lines=len(self.journal.records),
            tip=self.journal.tip,
            done=place.done,
            total=place.total,
            state="finished" if has_event(self.journal.records, "finished") else "running",
        )
