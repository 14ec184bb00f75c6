"""Simulated participants: a presenter without screen and actuators.

What participants answer stands in `participant`, how stimuli feel to them in `judging`, who they are in `raters`.
Their clock is what stimuli, pages and answers take, so that a session of an hour is over in a second.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from study.observer.judging import REAL, Experience, Point
from study.observer.participant import Participant
from study.observer.raters import ObserverModel
from study.session.ports import Confirm, Feel, Playback

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from protocols.flow import Page
    from protocols.trial import Part, Scale, Trial
    from stimuli.manifest import Stimulus
    from study.observer.percepts import Percept
    from study.session.ports import Act, Place

__all__ = ["ObserverModel", "SimulatedObserver", "identify_observer"]

STROKE_S = 3.0
"""How long the real surface is stroked."""


class SimulatedObserver(Participant):
    """A participant who needs no screen and no actuator.

    Parameters
    ----------
    model : ObserverModel
        How participants feel.
    seed : int
        Seed of all draws.
    number : int
        The participant's number.
    percepts : mapping of str to Percept
        Percept of each stimulus by its id; needed where the model uses them.
    elapsed_s : float
        Where the participant's clock stands: 0, or where a session that is resumed was broken off.
    """

    def __init__(
        self,
        model: ObserverModel,
        *,
        seed: int,
        number: int,
        percepts: Mapping[str, Percept] = MappingProxyType({}),
        elapsed_s: float = 0.0,
    ) -> None:
        super().__init__(model, seed=seed, number=number, percepts=percepts)
        self._clock = _Clock(elapsed_s)
        self._confirmed: Experience | None = None
        self._missed: tuple[str, ...] = ()

    def show_page(self, page: Page, place: Place) -> Confirm:  # noqa: ARG002 - the port's form
        """Read a page for as long as it must stand.

        Parameters
        ----------
        page : Page
            The page.
        place : Place
            How far the session has come.

        Returns
        -------
        Confirm
            At the first moment at which that can be done.
        """
        self._clock.spend(page.least_s)
        return Confirm(self._clock.time_s, {}, page.least_s)

    def show_trial(self, trial: Trial, scale: Scale, place: Place) -> None:
        """Take note of the trial.

        Parameters
        ----------
        trial : Trial
            The trial that begins.
        scale : Scale
            The scale that it will be answered on.
        place : Place
            How far the session has come.
        """
        self.before, self._confirmed = self._confirmed or self.before, None
        self._points: dict[str, Point] = {}
        self._acts = self._take_part(Experience(trial, self._points), scale, place)

    def play(self, part: Part, stimulus: Stimulus, *, gap_s: float) -> Playback:
        """Feel a stimulus.

        Parameters
        ----------
        part : Part
            The part that it is.
        stimulus : Stimulus
            What to feel.
        gap_s : float
            Silence before it, in s.

        Returns
        -------
        Playback
            Without fault.
        """
        self._points[part.name] = self.touch.locate(stimulus)
        return self._clock.play(gap_s, stimulus.duration_s)

    def prompt(self, part: Part) -> Playback:
        """Stroke the real surface.

        Parameters
        ----------
        part : Part
            The part that it is.

        Returns
        -------
        Playback
            Without fault.
        """
        self._points[part.name] = REAL
        return self._clock.play(0.0, STROKE_S)

    def wait(self) -> Act:
        """Do the next thing: feel what can be felt at will, confirm.

        Returns
        -------
        Feel or Confirm
            What was done.
        """
        return next(self._acts)

    def refuse(self, reason: str, parts: tuple[str, ...]) -> None:
        """Hear that an answer was not accepted: what was not felt is felt before the same answer is given again.

        Parameters
        ----------
        reason : str
            Why.
        parts : tuple of str
            What is missing.
        """
        self._missed = parts if reason == "not_felt" else ()
        self._confirmed = None

    def _take_part(self, experience: Experience, scale: Scale, place: Place) -> Iterator[Act]:
        trial = experience.trial
        if trial.timing == "free":
            for part in trial.parts:
                yield Feel(self._clock.time_s, part.name)
        values, response_s = self.answer(experience, scale, place)
        asked_s = self._clock.time_s
        self._clock.spend(response_s)
        while True:
            if trial.phase == "main":
                self._confirmed = experience
            yield Confirm(self._clock.time_s, values, round(self._clock.time_s - asked_s, 3))
            for name in self._missed:
                yield Feel(self._clock.time_s, name)


@dataclass(slots=True)
class _Clock:
    """The participant's own time, in s; what is reported is what it reads, in ms."""

    time_s: float

    def spend(self, duration_s: float) -> None:
        self.time_s = round(self.time_s + duration_s, 3)

    def play(self, gap_s: float, duration_s: float) -> Playback:
        self.spend(gap_s)
        onset_s = self.time_s
        self.spend(duration_s)
        return Playback(requested_s=onset_s, onset_s=onset_s)


def identify_observer(model: ObserverModel, *, seed: int) -> dict[str, Any]:
    """Say what the answers of simulated participants depend on, for the header of their journals.

    Parameters
    ----------
    model : ObserverModel
        How participants feel.
    seed : int
        Seed of all draws.

    Returns
    -------
    dict
        Everything, as JSON can hold it.
    """
    return {"simulated": True, "seed": seed, "observer": asdict(model)}
