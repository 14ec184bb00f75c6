"""What is on the screen, as a record: the layout draws it, tests read it, and a simulated participant watches it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from protocols.flow import Page
    from protocols.trial import Scale, Trial
    from study.session.ports import Place

KINDS = ("page", "slider", "rows", "choice")
"""Kinds of screens: a page to read; one slider; a row with a slider for each vibration; a choice between parts."""

STATES = ("reading", "feeling", "stroking", "answering")
"""What the participant is to do: read a page, feel a vibration (or await it), stroke the real surface, answer."""

LAST_PAGE = "end"
"""The page after which there is nothing."""


@dataclass(frozen=True, slots=True)
class View:
    """Everything that is on the screen in one frame.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    state : str
        One of `STATES`; keys that answer do something in the last only.
    screen : int
        Counts pages and trials as they are brought up, so that the next one is told from this one.
    place : Place
        How far the session has come.
    page : Page or None
        The page, if it is one.
    trial : Trial or None
        The trial, if it is one.
    scale : Scale or None
        What the trial is answered on.
    playing : str
        Name of the part that is felt or about to be; empty if none is.
    felt : frozenset of str
        Names of the parts that were felt to their ends.
    markers : mapping of str to float
        Points by the part that is judged; a marker that was never moved is not there.
    selected : str
        The part whose marker the keys move.
    chosen : str
        The part that was chosen, where there is a choice.
    typed : str
        Digits that were typed and have not become a value yet.
    left_s : int
        Whole seconds for which a page still stands, rounded up; 0 when it may be left.
    notice : str
        What the participant is told in the last line but one: why something was refused, or that a second Esc pauses.
    picture : Path or None
        A picture of the surface that the trial is about.
    sample : str
        What the surface to stroke is called in the lab.
    """

    kind: str
    state: str
    screen: int
    place: Place
    page: Page | None = None
    trial: Trial | None = None
    scale: Scale | None = None
    playing: str = ""
    felt: frozenset[str] = frozenset()
    markers: Mapping[str, float] = field(default_factory=dict)
    selected: str = ""
    chosen: str = ""
    typed: str = ""
    left_s: int = 0
    notice: str = ""
    picture: Path | None = None
    sample: str = ""

    @property
    def can_answer(self) -> bool:
        """Whether the answer can be changed: once all was felt, or at once where parts are felt at will."""
        if self.trial is None:
            return False
        has_felt = self.felt.issuperset(part.name for part in self.trial.parts)
        return self.state == "answering" or self.trial.timing == "free" or has_felt

    @property
    def can_leave(self) -> bool:
        """Whether there is anything to pause or to end: not on the last page."""
        return self.page is None or self.page.key != LAST_PAGE


class Hand:
    """Whoever watches the screen frame by frame and presses keys: nobody, unless a simulated participant does."""

    def watch(self, view: View) -> None:
        """Look at what is on the screen.

        Parameters
        ----------
        view : View
            What is on the screen since this frame.
        """
