"""Training: feedback after each answer, and rounds until enough of them were right."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from protocols.flow import Page

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from protocols.flow import Flow
    from protocols.trial import Trial


class Training:
    """Who has understood what, so far.

    Parameters
    ----------
    trials : sequence of Trial
        All trials of the plan.
    flow : Flow
        The rules of the session.
    """

    def __init__(self, trials: Sequence[Trial], flow: Flow) -> None:
        self._trials = [trial for trial in trials if trial.phase == "training"]
        self._flow = flow
        self._rounds: Counter[str] = Counter()
        self._understood: list[bool] = []

    def tell(self, protocol: str, *, understood: bool | None, is_last: bool) -> Iterator[Page | Trial]:
        """Take an answer, and give what follows from it at once.

        Parameters
        ----------
        protocol : str
            The task that is trained.
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
            yield Page("expected" if understood else "unexpected")
        if is_last and self._understood:
            share = sum(self._understood) / len(self._understood)
            self._understood = []
            yield from self._end_round(protocol, share)

    def _end_round(self, protocol: str, share: float) -> Iterator[Page | Trial]:
        self._rounds[protocol] += 1
        if share >= self._flow.training_pass:
            yield Page("training_passed")
        elif self._rounds[protocol] >= self._flow.training_rounds:
            yield Page("training_failed")
        else:
            yield Page("training_again")
            yield from (trial for trial in self._trials if trial.protocol == protocol)
