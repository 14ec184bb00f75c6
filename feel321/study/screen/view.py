"""What is on the screen, as a record: the layout draws it, tests read it, and a simulated participant watches it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from feel321.protocols.texts import PageText

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from feel321.protocols.trial import Page, Scale, Trial
    from feel321.study.session.ports import Place

LAST_PAGE = "end"  # the page after which there is nothing


@dataclass(frozen=True, slots=True)
class View:
    """Everything that is on the screen in one frame.

    kind: "page" to read, one "slider", "rows" with a slider for each vibration, or a "choice" between parts; state:
    "reading" a page, "feeling" a vibration or awaiting it, "stroking" the real surface, "answering".
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
    """Watches the screen frame by frame and may press keys; this one does nothing."""

    def watch(self, view: View) -> None:
        """Look at what is on the screen."""


@dataclass(frozen=True, slots=True)
class ScreenTexts:
    """What participants read besides the scales, in their language."""

    pages: Mapping[str, PageText]
    refusals: Mapping[str, str]
    prompts: Mapping[str, str]
    parts: Mapping[str, str]
    keys: Mapping[str, str]

    def name_part(self, name: str) -> str:
        """Find the word for a part."""
        return self.parts.get(name, name)


def make_screen_texts(tables: Mapping[str, Any]) -> ScreenTexts:
    """Pick the screen's texts from those of a language.

    Examples
    --------
    >>> from feel321.protocols.texts import read_texts
    >>> make_screen_texts(read_texts("de")).pages["pause"].title
    'Pause'
    """
    pages = {key: PageText(key, **entry) for key, entry in tables["pages"].items()}
    return ScreenTexts(
        pages, tables["refusals"], tables["prompts"], tables["parts"], tables["keys"]
    )
