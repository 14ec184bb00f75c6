"""What is on the screen in one frame, the words on it, and the buttons and hints that every screen has."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from feel321.protocols.questions import Question
from feel321.protocols.texts import PageText
from feel321.protocols.trial import Page, Part, Scale, Trial
from feel321.stimuli.sets.manifest import Stimulus
from feel321.study.keys import USUAL, KeysTable, label_key, label_keys, label_prompts
from feel321.study.screen.drawing import GROUND, INK, Box, Sheet, Target
from feel321.study.session.ports import Place, Scaled, Tone

# The three hues are Okabe and Ito's, which every kind of colour vision can distinguish; none of them is the only sign
# of anything.
PANEL, LINE, DIM = "#20252d", "#4a515c", "#b3b8c0"
BLUE, ORANGE = "#56b4e9", "#e69f00"

BODY, SMALL, QUESTION, TITLE = 3.0, 2.8, 4.0, 5.6
"""Sizes of letters (em) in units; at 1 m nothing may be smaller than 2.2 % of the screen's height."""

LAST_PAGE = "end"  # the page after which there is nothing


@dataclass(frozen=True, slots=True)
class View:
    """Everything that is on the screen in one frame.

    kind: "page" to read or to answer, one "slider", "rows" with a slider for each vibration, "scales" with one for each
    scale, or a "choice" between parts; state: "reading" a page, "feeling" a vibration or awaiting it, "stroking" the
    real surface, "answering". Of a question that is answered, its name is in felt.
    """

    kind: str
    state: str
    screen: int
    place: Place
    page: Page | None = None
    question: Question | None = None
    trial: Trial | None = None
    scale: Scale | None = None
    playing: str = ""
    felt: frozenset[str] = frozenset()
    markers: Mapping[str, float] = field(default_factory=dict)
    selected: str = ""
    chosen: str = ""
    typed: str = ""
    loops: bool = False
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

    def can_rate(self, part: str) -> bool:
        """Whether a part's own marker can be moved: where each part has one, once it was felt to its end."""
        return self.can_answer and (self.kind != "rows" or part in self.felt)

    @property
    def is_done(self) -> bool:
        """Whether all was felt and all is answered."""
        if self.trial is None or not self.felt.issuperset(part.name for part in self.trial.parts):
            return False
        return bool(self.chosen) or self.markers.keys() >= set(self.trial.judged)

    @property
    def can_leave(self) -> bool:
        """Whether there is anything to pause or to end: not on the last page."""
        return self.page is None or self.page.key != LAST_PAGE


class Hand:
    """Watches the screen frame by frame and may press keys; this one does nothing."""

    def watch(self, view: View) -> None:
        """Look at what is on the screen."""

    def feel(self, part: Part, stimulus: Stimulus | Tone | Scaled) -> None:
        """Feel what is played."""


@dataclass(frozen=True, slots=True)
class ScreenTexts:
    """What participants read besides the scales, in their language; keys: what they do, in words and as they are.

    questions: words on question pages.
    """

    pages: Mapping[str, PageText]
    refusals: Mapping[str, str]
    prompts: Mapping[str, str]
    parts: Mapping[str, str]
    keys: Mapping[str, str]
    own_keys: KeysTable = USUAL
    questions: Mapping[str, str] = field(default_factory=dict)

    def name_part(self, name: str) -> str:
        """Find the word for a part."""
        return self.parts.get(name, name)

    def explain(self, reason: str, parts: Sequence[str], trial: Trial | None) -> str:
        """Explain why an act was not accepted."""
        if trial is not None and any(judgement.scale for judgement in trial.judgements):
            # Where there are several scales, they are numbered.
            judged = trial.judged
            is_numbered = reason == "not_answered"
            parts = [str(judged.index(part) + 1) if is_numbered else part for part in parts]
        return self.refusals[reason].format(parts=", ".join(map(self.name_part, parts)))


def make_screen_texts(tables: Mapping[str, Any], keys: KeysTable = USUAL) -> ScreenTexts:
    """Pick the screen's texts from those of a language, with the names of the lab's own keys."""
    pages = {key: PageText(key, **entry) for key, entry in tables["pages"].items()}
    lines, parts = tables["keys"], tables["parts"]
    prompts = label_prompts(keys, tables["prompts"], lines)
    labelled = label_keys(keys, lines)
    labelled["loop"] = f"{label_key(keys.loop[0], {})}  {LOOP}"
    asked = tables["questions"]["prompts"]
    refusals = {**tables["refusals"], **asked}
    return ScreenTexts(pages, refusals, prompts, parts, labelled, keys, asked)


FELT, LOOP = "✓", "⟳"

LINES = 3  # most lines of a question


# Buttons, and keys that have none.


@dataclass(frozen=True, slots=True)
class Button:
    """A button; share: how much of the time until it is ready has gone by, from 0 to 1.

    explains: whether it can be clicked before it is ready, to learn what is missing.
    """

    text: str
    name: str
    is_main: bool = False
    is_ready: bool = True
    share: float = 0.0
    explains: bool = False


def split_key(text: str) -> tuple[str, str]:
    """Split "Esc twice  pause" into the key and what it does."""
    key, _, action = text.partition("  ")
    return key, action[:1].upper() + action[1:]


def add_buttons(sheet: Sheet, left: Sequence[Button], right: Sequence[Button]) -> None:
    """Put buttons at both ends of their strip."""
    strip, gap = sheet.find_strip("buttons"), 2 * sheet.unit
    widths = {}
    for button in (*left, *right):
        key, action = split_key(button.text)
        words = sheet.measure(action, SMALL, bold=True) + sheet.measure(key, SMALL)
        widths[button] = words + 6.5 * sheet.unit
    start = strip.right - sum(widths[button] for button in right) - gap * (len(right) - 1)
    for place, buttons in ((strip.left, left), (start, right)):
        for button in buttons:
            box = Box(place, strip.top, widths[button], strip.height)
            add_button(sheet, button, box)
            if button.is_ready or button.explains:
                sheet.targets.append(Target(box, button.name))
            place = box.right + gap  # noqa: PLW2901 - walks along the strip


def add_button(sheet: Sheet, button: Button, box: Box) -> None:
    """Draw a button: what it does, then the key that does the same."""
    unit, (key, action) = sheet.unit, split_key(button.text)
    is_filled = button.is_main and button.is_ready
    action_color = INK if button.is_ready or button.share else DIM
    key_color = INK if button.share else DIM
    left = box.left + 2.5 * unit
    words = Box(left, box.top, sheet.measure(action, SMALL, bold=True), box.height)
    cap = Box(words.right + 1.5 * unit, box.top, sheet.measure(key, SMALL), box.height)
    fill, line = (BLUE, "") if is_filled else (PANEL, LINE)
    sheet.fill(box, fill, line=line, round_px=1.2 * unit, line_px=0.25 * unit)
    if button.share:
        gone = Box(box.left, box.top, box.width * button.share, box.height)
        sheet.fill(gone, LINE, round_px=1.2 * unit)
    sheet.write(words, action, SMALL, color=GROUND if is_filled else action_color, bold=True)
    sheet.write(cap, key, SMALL, color=GROUND if is_filled else key_color)


def add_hints(sheet: Sheet, texts: Sequence[str]) -> None:
    """Write in one line what keys do that have no button."""
    unit, strip = sheet.unit, sheet.find_strip("hints")
    words = []
    for text in texts:
        key, _, action = text.partition("  ")
        words += [(key, True, 1.0 * unit), (action, False, 4.5 * unit)]
    widths = [sheet.measure(word, SMALL, bold=bold) for word, bold, _ in words]
    left = (sheet.width - sum(widths) - sum(gap for *_, gap in words[:-1])) / 2
    for (word, bold, gap), width in zip(words, widths, strict=True):
        sheet.write(Box(left, strip.top, width, strip.height), word, SMALL, color=DIM, bold=bold)
        left += width + gap
