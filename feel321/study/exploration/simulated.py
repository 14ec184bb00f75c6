"""Simulated participants move too: strokes to and fro during every playback that a hand would drive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from feel321.study.exploration.motion import Strokes
from feel321.study.exploration.track import Exploration

if TYPE_CHECKING:
    from feel321.protocols.questions import Question
    from feel321.protocols.trial import Page, Part, Scale, Trial
    from feel321.stimuli.sets.manifest import Stimulus
    from feel321.study.session import ports


class MovingPresenter:
    """A presenter without a device, and the hand of its participant; what it answers is not changed."""

    def __init__(
        self,
        inner: ports.Presenter,
        modes: Mapping[str, str],
        *,
        folder: Path,
        reference_m_s: float,
        seeds: tuple[int, int],
    ) -> None:
        self._inner, self._modes, self._folder = inner, modes, folder
        self._reference_m_s, self._seeds = reference_m_s, seeds
        self._trial: Trial | None = None

    def show_page(
        self, page: Page, place: ports.Place
    ) -> ports.Confirm | ports.Pause | ports.Abort:
        """Show a page."""
        return self._inner.show_page(page, place)

    def show_question(
        self, question: Question, place: ports.Place
    ) -> ports.Confirm | ports.Pause | ports.Abort:
        """Show a question page."""
        return self._inner.show_question(question, place)

    def show_trial(self, trial: Trial, scale: Scale, place: ports.Place) -> None:
        """Begin a trial."""
        self._trial = trial
        self._inner.show_trial(trial, scale, place)

    def play(
        self,
        part: Part,
        stimulus: Stimulus | ports.Tone | ports.Scaled,
        *,
        gap_s: float,
        due_s: float | None = None,
    ) -> ports.Playback:
        """Feel a stimulus while the hand moves."""
        playback = self._inner.play(part, stimulus, gap_s=gap_s, due_s=due_s)
        trial = self._trial
        if trial is None or trial.protocol not in self._modes or playback.onset_s is None:
            return playback
        now_s = [playback.onset_s]
        rng = np.random.default_rng([*self._seeds, trial.number, *part.name.encode()])
        hand = Strokes(lambda: now_s[0], rng, speed_m_s=self._reference_m_s)
        hand.begin()
        now_s[0] += stimulus.duration_s
        own = Exploration(hand, self._modes, self._reference_m_s, 1.0, self._folder)
        timed = replace(playback, measured={"n_samples": stimulus.duration_s})
        return replace(own.finish(timed), measured=playback.measured)

    def prompt(self, part: Part) -> ports.Playback:
        """Stroke the real surface."""
        return self._inner.prompt(part)

    def wait(self, limit_s: float | None = None) -> ports.Act:
        """Wait for the next act."""
        return self._inner.wait(limit_s)

    def refuse(self, reason: str, parts: tuple[str, ...]) -> None:
        """Pass on why an act was not accepted."""
        self._inner.refuse(reason, parts)
