"""What a screen needs of the actuators: play a stimulus, stop it, say what became of it.

A stream to a device and a rendering to files are both outputs. All times are in s on the session's clock.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping

    from stimuli.manifest import Stimulus

Clock = Callable[[], float]
"""Tells the time in s since the session began, with what earlier openings of it took."""


@dataclass(frozen=True, slots=True)
class Delivery:
    """What became of one stimulus.

    Parameters
    ----------
    requested_s : float
        When it was to begin.
    onset_s : float or None
        When it did; None if it never did.
    underruns : int
        How often the device ran dry, from the start to the end of the stimulus.
    clipped : int
        How many samples the limiter changed.
    completed : bool
        Whether it was played to its end.
    error : str
        What the device reported; empty if all went well.
    measured : mapping of str to float
        What the output measured besides, for the journal.
    """

    requested_s: float
    onset_s: float | None
    underruns: int = 0
    clipped: int = 0
    completed: bool = True
    error: str = ""
    measured: Mapping[str, float] = field(default_factory=dict)


class Output(Protocol):
    """Whatever plays stimuli, one at a time."""

    @property
    def identity(self) -> Mapping[str, Any]:
        """What plays: rig, device, rate, channels; stands in the journal's header and is compared on resume."""

    def start(self, stimulus: Stimulus, *, gap_s: float) -> None:
        """Schedule silence, then a stimulus, and return at once.

        Parameters
        ----------
        stimulus : Stimulus
            What to play.
        gap_s : float
            Silence before it, in s; longer where masking has to begin first.
        """

    @property
    def is_playing(self) -> bool:
        """Whether the stimulus that was started last is not over yet, its silence included."""

    def stop(self) -> None:
        """Fall silent within one block; what was playing was then not completed."""

    def collect(self) -> Delivery:
        """Tell what became of the stimulus that was started last, once it no longer plays.

        Returns
        -------
        Delivery
            What became of it; a dead device stands in `error`.
        """
