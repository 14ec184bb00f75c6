"""Playing a stimulus, or asking for a stroke over the real surface, while the screen goes on."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from study.session.ports import Abort, Feel, Pause, Playback

if TYPE_CHECKING:
    from collections import deque
    from collections.abc import Callable

    from protocols.trial import Part
    from stimuli.manifest import Stimulus
    from study.actuator.output import Output
    from study.screen.desk import Wish
    from study.screen.front import Front
    from study.session.ports import Act

CLOSED = "the window was closed"

SILENCE_S = 1.0
"""How long an output may take to fall silent before its own word on what happened is asked for."""


class Player:
    """Plays stimuli through an output, and heeds what the participant does meanwhile.

    Parameters
    ----------
    front : Front
        What is on the screen.
    output : Output
        What plays stimuli.
    clock : callable
        Gives the time in s since the session began.
    acts : deque of Act
        Takes what the participant wants next, where that ends a playback.
    """

    def __init__(self, front: Front, output: Output, *, clock: Callable[[], float], acts: deque[Act]) -> None:
        self._front, self._output, self._clock, self._acts = front, output, clock, acts

    def play(self, part: Part, stimulus: Stimulus, *, gap_s: float) -> Playback:
        """Play a stimulus to its end, or until the participant stops it.

        Parameters
        ----------
        part : Part
            The part that it is.
        stimulus : Stimulus
            What to play.
        gap_s : float
            Silence before it, in s.

        Returns
        -------
        Playback
            What became of it.
        """
        self._front.view = replace(self._front.view, state="feeling", playing=part.name)
        self._front.show_frame()  # what is announced is on the screen before it is felt
        late = self._front.window.frames.late
        self._output.start(stimulus, gap_s=gap_s)
        try:
            act = self._watch_playing()
        except BaseException:
            self._output.stop()
            raise
        delivery = self._output.collect()
        self._note_felt(part, is_felt=delivery.completed and not delivery.error)
        return Playback(
            requested_s=delivery.requested_s,
            onset_s=delivery.onset_s,
            underruns=delivery.underruns,
            clipped=delivery.clipped,
            completed=delivery.completed,
            error=delivery.error,
            act=act,
            measured={**delivery.measured, "late_frames": self._front.window.frames.late - late},
        )

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
        self._front.view = replace(self._front.view, state="stroking", playing=part.name)
        self._front.show_frame()
        began_s = self._clock()
        while True:
            for wish in self._front.listen():
                if wish.name == "confirm":
                    self._note_felt(part, is_felt=True)
                    return Playback(began_s, began_s)
                if (act := find_end(wish)) is not None:
                    self._note_felt(part, is_felt=False)
                    return Playback(began_s, began_s, completed=False, act=act)

    def _watch_playing(self) -> Pause | Abort | None:
        """Show frames until the output is silent; what ends the trial stops it, and so does feeling another part."""
        act: Pause | Abort | None = None
        stopped_s = float("inf")
        while self._output.is_playing and self._clock() - stopped_s < SILENCE_S:
            for wish in self._front.listen():
                is_switch = wish.name == "feel" and self._front.view.kind == "rows"
                if is_switch:
                    self._acts.append(Feel(wish.time_s, wish.part))
                act = act or find_end(wish)
                if act or is_switch or wish.name == "stop":
                    self._output.stop()
                    stopped_s = min(stopped_s, self._clock())
        return act

    def _note_felt(self, part: Part, *, is_felt: bool) -> None:
        # What was felt to its end stays felt, though it be cut short when it is felt again.
        felt = self._front.view.felt | {part.name} if is_felt else self._front.view.felt
        self._front.view = replace(self._front.view, felt=felt, playing="")


def find_end(wish: Wish) -> Pause | Abort | None:
    """Tell whether a wish ends the trial.

    Parameters
    ----------
    wish : Wish
        What the participant wants.

    Returns
    -------
    Pause, Abort or None
        What ends it; None if it goes on.
    """
    if wish.name == "close":
        return Abort(wish.time_s, CLOSED)
    return Pause(wish.time_s) if wish.name == "pause" else None
