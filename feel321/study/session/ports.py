"""The port between a session and its participant: a presenter shows, plays and passes on the participant's acts.

Implemented by `SimulatedObserver` and `ScreenPresenter`. The rules (what must be felt, what is refused, what is tried
again) are the engine's. All times are in s since the session began, on the presenter's own clock, which goes on where
it stopped when a session is resumed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from feel321.protocols.blocks import name_tone
from feel321.study.session.events import Played

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.protocols.questions import Question
    from feel321.protocols.trial import Page, Part, Scale, Trial
    from feel321.stimuli.sets.manifest import Stimulus

REFUSALS = ("not_felt", "not_answered", "no_replay", "unknown_part", "too_early")
"""Reasons why an act can be refused; the texts are in the catalogue."""


@dataclass(frozen=True, slots=True)
class Surface:
    """The real surface that a recording was taken from."""

    sample: str | None
    picture: Path | None


@dataclass(frozen=True, slots=True)
class Tone:
    """A vibration of one frequency, which no stimulus set holds; or silence of the same duration.

    Parameters
    ----------
    frequency_hz : float
        Its frequency.
    duration_s : float
        Its duration, ramps included.
    level_db : float or None
        Root mean square at the hand, in dB relative to 1 m/s²; None for silence.

    Examples
    --------
    >>> from feel321 import study
    >>> study.Tone(160.0, 0.5, -20.0).scale
    0.1
    """

    frequency_hz: float
    duration_s: float
    level_db: float | None

    @property
    def stimulus_id(self) -> str:
        """Its name, which tells no level.

        Returns
        -------
        str
            Such as `160 Hz`.
        """
        return name_tone(self.frequency_hz)

    @property
    def scale(self) -> float:
        """Root mean square at the hand.

        Returns
        -------
        float
            In m/s²; 0 for silence.
        """
        return 0.0 if self.level_db is None else 10 ** (self.level_db / 20)


@dataclass(frozen=True, slots=True)
class Scaled:
    """A stimulus at another level than that of the study.

    Parameters
    ----------
    stimulus : Stimulus
        The stimulus.
    gain_db : float
        Gain on it, in dB.

    Examples
    --------
    >>> from feel321 import study
    >>> study.Scaled(None, -20.0).scale
    0.1
    """

    stimulus: Stimulus
    gain_db: float

    @property
    def stimulus_id(self) -> str:
        """Its name.

        Returns
        -------
        str
            That of the stimulus.
        """
        return self.stimulus.stimulus_id

    @property
    def duration_s(self) -> float:
        """Its duration.

        Returns
        -------
        float
            In s.
        """
        return self.stimulus.duration_s

    @property
    def scale(self) -> float:
        """Factor on its samples.

        Returns
        -------
        float
            1 for 0 dB.
        """
        return float(10 ** (self.gain_db / 20))


@dataclass(frozen=True)
class Playback(Played):
    """The playback of a stimulus, or a stroke over the real surface.

    Parameters
    ----------
    requested_s : float
        Time at which it was to begin.
    onset_s : float or None
        Time at which it did; None if it never did.
    underruns : int
        Number of times that the device ran dry within the samples; `gap_underruns` of `measured` are those in the
        silence around them, which spoil nothing.
    clipped : int
        Number of samples that were limited.
    completed : bool
        Whether it was felt to its end: the participant may have stopped it.
    error : str
        Message of the device; empty if all went well.
    measured : mapping of str to float
        Measurements of the device, such as its own time of the onset; empty where it measures nothing.
    dac_source : str
        How `onset_s` was got: `device` by its own clock, or `latency` where it gives no such time and its latency was
        added to the time at which it asked for the samples; empty where no device played.
    delivered : mapping of str to float
        What the hand got, compared with what was asked (`actuator.delivered`); with `coherence` if a sensor measured
        it, without if a certificate predicts it; empty if neither did.
    delivered_sha256 : str
        Digest of the file of what was measured or rendered; empty if there is none.
    fault : str
        What is wrong with the rig by this playback, with the coil named (`actuator.faults`); empty if nothing is.
    act : Pause, Abort or None
        Act of the participant that ended it before its time, beyond stopping it.
    """

    act: Pause | Abort | None = None


@dataclass(frozen=True, slots=True)
class Feel:
    """The participant wants to feel a part, or the whole trial again.

    Parameters
    ----------
    time_s : float
        Time of the act.
    part : str
        Name of the part; empty for all parts in order.
    """

    time_s: float
    part: str = ""


@dataclass(frozen=True, slots=True)
class Move:
    """A marker came to rest.

    Parameters
    ----------
    time_s : float
        Time of the act.
    part : str
        The part whose slider it is, as in `Trial.judged`.
    value : float
        Points on the scale.
    """

    time_s: float
    part: str
    value: float


@dataclass(frozen=True, slots=True)
class Confirm:
    """The participant is done with a page or a trial.

    Parameters
    ----------
    time_s : float
        Time of the act.
    values : mapping of str to float or str
        Points, or the part that was chosen, as in `Trial.judged`; the answer by the name of a question, none
        if it was left open; empty for a page.
    response_time_s : float
        Time since the answer became possible, or since the page appeared.
    """

    time_s: float
    values: Mapping[str, float | str]
    response_time_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Pause:
    """The participant wants to pause.

    Parameters
    ----------
    time_s : float
        Time of the act.
    """

    time_s: float


@dataclass(frozen=True, slots=True)
class Abort:
    """The session ends here for today: the participant does not go on, or the window was closed.

    Parameters
    ----------
    time_s : float
        Time of the act.
    reason : str
        The reason in a few words.
    """

    time_s: float
    reason: str


@dataclass(frozen=True, slots=True)
class TimedOut:
    """The time for an answer is over.

    Parameters
    ----------
    time_s : float
        Time at which that was noticed.
    """

    time_s: float


Act = Feel | Move | Confirm | Pause | Abort | TimedOut
"""What a participant does, as a presenter reports it."""


@dataclass(frozen=True, slots=True)
class Place:
    """Progress of a session: trials of the main phase that are done, all of them, and the attempt (from 1).

    fault: what the device says while the experimenter is called; left_s: about how long the rest of the session takes.
    """

    done: int
    total: int
    attempt: int = 1
    fault: str = ""
    left_s: float | None = None


class Presenter(Protocol):
    """The interface of a presenter: it shows and plays, and returns the participant's acts."""

    def show_page(self, page: Page, place: Place) -> Confirm | Pause | Abort:
        """Show a page until it is left, at least for its shortest time.

        Parameters
        ----------
        page : Page
            The page.
        place : Place
            Progress of the session.

        Returns
        -------
        Confirm, Pause or Abort
            The participant's act; a pause on a page changes nothing, for nothing is felt there.
        """

    def show_question(self, question: Question, place: Place) -> Confirm | Pause | Abort:
        """Show a question page until it is answered.

        Parameters
        ----------
        question : Question
            The question.
        place : Place
            Progress of the session; its attempt is how often the question was asked, from 1.

        Returns
        -------
        Confirm, Pause or Abort
            The participant's act.
        """

    def show_trial(self, trial: Trial, scale: Scale, place: Place) -> None:
        """Show a trial, all markers unset.

        Parameters
        ----------
        trial : Trial
            The trial that begins.
        scale : Scale
            The scale of its answer; `further` holds others that it asks for.
        place : Place
            Progress of the session.
        """

    def play(
        self,
        part: Part,
        stimulus: Stimulus | Tone | Scaled,
        *,
        gap_s: float,
        due_s: float | None = None,
    ) -> Playback:
        """Play a stimulus to its end, or until the participant stops it.

        Parameters
        ----------
        part : Part
            The part of the trial.
        stimulus : Stimulus or Tone or Scaled
            The stimulus; a tone, or silence, where a threshold is measured; another level where strength is matched.
        gap_s : float
            Silence before it, in s; none where the participant switches freely.
        due_s : float or None
            Time before which it may not begin; given only where a task has fixed onsets.

        Returns
        -------
        Playback
            How it went.
        """

    def prompt(self, part: Part) -> Playback:
        """Ask the participant to stroke the real surface, and wait until that is done.

        Parameters
        ----------
        part : Part
            The part of the trial.

        Returns
        -------
        Playback
            Its beginning, and whether it was done.
        """

    def wait(self, limit_s: float | None = None) -> Act:
        """Wait for the participant's next act on the trial that is shown.

        Parameters
        ----------
        limit_s : float or None
            Time for the answer, in s, since it became possible; given only where a task has such a limit.

        Returns
        -------
        Feel, Move, Confirm, Pause, Abort or TimedOut
            The participant's act.
        """

    def refuse(self, reason: str, parts: tuple[str, ...]) -> None:
        """Show the participant why an act was not accepted.

        Parameters
        ----------
        reason : str
            One of `REFUSALS`.
        parts : tuple of str
            The parts that it is about.
        """
