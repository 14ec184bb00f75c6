"""Simulated participants: ratings that follow known perceptual distances, by known rules.

Percept of a stimulus, in points: intercept + spectral weight * spectral match (cut to 0..1) + temporal
weight * temporal match. Rating: bias + gain * percept + noise, cut to 0..100; bias, gain and size of the noise
are the participant's own. Every draw depends on seed, participant and trial alone, so that a session that was
broken off and resumed gives the ratings of one that was not.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from protocols.trial import RATING_RANGE
from study.ports import Answer, Playback

if TYPE_CHECKING:
    import numpy as np

    from protocols.trial import Scale, Trial
    from stimuli.manifest import Stimulus

GAP_S = 0.5
"""Silence between two stimuli of a trial."""


@dataclass(frozen=True, slots=True)
class ObserverModel:
    """How simulated participants feel, and how they differ.

    Parameters
    ----------
    intercept : float
        Percept of a stimulus that matches in nothing, in points.
    spectral, temporal : float
        What a perfect spectral or temporal match adds, in points; 0 plants no effect.
    bias_sd : float
        Standard deviation of the participants' biases, in points.
    gain_sd : float
        Standard deviation of the logarithms of their gains.
    noise_sd : float
        Median size of their noise, in points.
    noise_spread : float
        Standard deviation of the logarithms of its size.
    """

    intercept: float
    spectral: float
    temporal: float
    bias_sd: float
    gain_sd: float
    noise_sd: float
    noise_spread: float


class SimulatedObserver:
    """A participant who needs no screen and no actuator.

    Parameters
    ----------
    model : ObserverModel
        How participants feel.
    seed : int
        Seed of all draws.
    number : int
        The participant's number.
    elapsed_s : float
        Where the participant's clock stands: 0, or where a session that is resumed was broken off.
    """

    def __init__(self, model: ObserverModel, *, seed: int, number: int, elapsed_s: float = 0.0) -> None:
        self._model, self._seed, self._number = model, seed, number
        rng = self._draw_from(0)
        self._bias = rng.normal(0, model.bias_sd)
        self._gain = rng.lognormal(0, model.gain_sd)
        self._noise_sd = model.noise_sd * rng.lognormal(0, model.noise_spread)
        self._time_s = elapsed_s
        self._trial_number = 0
        self._felt: Stimulus | None = None

    def show(self, trial: Trial, scale: Scale) -> None:  # noqa: ARG002 - the port's form; nobody reads the texts
        """Take note of the trial.

        Parameters
        ----------
        trial : Trial
            The trial that begins.
        scale : Scale
            The scale that it will be rated on.
        """
        self._trial_number = trial.number

    def play(self, stimulus: Stimulus) -> Playback:
        """Feel a stimulus.

        Parameters
        ----------
        stimulus : Stimulus
            What to feel.

        Returns
        -------
        Playback
            Without fault.
        """
        onset_s = self._time_s + GAP_S
        self._time_s = onset_s + stimulus.duration_s
        self._felt = stimulus
        return Playback(requested_s=round(onset_s, 3), onset_s=round(onset_s, 3))

    def ask(self, scale: Scale) -> Answer:  # noqa: ARG002 - the port's form; every scale has the same points
        """Rate what was felt last.

        Parameters
        ----------
        scale : Scale
            The scale to rate on.

        Returns
        -------
        Answer
            The rating.

        Raises
        ------
        ValueError
            If nothing was felt yet.
        """
        if self._felt is None:
            raise ValueError("simulated observer: was asked before anything was played; play first")
        rng = self._draw_from(self._trial_number)
        rating = self._bias + self._gain * feel(self._felt, self._model) + rng.normal(0, self._noise_sd)
        response_time_s = rng.lognormal(0.7, 0.4)
        self._time_s = round(self._time_s + response_time_s, 3)
        low, high = RATING_RANGE
        return Answer(round(min(max(rating, low), high), 1), round(response_time_s, 3), self._time_s)

    def _draw_from(self, trial_number: int) -> np.random.Generator:
        import numpy as np

        return np.random.default_rng([self._seed, self._number, trial_number])


def identify_observer(model: ObserverModel, *, seed: int) -> dict[str, Any]:
    """Say what the ratings of simulated participants depend on, for the header of their journals.

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


def feel(stimulus: Stimulus, model: ObserverModel) -> float:
    """Percept of a stimulus, before a participant's bias, gain and noise.

    Parameters
    ----------
    stimulus : Stimulus
        What is felt.
    model : ObserverModel
        How participants feel.

    Returns
    -------
    float
        Percept in points.
    """
    spectral = min(max(stimulus.spectral_match, 0.0), 1.0)
    return model.intercept + model.spectral * spectral + model.temporal * stimulus.temporal_match
