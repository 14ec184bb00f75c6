from __future__ import annotations

import pytest
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path

from feel321.analysis.figures.style import (
    CM_PER_INCH,
    PRINT,
    add_title,
    fit_text,
    new_figure,
    print_style,
)


def measure_cm(line: str) -> float:
    font = FontProperties(family=PRINT["font.family"], size=PRINT["font.size"])
    return (
        text_to_path.get_text_width_height_descent(line, font, ismath=False)[0] / 72 * CM_PER_INCH
    )


@pytest.mark.parametrize(
    "text",
    ["a b c", "word " * 30, "under_score_" * 20, "W" * 300, "i" * 500, "ü" * 1000, " x ", ""],
)
@pytest.mark.parametrize("width", [0.8, 2.9, 8.0])
@pytest.mark.parametrize("lines", [1, 2, 5])
def test_no_line_is_wider_than_its_place(text: str, width: float, lines: int) -> None:
    fitted = fit_text(text, width, lines=lines).split("\n")
    assert len(fitted) <= lines
    assert all(measure_cm(line) <= width for line in fitted)


@pytest.mark.parametrize("text", ["one two three", "dft321_windowed", "first\nsecond"])
def test_what_fits_is_left_as_it_is(text: str) -> None:
    assert fit_text(text, 8.0) == text


def test_nothing_is_lost_between_lines() -> None:
    text = "Slopes within recordings, mixed_model; bars_are intervals."
    assert fit_text(text, 3.0, lines=9).replace("\n", "").replace(" ", "") == text.replace(" ", "")


def test_the_end_of_a_name_that_is_cut_stays() -> None:
    one, other = (fit_text(f"{'reducer_' * 20}{number}", 2.0) for number in (1, 2))
    assert one != other
    assert one.endswith("1")
    assert "…" in one


def test_a_title_adds_its_own_height() -> None:
    with print_style():
        figure, _ = new_figure(4.0)
        before = figure.get_figheight()
        add_title(figure, "word " * 80)
    lines = 1 + figure.get_suptitle().count("\n")
    assert lines > 2
    assert figure.get_figheight() - before == pytest.approx(lines * 8 * 1.2 / 72, rel=0.15)


def test_a_place_too_narrow_for_any_letter_holds_one() -> None:
    assert fit_text("WWWWWWWW", 0.01, lines=1) == "…"
    assert fit_text("WWWWWWWW", 0.01) == "W\n…"
