"""Every kind of screen: as views for the tests of the layout, and as pictures for people to look at.

Run it by itself, on a display: gallery.py FOLDER LANGUAGE WIDTH HEIGHT [few]
"""

import struct
import sys
import time
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

from feel321.protocols.tasks import PROTOCOLS
from feel321.protocols.texts import Question, read_texts
from feel321.protocols.threshold import INTERVALS
from feel321.protocols.trial import MATCHING, THRESHOLD, Judgement, Page, Part, Scale, Trial
from feel321.study.screen.input import View, make_screen_texts
from feel321.study.screen.layout import compose
from feel321.study.screen.sheet import LEADING, Text, measure
from feel321.study.screen.window import Window, open_screen
from feel321.study.session.ports import Place

PARTS = {
    "realism": (Part("test", "s1"),),
    "touched": (Part("surface", surface="felt"), Part("test", "s1")),
    "similarity": (Part("reference", "s0"), Part("test", "s1")),
    "dissimilarity": (Part("first", "s0"), Part("second", "s1")),
    "abx": (Part("a", "s0"), Part("b", "s1"), Part("x", "s0")),
    "triplet": (Part("reference", "s0"), Part("a", "s1"), Part("b", "s2")),
    "preference": (Part("a", "s1"), Part("b", "s2")),
    "mushra": (Part("reference", "s0"), *(Part(str(n), f"s{n}") for n in range(1, 13))),
    THRESHOLD: tuple(Part(name, "40 Hz") for name in INTERVALS),
    MATCHING: (Part("first", "s0"), Part("second", "s1")),
}
JUDGED = {
    "abx": ("x",),
    "triplet": ("a",),
    "preference": ("a",),
    "dissimilarity": ("second",),
    MATCHING: ("second",),
    "mushra": tuple(str(n) for n in range(1, 13)),
}


OWN = {
    "roughness": ("How rough did it feel?", "Not at all rough", "As rough as coarse sandpaper"),
    "hardness": ("How hard did it feel?", "Soft", "Hard", ("Soft", "Rather soft", "Hard")),
    "sharpness": ("How sharp did the edges feel?", "Not at all sharp", "As sharp as a blade"),
}


def make_trial(name: str, *, timing: str = "", rows: int = 12) -> Trial:
    protocol = "realism" if name == "touched" else name
    own = {THRESHOLD: "strict", MATCHING: "replay"}
    usual = own[name] if name in own else PROTOCOLS[protocol].timings[0]
    parts = PARTS[name][: rows + 1]
    judged = JUDGED.get(name, ("test",))[:rows]
    return Trial(
        number=3,
        block=1,
        repeat=1,
        protocol=protocol,
        scale=protocol,
        timing=timing or usual,
        recording="felt",
        parts=parts,
        judgements=tuple(Judgement(part, "s1") for part in judged),
    )


def make_questions() -> list[Question]:
    """Usual questions, and the largest of each kind."""
    agree = [f"{word} agree" for word in ("Do not", "Hardly", "Rather", "Mostly", "Strongly")]
    long = "What did you think of while you felt the vibrations, and did anything disturb you? " * 2
    return [
        Question(
            "age", "number", "How old are you, in years?", low=5.0, high=120.0, required=False
        ),
        Question(
            "hand",
            "choice",
            "Which hand do you write with?",
            ("Right", "Left", "Either"),
            required=False,
        ),
        Question("many", "choice", long, tuple(f"The answer number {n}" for n in range(1, 10))),
        Question("agree", "likert", "It felt as if I touched the board.", tuple(agree)),
        Question("ends", "likert", "How tired is your hand?", ("Not at all", *[""] * 7, "Very")),
        Question("words", "text", long, required=False),
        Question("least", "number", "How many hours did you sleep?", low=0.5),
    ]


def make_views(
    scales: dict[str, Scale], texts: dict, *, picture: Path | None = None
) -> dict[str, View]:
    """Every page, and every kind of trial in every state, with the longest notices."""
    place = Place(12, 80)

    def show(kind: str, state: str, number: int = 50, **more: Any) -> View:
        return View(kind, state, number, place, **more)

    views = {}
    waiting = {"break", "rest", "threshold_next", "matching_done"}
    for number, key in enumerate(texts["pages"]):
        by = "experimenter" if key in {"training_failed", "call_us"} else "participant"
        left_s = 27 if key in waiting else 0
        notice = texts["prompts"]["end_next"] if key == "pause" else ""
        notice = texts["refusals"]["too_early"] if left_s else notice
        page = Page(key, 60.0 if left_s else 0.0, by)
        view = show("page", "reading", number, page=page, left_s=left_s, notice=notice)
        views[f"page {key}"] = view
    for number, question in enumerate(make_questions()):
        filled = {"typed": "9" * 500 if question.kind == "text" else "99", "chosen": "1"}
        view = show("page", "reading", 40 + number, page=Page(question.key), question=question)
        views[f"question {question.name} open"] = view
        answered = replace(view, felt=frozenset({question.name}), **filled)
        views[f"question {question.name} answered"] = answered
    names = ", ".join(texts["parts"].get(name, name) for name in ("reference", "test"))
    missing = texts["refusals"]["not_felt"].format(parts=names)
    kinds = dict.fromkeys(("abx", "triplet", "preference", THRESHOLD), "choice") | {
        "mushra": "rows"
    }
    for name in PARTS:
        trial, kind = make_trial(name), kinds.get(name, "slider")
        parts = [part.name for part in trial.parts]
        judged = [judgement.part for judgement in trial.judgements]
        shown = picture if name in {"touched", "realism"} else None
        scale = scales[trial.scale]
        base = {"trial": trial, "scale": scale, "picture": shown, "sample": "Cotton"}
        feeling = show(kind, "feeling", **base, playing=parts[-1], selected=judged[0])
        views[f"{name} feeling"] = replace(
            feeling, felt=frozenset(parts[:-1]), loops=kind == "rows"
        )
        fresh = show(kind, "answering", **base, felt=frozenset(parts), selected=judged[0])
        views[f"{name} fresh"] = replace(fresh, notice=missing)
        markers = {part: 100.0 if n == 0 else 7.0 * n for n, part in enumerate(judged)}
        views[f"{name} answered"] = replace(
            fresh,
            markers={} if kind == "choice" else markers,
            selected=judged[-1],
            chosen=(scale.choices or ("",))[-1],
        )
    for name, count in (("realism", 2), ("similarity", 3), ("dissimilarity", 4)):
        trial, more = make_trial(name), dict(list(OWN.items())[: count - 1])
        (first,) = trial.judgements
        asked = (first, *(replace(first, expected=None, scale=key) for key in more))
        trial = replace(trial, judgements=asked)
        own = tuple(Scale(key, *words) for key, words in more.items())
        view = show("scales", "answering", 53, trial=trial, selected=trial.judged[0])
        fresh = replace(
            view,
            scale=replace(scales[name], further=own),
            felt=frozenset(part.name for part in trial.parts),
            picture=picture if count < 4 else None,
            notice=missing,
        )
        views[f"{count} scales fresh"] = fresh
        markers = {key: 100.0 - 33 * n for n, key in enumerate(trial.judged)}
        views[f"{count} scales answered"] = replace(
            fresh, markers=markers, selected=trial.judged[-1], typed="1", notice=""
        )
        playing = {"state": "feeling", "playing": trial.parts[-1].name}
        views[f"{count} scales feeling"] = replace(fresh, **playing, felt=frozenset(), notice="")
    stroking = show("slider", "stroking", 51, trial=make_trial("touched"), selected="test")
    views["touched stroking"] = replace(
        stroking,
        scale=scales["realism"],
        playing="surface",
        picture=picture,
        sample="Cotton on foam, sample 14",
    )
    trial = make_trial("mushra", rows=5)
    rows = show("rows", "answering", 52, trial=trial, scale=scales["mushra"], selected="3")
    felt = frozenset({"reference", "2", "3"})
    views["mushra of five"] = replace(rows, felt=felt, markers={"2": 44.0})
    return views


def write_picture(path: Path) -> Path:
    """A picture of stripes, as a surface may look like."""
    size = 300
    rows = b"".join(
        b"\0" + bytes(120 + (x * y // 40) % 120 for x in range(size)) for y in range(size)
    )
    head = struct.pack(">2I5B", size, size, 8, 0, 0, 0, 0)
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    body = b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)
    return path


def check_widths(window: Window) -> None:
    """The window's own letters are no wider than the layout took them for."""
    for item, stimulus in window.drawn.items():
        if isinstance(item, Text):
            width, height = stimulus.boundingBox
            assert width <= measure(item.words, item.size, bold=item.bold) + 2, item
            assert height <= item.size * LEADING, item


def capture(window: Window, path: Path) -> None:
    """Save what is on the screen as a picture."""
    for stimulus in window.drawn.values():
        stimulus.draw()
    window.handle.getMovieFrame(buffer="back")  # the front buffer reads black under Xvfb
    window.handle.flip()
    window.handle.saveMovieFrames(str(path))
    window.handle.movieFrames = []


def save_gallery(folder: Path, size: tuple[int, int], language: str, *, few: bool) -> None:
    """Save a picture of every screen, or of one in its last state for every kind."""
    from feel321.protocols.texts import read_scales

    picture = write_picture(folder / "surface.png")
    with open_screen(clock=time.perf_counter, windowed=True, size=size) as window:
        assert window.size == size
        tables = read_texts(language)
        texts = make_screen_texts(tables)
        for name, view in make_views(read_scales(language), tables, picture=picture).items():
            if few and not name.endswith(("answered", "stroking", "realism", "rest")):
                continue
            window.show(compose(view, texts, size=window.size).items)
            check_widths(window)
            capture(window, folder / f"{name} {language}.png".replace(" ", "_"))


if __name__ == "__main__":
    folder, language, width, height, *few = sys.argv[1:]
    save_gallery(Path(folder), (int(width), int(height)), language, few=bool(few))
