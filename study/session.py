"""One participant working through a plan: the loop, against ports only.

A session is resumed by replaying its journal: trials that were rated are done, all else is asked again.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from protocols.queue import TrialQueue
from study.journal import create_journal, require_journal
from study.lock import hold_lock
from study.plan import create_plan, find_differences, require_plan
from study.ports import Replay

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from pathlib import Path

    from protocols.trial import Scale, Trial
    from stimuli.manifest import Stimulus
    from study.chain import Record
    from study.journal import Clock, Journal
    from study.plan import Plan
    from study.ports import Playback, Presenter

PLAN_FILE = "plan.json"
SESSION = 1
"""One session per participant today; a second gets the next number, never the same file."""


@dataclass(frozen=True, slots=True)
class Stage:
    """Everything that a session needs besides its plan.

    Parameters
    ----------
    presenter : Presenter
        Who shows, plays and asks.
    stimuli : mapping of str to Stimulus
        The stimuli by id.
    scales : mapping of str to Scale
        The texts by name of scale.
    journal : Journal
        Where everything is recorded, open.
    """

    presenter: Presenter
    stimuli: Mapping[str, Stimulus]
    scales: Mapping[str, Scale]
    journal: Journal


@contextmanager
def open_session(folder: Path, plan: Plan, *, identity: Mapping[str, Any], now: Clock) -> Iterator[Journal]:
    """Begin or resume the session of one participant, and keep everybody else from writing to it.

    Parameters
    ----------
    folder : Path
        The participant's folder; created if missing.
    plan : Plan
        The plan that today's settings give.
    identity : mapping
        What must not change within the session besides the plan: the kind of presenter and its settings, as
        JSON can hold them; `simulated` (bool) among them.
    now : callable
        Gives the time of day, with its zone.

    Yields
    ------
    Journal
        With a header and all that was done before.

    Raises
    ------
    ValueError
        If the session was begun with another plan, stimulus set or presenter, saying what differs.
    BlockingIOError
        If the session is running elsewhere.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with hold_lock(folder / ".lock"):
        _store_plan(folder / PLAN_FILE, plan)
        path = folder / name_journal(SESSION)
        journal = require_journal(path, now=now) if path.exists() else create_journal(path, now=now)
        header = _make_header(plan, identity)
        if (begun := find_header(journal.records)) is None:
            journal.write("begun", header)
        else:
            _check_header(begun, header, path=path)
        yield journal


def run_session(plan: Plan, stage: Stage, *, on_rated: Callable[[Trial], None] | None = None) -> None:
    """Present all trials that are not done yet.

    Parameters
    ----------
    plan : Plan
        The trials.
    stage : Stage
        Who presents, what, and where it is recorded.
    on_rated : callable, optional
        Called with each trial once its rating is on the disk.
    """
    queue = TrialQueue(plan.trials)
    for number in find_completed(stage.journal.records):
        queue.tell(number)
    while (trial := queue.ask()) is not None:
        _run_trial(trial, stage)
        queue.tell(trial.number)
        if on_rated is not None:
            on_rated(trial)
    if not is_finished(stage.journal.records):
        stage.journal.write("finished", {"trials": len(plan.trials)})


def name_journal(session: int) -> str:
    """Name the file of a session's journal.

    Parameters
    ----------
    session : int
        The session's number, from 1.

    Returns
    -------
    str
        Its name in the participant's folder.

    Examples
    --------
    >>> name_journal(1)
    'session-01.jsonl'
    """
    return f"session-{session:02d}.jsonl"


def find_header(records: Iterable[Record]) -> Mapping[str, Any] | None:
    """Find what a session was begun with.

    Parameters
    ----------
    records : iterable of Record
        A journal's records.

    Returns
    -------
    mapping or None
        The header; None if a crash came before it was written.
    """
    return next((record.data for record in records if record.event == "begun"), None)


def find_completed(records: Iterable[Record]) -> list[int]:
    """Find the trials that were rated.

    Parameters
    ----------
    records : iterable of Record
        A journal's records.

    Returns
    -------
    list of int
        Their numbers, in the order in which they were rated.
    """
    return [record.data["trial"] for record in records if record.event == "rated"]


def find_elapsed(records: Iterable[Record]) -> float:
    """Find how far the presenter's clock had come with the last rating.

    Parameters
    ----------
    records : iterable of Record
        A journal's records.

    Returns
    -------
    float
        Seconds since the session began; 0 before the first rating.
    """
    return max((record.data["time_s"] for record in records if record.event == "rated"), default=0.0)


def is_finished(records: Iterable[Record]) -> bool:
    """Tell whether a session came to its end.

    Parameters
    ----------
    records : iterable of Record
        A journal's records.

    Returns
    -------
    bool
        True if it did.
    """
    return any(record.event == "finished" for record in records)


def _store_plan(path: Path, plan: Plan) -> None:
    if not path.exists():
        create_plan(path, plan)
    elif differences := find_differences(require_plan(path), plan):
        raise ValueError(
            f"{path}: the study was changed since this plan was stored ({'; '.join(differences)}); "
            "change it back, or begin with another participant"
        )


def _make_header(plan: Plan, identity: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "participant": plan.participant,
        "session": SESSION,
        "plan_sha256": plan.sha256,
        "stimuli_sha256": plan.stimuli_sha256,
        "seed": plan.seed,
        "presenter": dict(identity),
        "versions": {name: version(name) for name in ("feel321", "numpy")},
    }


def _check_header(begun: Mapping[str, Any], header: Mapping[str, Any], *, path: Path) -> None:
    # Other versions of the software may go on with a session; another plan, set or presenter may not.
    names = [name for name in header if name != "versions" and begun.get(name) != header[name]]
    if names:
        differences = "; ".join(f"{name} {begun.get(name)!r} -> {header[name]!r}" for name in names)
        raise ValueError(
            f"{path}: the session was begun otherwise ({differences}); "
            "change that back, or begin with another participant"
        )


def _run_trial(trial: Trial, stage: Stage) -> None:
    scale = stage.scales[trial.scale]
    stage.presenter.show(trial, scale)
    stage.journal.write("shown", asdict(trial))
    playbacks = _play(trial, stage)
    while isinstance(answer := stage.presenter.ask(scale), Replay):
        stage.journal.write("replayed", {"trial": trial.number})
        playbacks += _play(trial, stage)
    # What ran dry was not the stimulus: the rating is kept, and marked.
    rejected = any(playback.underruns for playback in playbacks)
    stage.journal.write("rated", {"trial": trial.number, **asdict(answer), "rejected": rejected})


def _play(trial: Trial, stage: Stage) -> list[Playback]:
    playbacks = []
    for part, stimulus_id in (("reference", trial.reference_id), ("test", trial.stimulus_id)):
        if stimulus_id is not None:
            playback = stage.presenter.play(stage.stimuli[stimulus_id])
            stage.journal.write("played", {"trial": trial.number, "part": part, **asdict(playback)})
            playbacks.append(playback)
    return playbacks
