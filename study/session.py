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
def open_session(
    folder: Path, plan: Plan, *, identity: Mapping[str, Any], now: Clock
) -> Iterator[tuple[Plan, Journal]]:
    """Begin or resume the session of one participant, and keep everybody else from writing to it.

    Parameters
    ----------
    folder : Path
        The participant's folder; created if missing.
    plan : Plan
        The plan that today's settings give; stored if none is yet.
    identity : mapping
        What must not change within the session besides the plan: the kind of presenter and its settings, as
        JSON can hold them; `simulated` (bool) among them.
    now : callable
        Gives the time of day, with its zone.

    Yields
    ------
    plan : Plan
        The plan as it is stored; its trials are those to present.
    journal : Journal
        With a header and all that was done before.

    Raises
    ------
    ValueError
        If the session was begun with another plan, stimulus set or presenter, saying what differs.
    BlockingIOError
        If the session is running elsewhere.
    """
    from stimuli.lock import hold_lock

    folder.mkdir(parents=True, exist_ok=True)
    with hold_lock(folder / ".lock", busy="another session is writing here; let it finish or stop it first"):
        stored = _settle_plan(folder / PLAN_FILE, plan)
        path = folder / name_journal(SESSION)
        journal = require_journal(path, now=now) if path.exists() else create_journal(path, now=now)
        _write_opening(journal, _make_header(stored, identity))
        yield stored, journal


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
    """Find the trials that were rated and not put back into the queue since (`requeued`).

    Parameters
    ----------
    records : iterable of Record
        A journal's records.

    Returns
    -------
    list of int
        Their numbers, in the order in which they were rated.
    """
    completed: dict[int, None] = {}
    for record in records:
        if record.event == "rated":
            completed[record.data["trial"]] = None
        elif record.event == "requeued":
            completed.pop(record.data["trial"], None)
    return list(completed)


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


def _settle_plan(path: Path, plan: Plan) -> Plan:
    if not path.exists():
        create_plan(path, plan)
    stored = require_plan(path)
    if differences := find_differences(stored, plan):
        raise ValueError(
            f"{path}: the study was changed since this plan was stored ({'; '.join(differences)}); "
            "change it back, begin with another participant, or move sessions/ away"
        )
    return stored


def _make_header(plan: Plan, identity: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "participant": plan.participant,
        "session": SESSION,
        "plan_sha256": plan.sha256,
        "stimuli_sha256": plan.stimuli_sha256,
        "seed": plan.seed,
        "presenter": dict(identity),
    }


def _write_opening(journal: Journal, header: Mapping[str, Any]) -> None:
    # Other versions of the software may go on with a session; another plan, set or presenter may not.
    versions = {name: version(name) for name in ("feel321", "numpy")}
    if (begun := find_header(journal.records)) is None:
        journal.write("begun", {**header, "versions": versions})
        return
    _check_header(begun, header, path=journal.path)
    if not is_finished(journal.records):
        journal.write("resumed", {"versions": versions})


def _check_header(begun: Mapping[str, Any], header: Mapping[str, Any], *, path: Path) -> None:
    old, new = _flatten(begun), _flatten(header)
    # What only one of them knows is a difference as well.
    names = [name for name in old | new if not name.startswith("versions.") and old.get(name) != new.get(name)]
    if names:
        differences = "; ".join(f"{name} {old.get(name)!r} -> {new.get(name)!r}" for name in names)
        raise ValueError(
            f"{path}: the session was begun otherwise ({differences}); "
            "change that back, begin with another participant, or move sessions/ away"
        )


def _flatten(entry: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Name every value of nested mappings by its keys, joined with dots."""
    flat: dict[str, Any] = {}
    for name, value in entry.items():
        flat |= _flatten(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return flat


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
