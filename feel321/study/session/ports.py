"""What a session needs of the world: someone who shows, plays and passes on what the participant does.

The simulated observer implements this port today; a screen with actuators will. The rules (what must be felt, what
is refused, what is tried again) are the engine's: a presenter only shows, plays and reports. All times are in s
since the session began, on the presenter's own clock, which goes on where it stopped when a session is resumed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping

    from feel321.protocols.trial import Page, Part, Scale, Trial
    from feel321.stimuli.sets.manifest import Stimulus


@dataclass(frozen=True, slots=True)
class Playback:
    """What became of a stimulus on its way to the hand, or of a stroke over the real surface.

    Parameters
    ----------
    requested_s : float
        When it was to begin.
    onset_s : float or None
        When it did; None if it never did.
    underruns : int
        How often the device ran dry.
    clipped : int
        How many samples were limited.
    completed : bool
        Whether it was felt to its end: the participant may have stopped it.
    error : str
        What the device reported; empty if all went well.
    act : Pause, Abort or None
        What the participant did that ended it before its time, beyond stopping it.
    measured : mapping of str to float
        What the device measured, such as its own time of the onset; empty where it measures nothing.
    """

    requested_s: float
    onset_s: float | None
    underruns: int = 0
    clipped: int = 0
    completed: bool = True
    error: str = ""
    act: Pause | Abort | None = None
    measured: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Feel:
    """The participant wants to feel a part, or the whole trial again.

    Parameters
    ----------
    time_s : float
        When.
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
        When.
    part : str
        The part whose slider it is.
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
        When.
    values : mapping of str to float or str
        Points, or the part that was chosen, by the part that is judged; empty for a page.
    response_time_s : float
        Since the answer became possible, or since the page appeared.
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
        When.
    """

    time_s: float


@dataclass(frozen=True, slots=True)
class Abort:
    """The session ends here for today: the participant does not go on, or the window was closed.

    Parameters
    ----------
    time_s : float
        When.
    reason : str
        Why, in a few words.
    """

    time_s: float
    reason: str


Act = Feel | Move | Confirm | Pause | Abort


@dataclass(frozen=True, slots=True)
class Place:
    """How far a session has come, for whoever shows it.

    Parameters
    ----------
    done, total : int
        Trials of the main phase that are done, and all of them.
    attempt : int
        Which attempt at the trial this is, from 1.
    """

    done: int
    total: int
    attempt: int = 1


class Presenter(Protocol):
    """Whoever presents a session to a participant."""

    def show_page(self, page: Page, place: Place) -> Confirm | Pause | Abort:
        """Show a page until whoever it is for is done with it, at least as long as it is to stand.

        Parameters
        ----------
        page : Page
            What to show.
        place : Place
            How far the session has come.

        Returns
        -------
        Confirm, Pause or Abort
            What the participant did; a pause on a page is none, for nothing is felt there.
        """

    def show_trial(self, trial: Trial, scale: Scale, place: Place) -> None:
        """Bring a trial before the participant, all markers unset.

        Parameters
        ----------
        trial : Trial
            The trial that begins.
        scale : Scale
            The scale that it will be answered on.
        place : Place
            How far the session has come.
        """

    def play(self, part: Part, stimulus: Stimulus, *, gap_s: float) -> Playback:
        """Play a stimulus to its end, or until the participant stops it.

        Parameters
        ----------
        part : Part
            The part that it is.
        stimulus : Stimulus
            What to play.
        gap_s : float
            Silence before it, in s; none where the participant switches freely.

        Returns
        -------
        Playback
            What became of it.
        """

    def prompt(self, part: Part) -> Playback:
        """Ask the participant to stroke the real surface, and wait until that is done.

        Parameters
        ----------
        part : Part
            The part that it is.

        Returns
        -------
        Playback
            When it began, and whether it was done.
        """

    def wait(self) -> Act:
        """Wait for the participant's next act on the trial that is shown.

        Returns
        -------
        Feel, Move, Confirm, Pause or Abort
            What the participant did.
        """

    def refuse(self, reason: str, parts: tuple[str, ...]) -> None:
        """Tell the participant why an act was not accepted.

        Parameters
        ----------
        reason : str
            One of `REFUSALS`.
        parts : tuple of str
            The parts that it is about.
        """


REFUSALS = ("not_felt", "not_answered", "no_replay", "unknown_part", "too_early")
"""Why an act can be refused; the texts are in the catalogue."""
