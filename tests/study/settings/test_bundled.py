"""The studies that come with feel321, published or designs, run as they are, but for their length."""

import csv
import re
from collections import Counter
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import pytest

from feel321.study.check import build_study, check_study
from feel321.study.cli import main
from feel321.study.folder import StudyFolder, create_study, list_bundled, read_template
from feel321.study.settings.read import read_settings
from feel321.study.simulate import simulate_study

# What one participant judges: recordings x comparisons.
JUDGEMENTS = {
    "landin2010": 5 * (9 + 1 + 2),
    "park2019": 12 * (6 + 1),
    "lee2022": 8 * (6 * 5 // 2 + 1),
    "airotouch": 8 * (5 + 1),
    "generated": 6 * (8 + 1),
}
DESIGNS = ("airotouch", "generated")
"""Of our own, after no paper."""


@pytest.fixture(params=JUDGEMENTS)
def bundled(request: pytest.FixtureRequest, tmp_path: Path) -> StudyFolder:
    """A published study with short recordings."""
    study = create_study(tmp_path / request.param, bundled=request.param)
    whole = re.sub(r"^duration_s = .*\n", "", read_template(request.param), flags=re.MULTILINE)
    text = re.sub(r"^(scene = .*)$", r"\1\nduration_s = 0.4", whole, flags=re.MULTILINE)
    study.settings.write_text(text, encoding="utf-8")
    return study


def test_a_bundled_study_is_named_after_itself_and_says_what_it_follows(
    bundled: StudyFolder,
) -> None:
    assert read_settings(bundled.settings).study.name == bundled.path.name
    text = read_template(bundled.path.name)
    is_design = bundled.path.name in DESIGNS
    assert bool(re.search(r"doi:10\.\d{4}/\S", text)) is not is_design
    source = "From a paper: nothing" if is_design else "From the paper"
    assert all(f"# {heading}" in text for heading in (source, "Ours: ", "Stand-ins: "))


def test_a_bundled_study_runs_from_check_to_ratings(
    bundled: StudyFolder, now: Callable[[], datetime]
) -> None:
    build_study(bundled)
    assert list(check_study(bundled).problems) == []
    rows = simulate_study(bundled, participants=1, seed=None, now=now)
    assert rows == JUDGEMENTS[bundled.path.name]
    with bundled.ratings.open(encoding="utf-8", newline="") as file:
        counts = Counter(row["recording"] for row in csv.DictReader(file))
    assert set(counts) == {entry.title for entry in read_settings(bundled.settings).recordings}
    assert len(set(counts.values())) == 1


def test_every_texture_of_park_is_felt_in_three_orientations() -> None:
    text = read_template("park2019")
    entries = re.findall(
        r'scene = "(\w+)"\nseed = (\d)\nname = "texture(\d)-r(\d)"\nrotation = (\d)', text
    )
    assert Counter(texture for _, _, texture, _, _ in entries) == dict.fromkeys("1234", 3)
    assert all((seed, named) == (texture, turned) for _, seed, texture, named, turned in entries)


def test_new_offers_the_bundled_studies_and_refuses_others_before_anything_is_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert set(JUDGEMENTS) == set(list_bundled())
    assert main(["new", "--help"]) == 0
    assert f"[one of {', '.join(list_bundled())}]" in " ".join(capsys.readouterr().out.split())
    assert main(["new", str(tmp_path / "s"), "--study", "lee2022"]) == 0
    written = (tmp_path / "s" / "study.toml").read_text(encoding="utf-8")
    assert written == read_template("lee2022")
    with pytest.raises(ValueError, match=r"^study must be one of [a-z0-9, ]+; got 'park'"):
        create_study(tmp_path / "t", bundled="park")
    assert main(["new", str(tmp_path / "t"), "--study", "park"]) == 2
    assert not (tmp_path / "t").exists()
