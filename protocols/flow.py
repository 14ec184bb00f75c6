"""How a session goes besides its trials: pages, training, breaks, and what becomes of a bad trial."""

from __future__ import annotations

from dataclasses import dataclass

FLAGS = ("underrun", "clipped", "device_error", "too_fast", "not_felt")
"""What can be wrong with an attempt at a trial."""


@dataclass(frozen=True, slots=True)
class Flow:
    """The rules of a session; they are part of the plan.

    Parameters
    ----------
    break_trials : int or None
        A break after so many trials; None for none.
    break_min : float or None
        A break after so many minutes; None for none.
    break_s, rest_s : float
        Least duration in s of a break, and of the rest without any stimulus that every session has.
    training_pass : float
        Share of expected answers at which training is passed, 0 to 1; what guessing gives does not count.
    training_rounds : int
        Rounds of training before the session goes on without.
    min_response_s : float
        Faster answers, in s, are too fast.
    max_attempts : int
        How often a trial is tried before it is given up; attempts that the device spoiled are not counted.
    reject : tuple of str
        The flags, of `FLAGS`, that make a trial bad: its rating does not count, and it is tried again. Where no
        answer could be given, because the device failed or what is felt once was cut short, it always is.
    gap_s : float
        Silence in s before each part of a trial.
    """

    break_trials: int | None = 60
    break_min: float | None = 10.0
    break_s: float = 30.0
    rest_s: float = 60.0
    training_pass: float = 0.75
    training_rounds: int = 3
    min_response_s: float = 0.2
    max_attempts: int = 3
    reject: tuple[str, ...] = ("underrun", "device_error", "too_fast", "not_felt")
    gap_s: float = 0.5


@dataclass(frozen=True, slots=True)
class Page:
    """A page that the participant reads, and during which nothing is felt.

    Parameters
    ----------
    key : str
        Its text in the catalogue.
    least_s : float
        How long, in s, it stands at least.
    by : str
        Who goes on from it: `participant` or `experimenter`.
    """

    key: str
    least_s: float = 0.0
    by: str = "participant"


PAGES = (
    "welcome",
    "consent",
    "instructions",
    "training",
    "expected",
    "unexpected",
    "training_passed",
    "training_again",
    "training_failed",
    "practice",
    "main",
    "break",
    "rest",
    "pause",
    "warm_up",
    "end",
)
"""Keys of all pages; that of `instructions` is followed by a dot and the protocol."""
