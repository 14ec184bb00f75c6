"""What a session needs of the world: someone who shows, plays and asks.

The simulated observer implements this port today; a screen with actuators will. All times are in s since the
session began, on the presenter's own clock, which goes on where it stopped when a session is resumed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from protocols.trial import Scale, Trial
    from stimuli.manifest import Stimulus


@dataclass(frozen=True, slots=True)
class Playback:
    """What became of a stimulus on its way to the hand.

    Parameters
    ----------
    requested_s, onset_s : float
        When it was to begin and when it did.
    underruns : int
        How often the device ran dry.
    clipped : int
        How many samples were limited.
    """

    requested_s: float
    onset_s: float
    underruns: int = 0
    clipped: int = 0


@dataclass(frozen=True, slots=True)
class Answer:
    """A rating.

    Parameters
    ----------
    rating : float
        Points on the scale, 0 to 100.
    response_time_s : float
        From the appearance of the scale to the confirmation.
    time_s : float
        When it was confirmed.
    """

    rating: float
    response_time_s: float
    time_s: float


@dataclass(frozen=True, slots=True)
class Replay:
    """The participant's wish, instead of an answer, to feel the trial once more."""


class Presenter(Protocol):
    """Whoever presents a session to a participant."""

    def show(self, trial: Trial, scale: Scale) -> None:
        """Bring the trial before the participant.

        Parameters
        ----------
        trial : Trial
            The trial that begins.
        scale : Scale
            The scale that it will be rated on.
        """

    def play(self, stimulus: Stimulus) -> Playback:
        """Play a stimulus to its end.

        Parameters
        ----------
        stimulus : Stimulus
            What to play.

        Returns
        -------
        Playback
            What became of it.
        """

    def ask(self, scale: Scale) -> Answer | Replay:
        """Wait until the participant has answered.

        Parameters
        ----------
        scale : Scale
            The scale to rate on.

        Returns
        -------
        Answer or Replay
            The rating, or the wish to feel the trial again.
        """
