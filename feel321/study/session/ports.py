"""The port between a session and its participant: a presenter shows, plays and passes on the participant's acts.

Implemented by `SimulatedObserver` and `ScreenPresenter`. The rules (what must be felt, what is refused, what is tried
again) are the engine's. All times are in s since the session began, on the presenter's own clock, which goes on where
it stopped when a session is resumed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol, TypeAlias

from feel321.protocols.texts import Question
from feel321.protocols.threshold import name_tone
from feel321.protocols.trial import Page, Part, Scale, Trial
from feel321.stimuli.sets.manifest import Stimulus
from feel321.study.session.events import Played


class Surface(NamedTuple):
    """The real surface that a recording was taken from."""

    sample: str | None
    picture: Path | None


@dataclass(frozen=True, slots=True)
class Tone:
    """A vibration of one frequency, ramps included; level_db: RMS at the hand, dB re 1 m/s², None for silence."""

    frequency_hz: float
    duration_s: float
    level_db: float | None

    @property
    def stimulus_id(self) -> str:
        """Its name, which tells no level."""
        return name_tone(self.frequency_hz)

    @property
    def scale(self) -> float:
        """Root mean square at the hand in m/s²; 0 for silence."""
        return 0.0 if self.level_db is None else 10 ** (self.level_db / 20)


@dataclass(frozen=True, slots=True)
class Scaled:
    """A stimulus at another level than that of the study."""

    stimulus: Stimulus
    gain_db: float

    @property
    def stimulus_id(self) -> str:
        """That of the stimulus."""
        return self.stimulus.stimulus_id

    @property
    def duration_s(self) -> float:
        """That of the stimulus."""
        return self.stimulus.duration_s

    @property
    def scale(self) -> float:
        """Factor on its samples; 1 for 0 dB."""
        return float(10 ** (self.gain_db / 20))


Felt: TypeAlias = Stimulus | Tone | Scaled


@dataclass(frozen=True, slots=True)
class Act:
    """What the participant does, and when."""

    time_s: float


class Pause(Act):
    """The participant wants to pause."""


class TimedOut(Act):
    """The time for an answer is over."""


@dataclass(frozen=True, slots=True)
class Abort(Act):
    """The session ends here for today: the participant does not go on, or the window was closed."""

    reason: str


@dataclass(frozen=True)
class Playback(Played):
    """The playback of a stimulus, or a stroke over the real surface; act: by which the participant cut it short."""

    act: Pause | Abort | None = None


@dataclass(frozen=True, slots=True)
class Feel(Act):
    """The participant wants to feel a part, or all parts again (part is empty)."""

    part: str = ""


@dataclass(frozen=True, slots=True)
class Move(Act):
    """A marker came to rest; part: as in `Trial.judged`, value: in points."""

    part: str
    value: float


@dataclass(frozen=True, slots=True)
class Confirm(Act):
    """The participant is done with a page, a question or a trial.

    values: by `Trial.judged`, or by the name of a question. response_time_s: since an answer became possible, or the
    page appeared.
    """

    values: Mapping[str, float | str] = field(default_factory=dict)
    response_time_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Place:
    """Progress of a session: trials of the main phase that are answered, given up, and all of them."""

    answered: int
    total: int
    attempt: int = 1  # at the trial or question
    given_up: int = 0
    fault: str = ""  # what the device says while the experimenter is called
    notice: str = ""  # what is wrong with the rig, though trials count; said once
    left_s: float | None = None  # about how long the rest of the session takes
    stopped: str = ""  # why it ended early

    @property
    def done(self) -> int:
        """Trials that need no further attempt."""
        return self.answered + self.given_up


class Presenter(Protocol):
    """The interface of a presenter: it shows and plays, and returns the participant's acts."""

    def show_page(self, page: Page, place: Place) -> Confirm | Pause | Abort:
        """Show a page until it is left; a pause changes nothing there, for nothing is felt."""

    def show_question(self, question: Question, place: Place) -> Confirm | Pause | Abort:
        """Show a question page until it is answered; the attempt is how often the question was asked."""

    def show_trial(self, trial: Trial, scale: Scale, place: Place) -> None:
        """Show a trial, all markers unset; the scale's `further` holds others that the trial asks for."""

    def play(
        self, part: Part, stimulus: Felt, *, gap_s: float, due_s: float | None = None
    ) -> Playback:
        """Play a stimulus after a silence, to its end or until the participant stops it; not before it is due."""

    def prompt(self, part: Part) -> Playback:
        """Ask the participant to stroke the real surface, and wait until that is done."""

    def wait(self, limit_s: float | None = None) -> Act:
        """Wait for the next act on the trial that is shown; limit_s: since an answer became possible."""

    def refuse(self, reason: str, parts: tuple[str, ...]) -> None:
        """Show the participant why an act was not accepted (a key of the texts), and which parts it is about."""
