"""Which trial comes next: ask for one, tell when it is done."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    from protocols.trial import Trial


class TrialQueue:
    """The trials that are still to be done, in order.

    Parameters
    ----------
    trials : iterable of Trial
        All trials of a session.

    Examples
    --------
    >>> from protocols.trial import Trial
    >>> queue = TrialQueue([Trial(1, 1, 1, "realism", "realism", "tap")])
    >>> queue.tell(queue.ask().number)
    >>> queue.ask() is None
    True
    """

    def __init__(self, trials: Iterable[Trial]) -> None:
        self._waiting = {trial.number: trial for trial in trials}

    def ask(self) -> Trial | None:
        """Name the next trial.

        Returns
        -------
        Trial or None
            The same one until it is told as done; None when all are.
        """
        return next(iter(self._waiting.values()), None)

    def tell(self, number: int) -> None:
        """Take a trial as done.

        Parameters
        ----------
        number : int
            The trial's number.

        Raises
        ------
        ValueError
            If that trial is not waiting: it is unknown or was done before.
        """
        if self._waiting.pop(number, None) is None:
            raise ValueError(f"trial {number}: is unknown or was done before; each is done once")
