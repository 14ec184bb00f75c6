"""One step of a session: what is felt, what is accepted, what is refused, and what makes an attempt a bad one.

Every event is in the journal before the next one may happen.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from protocols.flow import Page
from protocols.trial import RATING_RANGE, find_missing
from study.session.ports import Abort, Confirm, Feel, Move, Pause

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from protocols.flow import Flow
    from protocols.trial import Part, Scale, Trial
    from stimuli.manifest import Stimulus
    from study.session.journal import Journal
    from study.session.ports import Place, Playback, Presenter


@dataclass(frozen=True, slots=True)
class Stage:
    """Everything that a session needs besides its plan.

    Parameters
    ----------
    presenter : Presenter
        Who shows, plays and passes on what the participant does.
    stimuli : mapping of str to Stimulus
        The stimuli by blind code.
    scales : mapping of str to Scale
        The texts by name of scale.
    journal : Journal
        Where everything is recorded, open.
    flow : Flow
        The rules of the session.
    """

    presenter: Presenter
    stimuli: Mapping[str, Stimulus]
    scales: Mapping[str, Scale]
    journal: Journal
    flow: Flow


class Stopped(Exception):  # noqa: N818 - nothing went wrong
    """The session ends here for today; the reason is the argument."""


@dataclass(slots=True)
class _Attempt:
    """What was felt in one attempt at a trial."""

    trial: Trial
    number: int
    stage: Stage
    felt: set[str] = field(default_factory=set)
    flags: dict[str, None] = field(default_factory=dict)
    time_s: float = 0.0

    @property
    def key(self) -> dict[str, int]:
        return {"trial": self.trial.number, "attempt": self.number}

    def take(self, part: Part, playback: Playback) -> None:
        self.time_s = playback.onset_s
        if playback.completed and not playback.error:
            self.felt.add(part.name)
        faults = {
            "underrun": playback.underruns,
            "clipped": playback.clipped,
            "device_error": playback.error,
        }
        self.flags |= dict.fromkeys(name for name, fault in faults.items() if fault)

    def list_unfelt(self) -> tuple[str, ...]:
        return tuple(part.name for part in self.trial.parts if part.name not in self.felt)


def conduct_page(page: Page, place: Place, stage: Stage) -> None:
    """Show a page until the participant goes on.

    Parameters
    ----------
    page : Page
        The page.
    place : Place
        How far the session has come.
    stage : Stage
        Who shows it, and where it is recorded.

    Raises
    ------
    Stopped
        If the participant does not go on.
    """
    act = stage.presenter.show_page(page, place)
    while isinstance(act, Pause):  # Nothing is felt on a page, so there is nothing to pause.
        act = stage.presenter.show_page(page, place)
    _heed(act)
    stage.journal.write("page", {"key": page.key, "time_s": act.time_s})


def conduct_trial(trial: Trial, place: Place, stage: Stage) -> None:
    """Lead a participant through one attempt at a trial.

    Parameters
    ----------
    trial : Trial
        The trial.
    place : Place
        How far the session has come.
    stage : Stage
        Who presents it, and where it is recorded.

    Raises
    ------
    Stopped
        If the participant does not go on; the attempt then never was.
    """
    while True:
        attempt = _Attempt(trial, place.attempt, stage)
        stage.presenter.show_trial(trial, stage.scales[trial.scale], place)
        stage.journal.write("shown", attempt.key)
        if trial.timing != "free":
            _feel(attempt, trial.parts)
        if _is_spoiled(attempt) or _answer(attempt):
            return
        conduct_pause(trial, place, stage)


def conduct_pause(trial: Trial, place: Place, stage: Stage) -> None:
    """Wait until a participant who paused goes on.

    Parameters
    ----------
    trial : Trial
        The trial that was broken off; it is shown from its beginning afterwards.
    place : Place
        How far the session has come.
    stage : Stage
        Who shows the page, and where it is recorded.

    Raises
    ------
    Stopped
        If the participant does not go on.
    """
    act = stage.presenter.show_page(Page("pause"), place)
    while isinstance(act, Pause):
        act = stage.presenter.show_page(Page("pause"), place)
    _heed(act)
    stage.journal.write("continued", {"trial": trial.number, "time_s": act.time_s})


def _answer(attempt: _Attempt) -> bool:
    """Wait for the answer; False if the participant paused instead."""
    stage, number = attempt.stage, attempt.trial.number
    while True:
        act = stage.presenter.wait()
        _heed(act)
        match act:
            case Feel():
                _feel_again(attempt, act)
                if _is_spoiled(attempt):
                    return True
            case Move():
                stage.journal.write("moved", {"trial": number, **asdict(act)})
            case Confirm():
                if _accept(attempt, act):
                    return True
            case Pause():
                stage.journal.write("paused", {"trial": number, "time_s": act.time_s})
                return False


def _feel(attempt: _Attempt, parts: Iterable[Part]) -> None:
    """Play the parts in order, until one is cut short."""
    stage = attempt.stage
    for part in parts:
        if part.stimulus_id is None:
            playback, event = stage.presenter.prompt(part), "prompted"
        else:
            stimulus = stage.stimuli[part.stimulus_id]
            playback, event = stage.presenter.play(part, stimulus, gap_s=stage.flow.gap_s), "played"
        stage.journal.write(event, {**attempt.key, "part": part.name, **asdict(playback)})
        attempt.take(part, playback)
        if playback.error or not playback.completed:
            return


def _feel_again(attempt: _Attempt, act: Feel) -> None:
    parts = [part for part in attempt.trial.parts if act.part in {"", part.name}]
    if attempt.trial.timing == "strict":
        _refuse(attempt, act, reason="no_replay")
    elif not parts:
        _refuse(attempt, act, reason="unknown_part", parts=(act.part,))
    else:
        if attempt.felt.issuperset(part.name for part in parts):
            again = {"trial": attempt.trial.number, "part": act.part, "time_s": act.time_s}
            attempt.stage.journal.write("replayed", again)
        _feel(attempt, parts)


def _is_spoiled(attempt: _Attempt) -> bool:
    """End an attempt that can no longer be answered: the device failed, or what is felt only once was cut short."""
    if attempt.trial.timing == "strict" and attempt.list_unfelt():
        attempt.flags["not_felt"] = None
    if not {"device_error", "not_felt"} & attempt.flags.keys():
        return False
    spoiled = {**attempt.key, "flags": list(attempt.flags), "time_s": attempt.time_s}
    attempt.stage.journal.write("spoiled", spoiled)
    return True


def _accept(attempt: _Attempt, act: Confirm) -> bool:
    """Record the answer, unless something was not felt or not answered."""
    stage, trial = attempt.stage, attempt.trial
    if unfelt := attempt.list_unfelt():
        return _refuse(attempt, act, reason="not_felt", parts=unfelt)
    if missing := find_missing(trial, _find_valid(act.values, stage.scales[trial.scale])):
        return _refuse(attempt, act, reason="not_answered", parts=tuple(missing))
    if act.response_time_s < stage.flow.min_response_s:
        attempt.flags["too_fast"] = None
    rated: dict[str, Any] = {
        **attempt.key,
        "values": {judgement.part: act.values[judgement.part] for judgement in trial.judgements},
        "response_time_s": act.response_time_s,
        "time_s": act.time_s,
        "flags": list(attempt.flags),
        "rejected": not attempt.flags.keys().isdisjoint(stage.flow.reject),
    }
    stage.journal.write("rated", rated)
    return True


def _find_valid(values: Mapping[str, float | str], scale: Scale) -> set[str]:
    low, high = RATING_RANGE
    return {
        part
        for part, value in values.items()
        if (value in scale.choices if scale.choices else isinstance(value, int | float) and low <= value <= high)
    }


def _refuse(attempt: _Attempt, act: Feel | Confirm, *, reason: str, parts: tuple[str, ...] = ()) -> bool:
    refused = {"trial": attempt.trial.number, "reason": reason, "parts": list(parts), "time_s": act.time_s}
    attempt.stage.journal.write("refused", refused)
    attempt.stage.presenter.refuse(reason, parts)
    return False


def _heed(act: object) -> None:
    if isinstance(act, Abort):
        raise Stopped(act.reason)
