"""Training: feedback after each answer, and rounds until enough of them were right."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from protocols.flow import Page
from protocols.scoring import measure_chance

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from protocols.flow import Flow
    from protocols.trial import Trial


class Training:
    """Who has understood what, so far.

    A round is passed if, of those answers that are not right by guessing, the share that was asked for is right [1]_.
    At 75 % that lets nobody miss one of four, and one of eight where the choice is between two.

    Parameters
    ----------
    trials : sequence of Trial
        All trials of the plan.
    flow : Flow
        The rules of the session.

    References
    ----------
    .. [1] Macmillan, N. A., & Creelman, C. D. (2005). Detection theory: A user's guide (2nd ed.), chapter 4
       (correction for guessing). doi:10.4324/9781410611147
    """

    def __init__(self, trials: Sequence[Trial], flow: Flow) -> None:
        self._trials = [trial for trial in trials if trial.phase == "training"]
        self._flow = flow
        self._rounds: Counter[str] = Counter()
        self._understood: list[bool] = []
        self._guessed = 0.0

    def tell(self, trial: Trial, *, understood: bool | None, is_last: bool) -> Iterator[Page | Trial]:
        """Take an answer, and give what follows from it at once.

        Parameters
        ----------
        trial : Trial
            The trial of training.
        understood : bool or None
            Whether the answer was as expected; None where any will do.
        is_last : bool
            Whether the round ends with it.

        Yields
        ------
        Page or Trial
            The feedback; after a round its outcome, and the next round if it was not passed.
        """
        if understood is not None:
            self._understood.append(understood)
            self._guessed += measure_chance(trial)
            yield Page("expected" if understood else "unexpected")
        if is_last and self._understood:
            yield from self._end_round(trial.protocol)
            self._understood, self._guessed = [], 0.0

    def _end_round(self, protocol: str) -> Iterator[Page | Trial]:
        self._rounds[protocol] += 1
        not_guessed = len(self._understood) - self._guessed
        if max(sum(self._understood) - self._guessed, 0.0) >= self._flow.training_pass * not_guessed:
            yield Page("training_passed")
        elif self._rounds[protocol] >= self._flow.training_rounds:
            yield Page("training_failed", by="experimenter")
        else:
            yield Page("training_again")
            yield from (trial for trial in self._trials if trial.protocol == protocol)
