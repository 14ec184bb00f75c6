"""Sessions shown again: in the participant's window, or on a page of one file; and rehearsals, as such a page.

Nothing of the study is written. A replay shows what was answered, so it is not blind; stimuli have numbers, not names.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feel321.analysis.page import render_template, write_script_data
from feel321.analysis.words import capitalise, format_name
from feel321.files import is_held, temporary_folder
from feel321.protocols.agenda import Agenda
from feel321.protocols.texts import make_scales
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.keys import USUAL, KeysTable
from feel321.study.monitor.media import SoundBank, read_words, write_svg
from feel321.study.monitor.script import Cast, Shot, make_shots
from feel321.study.observer.casting import cast_observers
from feel321.study.observer.simulated import SimulatedObserver
from feel321.study.people import LOCK_FILE
from feel321.study.screen import view as ui
from feel321.study.screen.drawing import GROUND
from feel321.study.screen.layout import compose
from feel321.study.session import events
from feel321.study.session.codes import list_by_code
from feel321.study.session.engine import run_session
from feel321.study.session.identity import UNCOMPARED, find_differences
from feel321.study.session.journal import PARTICIPANT_ID, Records, create_journal, read_journal
from feel321.study.session.plan import PLANNED, Plan, make_plan, require_own_plan
from feel321.study.settings import read

if TYPE_CHECKING:
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.folder import StudyFolder
    from feel321.study.screen.drawing import Sheet
    from feel321.study.screen.input import InputEvent
    from feel321.study.screen.window import Window
    from feel321.study.session.journal import Clock
    from feel321.study.session.ports import Presenter
    from feel321.study.settings.schema import Settings

PAGE_SIZE = (1280, 800)
"""Screens on a page, in pixels; they scale with it."""

READING_S = 5.0
"""How long a page stands in a rehearsal, whose simulated participant does not read."""

REHEARSAL = "Rehearsal"

PLAINLY = {
    "texts_sha256": "other texts for participants",
    "consent": "another text of consent",
    "plan_sha256": "another plan",
    "stimuli_sha256": "another stimulus set",
}
"""Differences in words, where the values tell nobody anything."""

OWN_PAGE = '<meta name="generator" content="feel321 replay">'
"""Tells a page of this module from other files."""

STUDY_FOLDERS = ("sessions", "rehearsals", "stimuli", "recordings", "calibration")
"""Folders of a study in which only feel321 itself, or the lab, writes."""


def check_out(study: StudyFolder, out: Path) -> None:
    """Refuse to write a page over anything but such a page, or into the study's own folders."""
    for name in STUDY_FOLDERS:
        if out.resolve().is_relative_to((study.path / name).resolve()):
            raise ValueError(f"--out must not lie in the study's {name}/, got {out}")
    if not out.exists():
        return
    with out.open("rb") as file:
        head = file.read(4096)
    if not (head.lstrip().startswith(b"<!DOCTYPE html>") and OWN_PAGE.encode() in head):
        raise FileExistsError(
            f"{out}: exists and is no replay or rehearsal of feel321, so it is not overwritten; choose another name"
        )


@dataclass(frozen=True, slots=True)
class Film:
    """A session ready to be shown; mark: what stands on each screen besides; changes: of the study since then."""

    study: StudyFolder
    settings: Settings
    cast: Cast
    records: Records
    shots: Sequence[Shot]
    mark: str = ""
    changes: Sequence[str] = ()

    @property
    def length_s(self) -> float:
        """How long it is at its own speed."""
        known_s = max(self.shots[-1].at_s, self.records.find_elapsed()) if self.shots else 0.0
        return known_s + 1.0

    def compose(self, shot: Shot, size: tuple[int, int]) -> Sheet:
        """Lay out one screen."""
        sheet = compose(shot.view, self.cast.texts, size=size)
        if self.mark:
            mark_sheet(sheet, self.mark)
        return sheet


def mark_sheet(sheet: Sheet, words: str = REHEARSAL) -> None:
    """Write on a screen what it is."""
    top = sheet.find_strip("top")
    sheet.write(top, words, ui.SMALL, color=ui.ORANGE, bold=True, align="center")


def read_film(
    study: StudyFolder, participant: str, *, session: int | None = None, while_running: bool = False
) -> Film:
    """Read a participant's session, the newest unless another is asked for."""
    if not PARTICIPANT_ID.fullmatch(participant):
        raise ValueError(f"--participant must be letters, digits, - and _, got {participant!r}")
    folder = study.sessions / participant
    files = sorted(folder.glob("session-*.jsonl"))
    numbers = {int(path.stem[8:]): path for path in files if path.stem[8:].isdigit()}
    if not numbers:
        known = ", ".join(path.name for path in study.participants) or "nobody"
        raise FileNotFoundError(f"{folder}: no session of {participant}; there is {known}")
    if session is not None and session not in numbers:
        raise ValueError(f"--session must be one of {', '.join(map(str, numbers))}, got {session}")
    if is_held(folder / LOCK_FILE) and not while_running:
        raise BlockingIOError(
            f"{folder}: the session is running, and a replay shows its answers; wait, or add --while-running"
        )
    records = read_journal(numbers[session or max(numbers)]).records
    settings = read.read_settings(study.settings)
    plan, stimuli = require_own_plan(folder), read_stimuli(study.stimuli)
    cast = _make_cast(study, settings, plan=plan, stimuli=stimuli)
    if not records:
        raise ValueError(f"{numbers[session or max(numbers)]}: holds no record yet")
    film = _make_film(study, settings, cast=cast, records=records)
    return replace(film, changes=find_changes(film, stimuli))


def find_changes(film: Film, stimuli: StimulusSet) -> list[str]:
    """List in what the study is not as it was when the session began, as far as that is shown."""
    header, plan = film.records.find_header(), film.cast.plan
    if header is None:
        return ["the journal has no header, which says what the session was begun with"]
    own = (plan.participant, plan.sha256, stimuli.sha256, plan.seed)
    try:
        today = read.make_identity(film.settings, film.study.path, {})
    except (OSError, ValueError) as error:
        return [f"what the study is today cannot be compared: {error}"]
    ignored = (*UNCOMPARED, "presenter", "calibration")  # what played it is not shown
    found = find_differences(
        header.to_data(), dict(zip(PLANNED, own, strict=True)) | today, ignore=ignored
    )
    return [PLAINLY.get(line.split(" ", 1)[0], line) for line in found]


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """A short session that is not stored."""

    study: StudyFolder
    settings: Settings
    stimuli: StimulusSet
    cast: Cast


def prepare_rehearsal(study: StudyFolder, *, trials: int) -> Rehearsal:
    """Plan a short session; trials: of each task, in each phase."""
    settings, stimuli = read.read_settings(study.settings), read_stimuli(study.stimuli)
    design = read.make_design(settings, study.path)
    plan = _shorten(make_plan(design, stimuli, "rehearsal", number=1, simulated=True), trials)
    return Rehearsal(
        study, settings, stimuli, _make_cast(study, settings, plan=plan, stimuli=stimuli)
    )


def run_rehearsal(rehearsal: Rehearsal, presenter: Presenter, *, now: Clock) -> Records:
    """Run a rehearsal; its journal is kept nowhere."""
    cast = rehearsal.cast
    with temporary_folder() as folder:
        journal = create_journal(folder / "session-01.jsonl", now=now)
        run_session(
            cast.plan, presenter, stimuli=rehearsal.stimuli, journal=journal, scales=cast.scales
        )
    return journal.records


def rehearse(study: StudyFolder, *, trials: int, seed: int | None, now: Clock) -> Film:
    """Rehearse a session with a simulated participant."""
    rehearsal = prepare_rehearsal(study, trials=trials)
    settings = rehearsal.settings
    seed = settings.study.seed if seed is None else seed
    casting = cast_observers(settings, rehearsal.stimuli, seed=seed)
    mind = SimulatedObserver(casting.model, seed=seed, number=1, percepts=casting.percepts)
    records = run_rehearsal(rehearsal, mind, now=now)
    cast = replace(rehearsal.cast, reading_s=READING_S)
    return replace(_make_film(study, settings, cast=cast, records=records), mark=REHEARSAL)


def _shorten(plan: Plan, trials: int) -> Plan:
    """Keep the first trials of each task in each phase; however few there are, training is passed."""
    seen: Counter[tuple[str, str]] = Counter()
    kept = []
    for trial in plan.trials:
        seen[trial.protocol, trial.phase] += 1
        if seen[trial.protocol, trial.phase] <= trials:
            kept.append(trial)
    matching = plan.matching
    if matching is not None:
        matching = replace(matching, starts_db=matching.starts_db[:trials])
    flow = replace(plan.flow, training_pass=0.0)
    return replace(plan, trials=tuple(kept), matching=matching, flow=flow)


def _make_cast(study: StudyFolder, settings: Settings, *, plan: Plan, stimuli: StimulusSet) -> Cast:
    tables = read.read_study_texts(settings, study.path)
    return Cast(
        plan,
        ui.make_screen_texts(tables, _read_keys(study)),
        make_scales(tables),
        list_by_code(stimuli, seed=plan.seed),
        read.list_surfaces(settings, study.path),
    )


def _read_keys(study: StudyFolder) -> KeysTable:
    """Read the lab's own keys, which the screens name."""
    from feel321.study.actuator.rig import read_rig

    return read_rig(study.rig).keys if study.rig.is_file() else USUAL


def _make_film(study: StudyFolder, settings: Settings, *, cast: Cast, records: Records) -> Film:
    agenda = Agenda(cast.plan.trials, cast.plan.flow, cast.plan.questions)
    return Film(study, settings, cast, records, make_shots(cast, records, agenda))


# In the window.


def play_in_window(film: Film, window: Window, *, clock: Callable[[], float], speed: float) -> bool:
    """Show a session at speed; Space pauses, arrows go from screen to screen, Esc ends it. Returns whether it ended."""
    ends = [shot.at_s for shot in film.shots]
    at_s, before_s, is_running = ends[0], clock(), True
    shown, sheet = -1, film.compose(film.shots[0], window.size)
    while at_s < film.length_s:
        place = max(0, bisect_right(ends, at_s) - 1)
        if place != shown:
            shown, sheet = place, film.compose(film.shots[place], window.size)
        wish = _find_wish(window.show(sheet.items))
        now_s = clock()
        at_s, before_s = at_s + (now_s - before_s) * speed * is_running, now_s
        match wish:
            case "escape":
                return False
            case "space":
                is_running = not is_running
            case "left":
                at_s = ends[max(0, bisect_left(ends, ends[place]) - 1)]
            case "right":
                at_s = ends[min(place + 1, len(ends) - 1)]
    return True


def _find_wish(done: Sequence[InputEvent]) -> str:
    """Find the first key of a frame; closing the window is the same as Esc."""
    if any(event.kind == "closed" for event in done):
        return "escape"
    return next((event.key for event in done if event.kind == "press"), "")


# On a page.


def write_page(film: Film, nonce: str = "") -> str:
    """Write a session as a page of one file: every screen, what was felt as sound, and a table."""
    reel = _make_reel(film)
    return render_template(
        "replay.html",
        nonce=nonce,
        changes=film.changes,
        study=film.settings.study.name,
        participant="" if film.mark else film.cast.plan.participant,
        reel=write_script_data(reel),
        size=PAGE_SIZE,
        ground=GROUND,
        first=_draw(film, film.shots[0]),
        screens=list(_list_screens(film)) if film.mark else [],
        answers=[] if film.mark else list_answers(film),
    )


def _make_reel(film: Film) -> dict[str, Any]:
    """Gather items, screens and sounds, each once; times in s."""
    items: dict[str, int] = {}
    bank = SoundBank(film.study.stimuli, film.settings.rig.full_scale_m_s2)
    plays: list[tuple[float, str, float]] = []
    shots, marks, screen = [], [], -1
    for shot in film.shots:
        sheet = film.compose(shot, PAGE_SIZE)
        drawn = [items.setdefault(write_svg(item), len(items)) for item in sheet.items]
        at_s = round(shot.at_s, 3)
        shots.append([at_s, drawn, read_words(sheet.items)])
        if shot.view.screen != screen:
            screen = shot.view.screen
            marks.append([at_s, describe_screen(film, shot)])
        if shot.heard is not None and (sound := bank.add(shot.heard)):
            plays.append((at_s, *sound))
    strongest = max((peak for *_, peak in plays), default=1.0)
    keys = {key: place for place, key in enumerate(bank.sounds)}
    return {
        "items": list(items),
        "shots": shots,
        "marks": marks,
        "plays": [[at_s, keys[key], round(peak / strongest, 4)] for at_s, key, peak in plays],
        "sounds": list(bank.sounds.values()),
        "length": round(film.length_s, 3),
    }


def describe_screen(film: Film, shot: Shot) -> str:
    """Name a page by its title, a question by its words, a trial by task and number."""
    view = shot.view
    if view.question is not None:
        return view.question.question
    if view.page is not None:
        return film.cast.texts.pages[view.page.key].title
    trial = view.trial
    if trial is None:
        return ""
    phase = "" if trial.phase in {"main", trial.protocol} else f", {trial.phase}"
    again = "" if view.place.attempt == 1 else f", attempt {view.place.attempt}"
    return f"{capitalise(format_name(trial.protocol))}{phase}, trial {trial.number}{again}"


def _draw(film: Film, shot: Shot) -> str:
    return "".join(map(write_svg, film.compose(shot, PAGE_SIZE).items))


def _list_screens(film: Film) -> Sequence[dict[str, str]]:
    """List every screen once, as it was when it was left."""
    last = {shot.view.screen: shot for shot in film.shots}
    return [
        {
            "title": describe_screen(film, shot),
            "words": read_words(film.compose(shot, PAGE_SIZE).items),
            "svg": _draw(film, shot),
        }
        for shot in last.values()
    ]


def list_answers(film: Film) -> list[dict[str, Any]]:
    """List the answers of a session for its table."""
    trials = {trial.number: trial for trial in film.cast.plan.trials}
    return [
        {
            "trial": rated.trial,
            "attempt": rated.attempt,
            "task": format_name(trials[rated.trial].protocol),
            "phase": trials[rated.trial].phase,
            "answer": ", ".join(
                f"{film.cast.texts.name_part(part)}: {value if isinstance(value, str) else f'{value:g}'}"
                for part, value in rated.values.items()
            ),
            "took": f"{rated.response_time_s:.1f}",
            "at": f"{int(rated.time_s // 60)}:{rated.time_s % 60:04.1f}",
            "flags": ", ".join(flag.replace("_", " ") for flag in rated.flags),
        }
        for rated in film.records.find(events.TrialRated)
    ]
