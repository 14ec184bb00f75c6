"""`check` says where a study differs from the paper that it replicates, and what of the paper is not known."""

import re
from pathlib import Path

import pytest

from feel321.study.findings import Problems
from feel321.study.folder import list_bundled, read_bundled
from feel321.study.paper import compare_with_paper, make_paper
from feel321.study.settings.read import open_recordings, read_settings

OURS = ["mag321", "dft321", "pca321", "sax321", "saz321"]
STUDY = """
[[recordings]]
scene = "bumps+hard_taps"
duration_s = 0.4
rate_hz = {rate}
[[recordings]]
scene = "hard_taps"
duration_s = 0.4
[[recordings]]
scene = "bumps"
duration_s = 0.4
[stimuli]
reducers = ["mag321", "dft321", "pca321", "sax321", "saz321"]
anchors = false
reference = "dft321_windowed"
[stimuli.conditioning]
high_pass_hz = {high_pass}
[session]
protocols = ["realism"]
[paper]
citation = "Someone 2019"
doi = "10.1234/example"
seen = "abstract"
[paper.conditions]
"""


def compare(
    folder: Path, conditions: str, *, rate: float = 10000.0, high_pass: float = 20.0
) -> Problems:
    text = STUDY.format(rate=rate, high_pass=high_pass) + conditions
    (folder / "study.toml").write_text(text, encoding="utf-8")
    settings = read_settings(folder / "study.toml")
    return compare_with_paper(settings, open_recordings(settings, folder), None)


@pytest.mark.parametrize(
    ("conditions", "told"),
    [
        ('participants = { value = 16, source = "abstract" }', ["orders of 3 recordings unbalanced", "12 or 18 would"]),
        ('participants = { value = 12, source = "abstract" }', []),
        (f'reducers = {{ value = {OURS[:4]}, source = "abstract" }}', ["did not have: saz321"]),
        (f'reducers = {{ value = {[*OURS, "say321"]}, source = "abstract" }}', ["missing here: say321"]),
        (f'reducers = {{ value = {OURS}, source = "abstract" }}', []),
        ('channels = { value = 3, source = "abstract" }', ["is one; use reference = 'original'", "used 3 actuators"]),
        ('surface = { value = true, source = "abstract" }', ["surface is no here, yes in"]),
        ('gain = { value = 1.0, source = "ours" }', ["gain is "]),
        ('window_ms = { value = 50.0, source = "full text" }', ["uses windows of 35 ms, the paper 50 ms"]),
        ('rate_hz = { value = 1000.0, source = "full text" }', ["the paper's at 1000 Hz"]),
        ('band_hz = { value = [20.0, 1000.0], source = "full text" }', []),
    ],
)  # fmt: skip
def test_every_difference_is_named(tmp_path: Path, conditions: str, told: list[str]) -> None:
    warnings = compare(tmp_path, conditions).warnings
    assert bool(warnings) == bool(told)
    for words in told:
        assert any(words in line for line in warnings)


def test_a_rate_or_a_filter_that_cuts_the_papers_band_is_named(tmp_path: Path) -> None:
    band = 'band_hz = { value = [20.0, 2500.0], source = "full text" }'
    low, filtered, high = compare(tmp_path, band, rate=4000.0, high_pass=30.0).warnings
    assert "'bumps-hard_taps' at 4000 Hz holds nothing above 2000 Hz" in low
    assert "sample at 5000 Hz" in low
    assert "high_pass_hz is 30" in high
    assert "low_pass_hz is 1000" in filtered


def test_what_is_unknown_is_noted_and_has_no_value(tmp_path: Path) -> None:
    found = compare(tmp_path, 'repeats = { source = "unknown" }\ngain = { source = "unknown" }')
    assert not found.warnings
    assert found.notes == (
        "study.toml, paper (abstract): not known of the paper's study: gain, repeats",
    )
    with pytest.raises(ValueError, match="must have a value, or source"):
        compare(tmp_path, 'repeats = { source = "abstract" }')


def test_a_claim_near_a_number_needs_its_range_and_a_known_measure(tmp_path: Path) -> None:
    claim = '[[paper.claims]]\nname = "a"\nclaim = "b"\nsource = "ours"\nexpect = "near"\nmeasure = "slope"\n'
    with pytest.raises(ValueError, match="must give the paper's low and high"):
        compare(tmp_path, claim)
    with pytest.raises(ValueError, match="did you mean 'slope'"):
        compare(tmp_path, claim.replace('"slope"', '"slop"'))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "options = { metrics = 3.0 }",
            "options.metrics must be words or a list of names, got 3.0",
        ),
        ("options = { among = 'mag321' }", "options.among must be a list of names, got 'mag321'"),
        ("options = { recordng = 'r1' }", "recordng"),
        (
            "paper = { value = 0.5, low = 0.6, high = 0.8 }",
            "the value within low and high, got 0.5",
        ),
    ],
)
def test_a_claim_that_cannot_be_examined_is_named_by_check(
    text: str, message: str, tmp_path: Path
) -> None:
    claim = '[[paper.claims]]\nname = "a"\nclaim = "b"\nsource = "ours"\nmeasure = "slope"\n'
    with pytest.raises(ValueError, match=re.escape(message)):
        compare(tmp_path, claim + text)


def test_a_number_that_is_published_twice_is_refused(tmp_path: Path) -> None:
    one = '[[paper.published]]\ntable = "T"\nsource = "ours"\nrecording = "r"\nmetric = "m"\nnumbers = { a = 1.0 }\n'
    with pytest.raises(ValueError, match="r, m, a"):
        compare(tmp_path, one + one)


def test_a_study_without_a_paper_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text('[[recordings]]\nscene = "bumps"\n', encoding="utf-8")
    settings = read_settings(tmp_path / "study.toml")
    assert compare_with_paper(settings, [], None) == Problems()
    assert make_paper(settings) is None


@pytest.mark.parametrize("name", list_bundled())
def test_no_number_of_a_paper_seen_in_its_abstract_only_is_from_its_full_text(
    tmp_path: Path, name: str
) -> None:
    (tmp_path / "study.toml").write_text(read_bundled(name), encoding="utf-8")
    paper = read_settings(tmp_path / "study.toml").paper
    if paper is not None and paper.seen == "abstract":
        sources = [one.source for one in (*paper.claims, *paper.published)]
        assert "full text" not in sources
