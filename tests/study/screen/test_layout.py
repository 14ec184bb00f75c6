"""Laws of every screen, small or large and in both languages: nothing overlaps, every text fits and can be read."""

import itertools
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from feel321.protocols.texts import list_languages, read_scales, read_texts
from feel321.protocols.trial import Page
from feel321.study.screen import sheet as ui
from feel321.study.screen.input import View, make_screen_texts
from feel321.study.screen.layout import compose, find_overflows
from feel321.study.screen.sheet import LEADING, Area, Box, Photo, Sheet, Text, measure
from feel321.study.session.ports import Place

SIZES = [(1024, 768), (1280, 1024), (1920, 1080), (1920, 1200), (2560, 1440)]
LEAST = 0.022
"""Height of the smallest letters, as a share of the screen's."""


def overlap(one: Box, other: Box) -> bool:
    return (
        min(one.right, other.right) - max(one.left, other.left) > 0.5
        and min(one.bottom, other.bottom) - max(one.top, other.top) > 0.5
    )


def find_ink(text: Text) -> Box:
    """Where the letters themselves stand."""
    width = measure(text.words, text.size, bold=text.bold)
    free = text.box.width - width
    left = text.box.left + {"left": 0.0, "center": free / 2, "right": free}[text.align]
    middle = text.box.top + text.box.height / 2
    return Box(left, middle - text.size / 2, width, text.size)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("language", list_languages())
def test_screens(gallery: dict[str, Any], language: str, size: tuple[int, int]) -> None:
    tables = read_texts(language)
    views = gallery["make_views"](read_scales(language), tables, picture=Path("surface.png"))
    texts = make_screen_texts(tables)
    faults = []
    for name, view in views.items():
        composition = compose(view, texts, size=size)
        written = [item for item in composition.items if isinstance(item, Text)]
        screen = Box(0, 0, *size)
        for text in written:
            ink = find_ink(text)
            if text.size < LEAST * size[1]:
                faults.append(f"{name}: {text.words!r} is too small")
            if ink.width > text.box.width + 0.5 or text.box.height < text.size * LEADING * 0.99:
                faults.append(f"{name}: {text.words!r} does not fit its box")
            if not (screen.contains(ink.left, ink.top) and screen.contains(ink.right, ink.bottom)):
                faults.append(f"{name}: {text.words!r} leaves the screen")
        boxes = [(text.words, find_ink(text)) for text in written]
        boxes += [("picture", item.box) for item in composition.items if isinstance(item, Photo)]
        faults += [
            f"{name}: {one!r} and {other!r} overlap"
            for (one, box), (other, next_box) in itertools.combinations(boxes, 2)
            if overlap(box, next_box)
        ]
        faults += [
            f"{name}: one cannot tell {one.name} {one.part} from {other.name} {other.part}"
            for one, other in itertools.combinations(composition.targets, 2)
            if overlap(one.box, other.box)
        ]
    assert faults == []


def test_slider_has_no_marker_until_it_was_moved(gallery: dict[str, Any]) -> None:
    texts = make_screen_texts(read_texts())
    views = gallery["make_views"](read_scales(), read_texts())

    def count_blue(name: str) -> int:
        target = next(
            t for t in compose(views[name], texts, size=(1920, 1080)).targets if t.name == "mark"
        )
        items = compose(views[name], texts, size=(1920, 1080)).items
        return sum(
            isinstance(i, Area) and i.fill == ui.BLUE and overlap(i.box, target.box) for i in items
        )

    assert (count_blue("similarity fresh"), count_blue("similarity answered")) == (0, 1)


def find_luminance(color: str) -> float:
    parts = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [
        part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts
    ]
    return sum(weight * part for weight, part in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


@pytest.mark.parametrize(
    ("ink", "ground"),
    [
        ("INK", "GROUND"),
        ("INK", "PANEL"),
        ("INK", "LINE"),
        ("DIM", "GROUND"),
        ("DIM", "PANEL"),
        ("GROUND", "BLUE"),
        ("ORANGE", "GROUND"),
        ("BLUE", "GROUND"),
    ],
)
def test_contrast(ink: str, ground: str) -> None:
    high, low = sorted((find_luminance(getattr(ui, name)) for name in (ink, ground)), reverse=True)
    assert (high + 0.05) / (low + 0.05) >= 7.0  # WCAG 2, level AAA


@pytest.mark.parametrize("size", SIZES)
def test_long_texts_shrink_and_braces_stay(size: tuple[int, int]) -> None:
    tables = read_texts("en")
    tables["pages"]["consent"]["text"] = "Ask {us} {answered}. " * 75
    view = View("page", "reading", 1, Place(3, 9), page=Page("consent"))
    texts = [
        item
        for item in compose(view, make_screen_texts(tables), size=size).items
        if isinstance(item, Text)
    ]
    lines = [item for item in texts if "{us} 3" in item.words]
    sheet = Sheet(*size)
    # Where there is less room.
    assert (lines[0].size < 1.1 * ui.BODY * sheet.unit) == (size[0] / size[1] > 1.5)
    assert lines[0].size >= LEAST * sheet.unit * 100
    assert max(line.box.bottom for line in lines) <= sheet.find_strip("body").bottom


@pytest.mark.parametrize(
    ("name", "is_named"),
    [("similarity feeling", False), ("similarity fresh", True), ("mushra feeling", True)],
)
def test_keys_are_named_as_long_as_they_do_something(
    gallery: dict[str, Any], name: str, is_named: bool
) -> None:
    tables = read_texts()
    view = gallery["make_views"](read_scales(), tables)[name]
    items = compose(view, make_screen_texts(tables), size=(1920, 1080)).items
    words = {item.words for item in items if isinstance(item, Text)}
    assert view.can_answer is is_named
    assert ("move the marker" in words) is is_named


@pytest.mark.parametrize(("name", "most"), [("question", 3), ("low_label", 2), ("high_label", 2)])
def test_a_line_too_many_is_told(name: str, most: int) -> None:
    texts = make_screen_texts(read_texts())
    for n_lines in (most, most + 1):
        scale = replace(read_scales()["realism"], **{name: "\n".join("w" * n_lines)})
        assert len(find_overflows(texts, [scale])) == n_lines - most


@pytest.mark.parametrize("letter", ["漢", "\0", "\x07"])
def test_a_letter_that_the_font_lacks_is_told(letter: str) -> None:
    texts = make_screen_texts(read_texts())
    scale = replace(read_scales()["realism"], question=f"How real, {letter}?")
    fault = f"scale 'realism': the screen's font has no {letter!r}; write it without"
    assert find_overflows(texts, [scale]) == [fault]
    assert find_overflows(texts, [replace(scale, question="Wie echt, größer µ?")]) == []


SHOWN = {"de": (1024, 768), "en": (1920, 1080)}


@pytest.mark.parametrize(
    ("language", "few"), [("de", ["few"]), pytest.param("en", [], marks=pytest.mark.soak)]
)
def test_pictures_of_every_screen(
    display: Callable[..., dict[str, str]], tmp_path: Path, language: str, few: list[str]
) -> None:
    """The real window shows every screen; its letters are as wide as the layout takes them for."""
    assert set(SHOWN) == set(list_languages())
    asked = [language, *map(str, SHOWN[language])]
    command = [
        sys.executable,
        str(Path(__file__).with_name("gallery.py")),
        str(tmp_path),
        *asked,
        *few,
    ]
    env = display(*SHOWN[language])
    subprocess.run(command, env=env, check=True, capture_output=True, timeout=600)
    pictures = [path for path in tmp_path.glob("*.png") if path.name != "surface.png"]
    assert len(pictures) > (20 if few else 80)
    from matplotlib.image import imread

    for path in pictures:
        pixels = imread(path)
        assert pixels.shape[1::-1] == SHOWN[language]
        assert pixels[..., :3].max() > 0.9  # something is written
        assert pixels[..., :3].mean() < 0.35  # on a dark ground


def test_mushra_has_its_words_in_five_bands_with_lines_between_them(
    gallery: dict[str, Any],
) -> None:
    """ITU-R BS.1534-3: each word stands over the middle of its fifth of the sliders."""
    view = gallery["make_views"](read_scales(), read_texts())["mushra of five"]
    sheet = compose(view, make_screen_texts(read_texts()), size=(1920, 1080))
    slider = next(t for t in sheet.targets if t.name == "mark")
    track = slider.track
    assert track is not None
    words = {item.words: find_ink(item) for item in sheet.items if isinstance(item, Text)}
    for place, word in enumerate(read_scales()["mushra"].anchors):
        middle = words[word].left + words[word].width / 2
        assert slider.find_points(middle) == pytest.approx(10 + 20 * place, abs=1)
    lines = {
        slider.find_points(item.box.left + item.box.width / 2)
        for item in sheet.items
        if isinstance(item, Area) and item.box.height > 5 * track.height
    }
    assert lines == {20.0, 40.0, 60.0, 80.0}


def test_only_what_was_felt_can_be_rated_and_continue_is_dim_until_all_is_done(
    gallery: dict[str, Any],
) -> None:
    texts = make_screen_texts(read_texts())
    views = gallery["make_views"](read_scales(), read_texts())

    def look(view: View) -> tuple[set[str], bool]:
        sheet = compose(view, texts, size=(1280, 720))
        button = next(t.box for t in sheet.targets if t.name == "confirm")
        is_lit = any(
            isinstance(i, Area) and i.box == button and i.fill == ui.BLUE for i in sheet.items
        )
        return {t.part for t in sheet.targets if t.name == "mark"}, is_lit

    assert look(views["mushra of five"]) == ({"2", "3"}, False)
    answered = views["mushra answered"]
    assert look(answered) == ({str(n) for n in range(1, 13)}, True)
    assert not look(replace(answered, felt=answered.felt - {"reference"}))[1]
    assert not look(replace(answered, markers={}))[1]
    assert [look(views[f"similarity {state}"])[1] for state in ("fresh", "answered")] == [
        False,
        True,
    ]
