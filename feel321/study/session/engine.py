"""The engine: one participant works through a plan, against ports only.

A session is resumed by replaying its journal: what was rated is done, all else is asked again.

Every event is in the journal before the next one may happen.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite
from numbers import Real
from typing import TYPE_CHECKING, Any

from feel321.protocols.trial import RATING_RANGE, Page
from feel321.study.session.plan import find_elapsed, has_event, replay, tell
from feel321.study.session.ports import Abort, Confirm, Feel, Move, Pause, Place

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from feel321.protocols.agenda import Agenda
    from feel321.protocols.trial import Flow, Part, Scale, Trial
    from feel321.stimuli.sets.manifest import Stimulus
    from feel321.study.session.journal import Journal
    from feel321.study.session.plan import Plan
    from feel321.study.session.ports import Playback, Presenter

# One step of a session: what is felt, what is accepted, what is refused, and what makes an attempt a bad one.


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
    """The session ends here for today; reason and time are the arguments."""


class _Paused(Exception):  # noqa: N818 - nothing went wrong
    """The participant paused; the time is the argument."""


@dataclass(slots=True)
class _Attempt:
    """What was felt in one attempt at a trial."""

    trial: Trial
    number: int
    stage: Stage
    playbacks: dict[str, Playback] = field(default_factory=dict)
    time_s: float = 0.0

    @property
    def key(self) -> dict[str, int]:
        return {"trial": self.trial.number, "attempt": self.number}

    def take(self, part: Part, playback: Playback) -> None:
        before = self.playbacks.get(part.name)
        # What was felt to its end stays felt, though it be cut short when it is felt again.
        if before is None or not before.completed or playback.completed or playback.error:
            self.playbacks[part.name] = playback
        self.time_s = playback.requested_s if playback.onset_s is None else playback.onset_s

    def list_unfelt(self) -> tuple[str, ...]:
        felt = {
            name
            for name, playback in self.playbacks.items()
            if playback.completed and not playback.error
        }
        return tuple(part.name for part in self.trial.parts if part.name not in felt)

    def list_flags(self) -> list[str]:
        """List what was wrong with the parts, each as it was felt last."""
        faults = {
            "underrun": any(playback.underruns for playback in self.playbacks.values()),
            "clipped": any(playback.clipped for playback in self.playbacks.values()),
            "device_error": any(playback.error for playback in self.playbacks.values()),
        }
        return [name for name, fault in faults.items() if fault]

    def write(self, event: str, data: Mapping[str, Any]) -> None:
        self.stage.journal.write(event, {**self.key, **data})


def conduct_page(page: Page, place: Place, stage: Stage) -> None:
    """Show a page until whoever it is for goes on, and at least as long as it is to stand."""
    act = _read_page(page, place, stage)
    stage.journal.write(
        "page", {"key": page.key, "time_s": act.time_s, "stood_s": act.response_time_s}
    )


def conduct_trial(trial: Trial, place: Place, stage: Stage) -> None:
    """Lead a participant through one attempt at a trial."""
    while True:
        attempt = _Attempt(trial, place.attempt, stage)
        stage.presenter.show_trial(trial, stage.scales[trial.scale], place)
        attempt.write("shown", {})
        try:
            if trial.timing != "free":
                _feel(attempt, trial.parts)
            if not _is_spoiled(attempt):
                _answer(attempt)
        except _Paused as pause:
            attempt.write("paused", {"time_s": pause.args[0]})
            attempt.write("continued", {"time_s": _read_page(Page("pause"), place, stage).time_s})
        else:
            return


def _read_page(page: Page, place: Place, stage: Stage) -> Confirm:
    while True:
        act = stage.presenter.show_page(page, place)
        if isinstance(act, Abort):
            raise Stopped(act.reason, act.time_s)
        if isinstance(act, Pause):
            continue  # Nothing is felt on a page, so there is nothing to pause.
        if act.response_time_s >= page.least_s:
            return act
        stage.presenter.refuse("too_early", ())


def _answer(attempt: _Attempt) -> None:
    """Wait for the answer, or for what ends the attempt otherwise."""
    while True:
        act = attempt.stage.presenter.wait()
        match act:
            case Feel():
                _feel_again(attempt, act)
                if _is_spoiled(attempt):
                    return
            case Move():
                _move(attempt, act)
            case Confirm():
                if _accept(attempt, act):
                    return
            case _:
                _heed(act)


def _feel(attempt: _Attempt, parts: Iterable[Part]) -> None:
    """Play the parts in order, until one is cut short."""
    stage = attempt.stage
    gap_s = 0.0 if attempt.trial.timing == "free" else stage.flow.gap_s
    for part in parts:
        if part.stimulus_id is None:
            playback, event = stage.presenter.prompt(part), "prompted"
        else:
            playback = stage.presenter.play(part, stage.stimuli[part.stimulus_id], gap_s=gap_s)
            event = "played"
        attempt.write(event, {"part": part.name, **_describe_playback(playback)})
        attempt.take(part, playback)
        _heed(playback.act)
        if playback.error or not playback.completed:
            return


def _describe_playback(playback: Playback) -> dict[str, Any]:
    """Write a playback as JSON can hold it: devices report numbers of many kinds, and some that are none."""
    onset_s = playback.onset_s
    return {
        "requested_s": float(playback.requested_s),
        "onset_s": float(onset_s) if onset_s is not None and isfinite(onset_s) else None,
        "underruns": int(playback.underruns),
        "clipped": int(playback.clipped),
        "completed": bool(playback.completed),
        "error": playback.error,
        **({"measured": measured} if (measured := _list_finite(playback.measured)) else {}),
    }


def _list_finite(measured: Mapping[str, float]) -> dict[str, float]:
    return {name: float(value) for name, value in measured.items() if isfinite(value)}


def _feel_again(attempt: _Attempt, act: Feel) -> None:
    parts = [part for part in attempt.trial.parts if act.part in {"", part.name}]
    if attempt.trial.timing == "strict":
        _refuse(attempt, act, reason="no_replay")
    elif not parts:
        _refuse(attempt, act, reason="unknown_part", parts=(act.part,))
    else:
        if not {part.name for part in parts} & set(attempt.list_unfelt()):
            attempt.write("replayed", {"part": act.part, "time_s": act.time_s})
        _feel(attempt, parts)


def _move(attempt: _Attempt, act: Move) -> None:
    scale = attempt.stage.scales[attempt.trial.scale]
    if act.part in attempt.trial.judged and act.part in _find_valid({act.part: act.value}, scale):
        attempt.write("moved", {"part": act.part, "value": float(act.value), "time_s": act.time_s})
    else:
        _refuse(attempt, act, reason="unknown_part", parts=(act.part,))


def _is_spoiled(attempt: _Attempt) -> bool:
    """End an attempt that can no longer be answered: the device failed, or what is felt only once was cut short."""
    flags = attempt.list_flags()
    if attempt.trial.timing == "strict" and attempt.list_unfelt():
        flags.append("not_felt")
    if not {"device_error", "not_felt"} & set(flags):
        return False
    attempt.write("spoiled", {"flags": flags, "time_s": attempt.time_s})
    return True


def _accept(attempt: _Attempt, act: Confirm) -> bool:
    """Record the answer, unless something was not felt or not answered."""
    stage, trial = attempt.stage, attempt.trial
    if unfelt := attempt.list_unfelt():
        return _refuse(attempt, act, reason="not_felt", parts=unfelt)
    valid = _find_valid(act.values, stage.scales[trial.scale])
    if missing := [part for part in trial.judged if part not in valid]:
        return _refuse(attempt, act, reason="not_answered", parts=tuple(missing))
    flags = attempt.list_flags()
    if act.response_time_s < stage.flow.min_response_s:
        flags.append("too_fast")
    values = {part: act.values[part] for part in trial.judged}
    attempt.write(
        "rated",
        {
            "values": {
                part: value if isinstance(value, str) else float(value)
                for part, value in values.items()
            },
            "response_time_s": act.response_time_s,
            "time_s": act.time_s,
            "flags": flags,
            "rejected": not set(stage.flow.reject).isdisjoint(flags),
        },
    )
    return True


def _find_valid(values: Mapping[str, float | str], scale: Scale) -> set[str]:
    low, high = RATING_RANGE
    return {
        part
        for part, value in values.items()
        if (
            value in scale.choices
            if scale.choices
            else isinstance(value, Real) and low <= value <= high
        )
    }


def _refuse(
    attempt: _Attempt, act: Feel | Move | Confirm, *, reason: str, parts: tuple[str, ...] = ()
) -> bool:
    attempt.write("refused", {"reason": reason, "parts": list(parts), "time_s": act.time_s})
    attempt.stage.presenter.refuse(reason, parts)
    return False


def _heed(act: object) -> None:
    """Let a pause or an abort end the attempt."""
    if isinstance(act, Abort):
        raise Stopped(act.reason, act.time_s)
    if isinstance(act, Pause):
        raise _Paused(act.time_s)


# One participant working through a plan: the loop, against ports only.

DEVICE_ERRORS = 2
"""Failures of the device in a row that end the session: trials must not be used up on a dead device."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a session ended.

    Parameters
    ----------
    done, total : int
        Trials of the main phase that are done, and all of them.
    stopped : str
        Why it ended before its end; empty if it did not.
    """

    done: int
    total: int
    stopped: str = ""


def run_session(
    plan: Plan, stage: Stage, *, on_step: Callable[[Place], None] | None = None
) -> Outcome:
    """Present all that is not done yet.

    Parameters
    ----------
    plan : Plan
        The plan.
    stage : Stage
        Who presents, what, and where it is recorded.
    on_step : callable, optional
        Called with how far the session has come, at its opening and after every page and trial.

    Returns
    -------
    Outcome
        Whether it came to its end; if not, the same call goes on.
    """
    agenda = replay(plan, stage.journal.records)
    try:
        _work_through(plan, agenda, stage, on_step=on_step)
    except Stopped as stop:
        reason, time_s = stop.args
        stage.journal.write("aborted", {"reason": reason, "time_s": time_s})
        return Outcome(agenda.done, agenda.total, reason)
    except BaseException as error:
        if stage.journal.is_open:
            words = f"{type(error).__name__}: {error}".removesuffix(": ")
            stage.journal.write(
                "aborted", {"reason": words, "time_s": find_elapsed(stage.journal.records)}
            )
        raise
    if not has_event(stage.journal.records, "finished"):
        stage.journal.write("finished", {"trials": agenda.done, "given_up": agenda.given_up})
    return Outcome(agenda.done, agenda.total)


def _work_through(
    plan: Plan, agenda: Agenda, stage: Stage, *, on_step: Callable[[Place], None] | None
) -> None:
    trials = {trial.number: trial for trial in plan.trials}
    failures = 0
    while True:
        if on_step is not None:
            on_step(Place(agenda.done, agenda.total))
        if (step := agenda.ask()) is None:
            return
        if isinstance(step, Page):
            conduct_page(step, Place(agenda.done, agenda.total), stage)
        else:
            conduct_trial(
                step, Place(agenda.done, agenda.total, agenda.attempt(step.number)), stage
            )
        # The agenda is told what is on the disk, by the same words as when a session is resumed.
        record = stage.journal.records[-1]
        tell(agenda, record, trials)
        failures = failures + 1 if "device_error" in record.data.get("flags", ()) else 0
        if failures == DEVICE_ERRORS:
            raise Stopped(
                "the device failed twice in a row; see to it, then resume", record.data["time_s"]
            )
