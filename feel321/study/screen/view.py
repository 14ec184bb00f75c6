"""What is on the screen in one frame, who may watch it, and the words on it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from feel321.protocols.texts import PageText, Question
from feel321.protocols.trial import Page, Part, Scale, Trial
from feel321.stimuli.sets.manifest import Stimulus
from feel321.study.keys import USUAL, KeysTable, label_key, label_keys, label_prompts
from feel321.study.session.ports import Place, Scaled, Tone

LAST_PAGE = "end"  # the page after which there is nothing
LOOP = "⟳"


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
    def has_felt_all(self) -> bool:
        """Whether every part of a trial was felt to its end."""
        parts = self.trial.parts if self.trial else ()
        return self.trial is not None and self.felt.issuperset(part.name for part in parts)

    @property
    def can_answer(self) -> bool:
        """Whether the answer can be changed: once all was felt, or at once where parts are felt at will."""
        if self.trial is None:
            return False
        return self.state == "answering" or self.trial.timing == "free" or self.has_felt_all

    def can_rate(self, part: str) -> bool:
        """Whether a part's own marker can be moved: where each part has one, once it was felt to its end."""
        return self.can_answer and (self.kind != "rows" or part in self.felt)

    @property
    def is_done(self) -> bool:
        """Whether all was felt and all is answered."""
        if self.trial is None or not self.has_felt_all:
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
        """Explain why an act was not accepted; where there are several scales, they are numbered."""
        has_scales = trial is not None and any(judgement.scale for judgement in trial.judgements)
        if trial is not None and has_scales and reason == "not_answered":
            parts = [str(trial.judged.index(part) + 1) for part in parts]
        return self.refusals[reason].format(parts=", ".join(map(self.name_part, parts)))


def make_screen_texts(tables: Mapping[str, Any], keys: KeysTable = USUAL) -> ScreenTexts:
    """Pick the screen's texts from those of a language, with the names of the lab's own keys."""
    pages = {key: PageText(key, **entry) for key, entry in tables["pages"].items()}
    lines, asked = tables["keys"], tables["questions"]["prompts"]
    prompts = label_prompts(keys, tables["prompts"], lines)
    labelled = label_keys(keys, lines)
    labelled["confirm_typed"] = lines["confirm"]  # Enter, whatever key confirms elsewhere
    labelled["loop"] = f"{label_key(keys.loop[0], {})}  {LOOP}"
    refusals = {**tables["refusals"], **asked}
    return ScreenTexts(pages, refusals, prompts, tables["parts"], labelled, keys, asked)
