"""What can be analysed, but is not what it seems, is analysed and told."""

from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.association import correlate
from feel321.analysis.table.columns import FURTHER, describe_manifest
from feel321.analysis.table.items import split_tests
from feel321.analysis.table.reading import ROSTER, read_table
from feel321.analysis.table.schema import RATINGS
from feel321.stimuli.sets.manifest import COLUMN_UNITS
from feel321.study.folder import LAST_PARTICIPANT_COLUMNS, PARTICIPANT_COLUMNS, RATING_COLUMNS
from feel321.study.settings.read import list_origins, read_settings

Change = Callable[[pd.DataFrame], pd.DataFrame]


def edit(path: Path, change: Change) -> None:
    change(pd.read_csv(path, dtype=str, na_filter=False)).to_csv(path, index=False)


def repeat_row(frame: pd.DataFrame) -> pd.DataFrame:
    return pd.concat([frame, frame.iloc[[4]].assign(trial="999")])


RATED = [
    (lambda f: f.assign(mood="calm", hand="left"), "ratings.csv: columns that are not used: 'mood', 'hand'."),
    (repeat_row, "1 judgements differ from an earlier one in their trial only: each counts as a further repeat."),
    (lambda f: f.assign(rating=(f["rating"].astype(float) / 20).round() + 1), "run from 2 to 5: if 100 was not its up"),
    (lambda f: f.assign(simulated=f["participant"] == "p01"), "96 judgements of 1 simulated participants are left out"),
    (lambda f: f.assign(scale=f["scale"].mask(f["reducer"] == "original", "comfort")), "Scale 'comfort' was rated on"),
    (lambda f: f.assign(rating=(f["rating"].astype(float) + 55).clip(upper=100)), "of 144 ratings of test stimuli"),
    (lambda f: f.assign(underruns=(f["trial"].astype(int) < 3).astype(int)), "4 judgements of 2 participants were"),
    (lambda f: f.assign(protocol=f["repeat"]), "Scale 'realism' was judged in 2 protocols, which are taken together:"),
    (lambda f: f.assign(participant=f["participant"].replace("p01", "p00\u200b")), "capitals, accents or blanks only"),
    (lambda f: f.assign(participant=f["participant"].map({"p00": "J\u00f6", "p01": "Jo\u0308"})), "accents or blanks"),
    (lambda f: f.assign(participant=f["participant"].map({"p00": "a b", "p01": "a\u2003b"})), "accents or blanks only"),
    (lambda f: f.assign(scale="dissimilarity"), "192 judgements of scale 'dissimilarity' name no reference_id: they"),
    (lambda f: f.assign(trial="", repeat=""), "ratings.csv has nothing in a column 'trial' or 'repeat': rows alike"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "note"), RATED)
def test_odd_ratings_are_told(files: Callable[..., object], change: Change, note: str) -> None:
    study = files(participants=2, scales=("realism",))
    edit(study.ratings, change)
    (told,) = read_table(study.ratings, study.manifest).notes
    assert note in told
    assert "\n" not in told


LISTED = [
    (lambda f: f.assign(colour="red"), "manifest.csv: columns that are not used: 'colour'."),
    (lambda f: f.assign(temporal_match=""), "manifest.csv has nothing in a column 'temporal_match', so that metric is"),
    (lambda f: f.assign(level=""), "manifest.csv has nothing in a column 'level': every stimulus is taken as 'as_is'."),
    (lambda f: f.assign(sensation_level_db=[-1.5, -2, *[9] * (len(f) - 2)]), "2 of 48 stimuli were played below the"),
    (lambda f: f.assign(source=f["recording"].str[:3]), "The 4 recordings come from 1 source, turned, cut or edited"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "note"), LISTED)
def test_odd_manifests_are_told(files: Callable[..., object], change: Change, note: str) -> None:
    study = files(participants=2, scales=("realism",))
    edit(study.manifest, change)
    (told,) = read_table(study.ratings, study.manifest).notes
    assert note in told


CHANGES = {
    "other order": lambda t: pd.read_csv(t, dtype=str)[::-1].iloc[:, ::-1].to_csv(index=False),
    "carriage returns": lambda t: t.read_text().replace("\n", "\r\n"),
    "old Macintosh": lambda t: t.read_text().replace("\n", "\r"),
    "byte-order mark": lambda t: "\ufeff" + t.read_text(),
    "everything quoted": lambda t: pd.read_csv(t, dtype=str).to_csv(index=False, quoting=1),
    "commas at the end": lambda t: t.read_text().replace("\n", ",,\n"),
    "blank rows": lambda t: t.read_text().replace("\n", "\n\n") + "\n" * 9,
}


@pytest.mark.parametrize("written", CHANGES.values(), ids=CHANGES)
def test_ways_of_writing_the_same_table(
    files: Callable[..., object], written: Callable[[Path], str]
) -> None:
    study = files(participants=2, scales=("realism",))
    plain = read_table(study.ratings, study.manifest).rows
    study.ratings.write_text(written(study.ratings), encoding="utf-8", newline="")
    table = read_table(study.ratings, study.manifest)
    assert table.notes == ()
    order = ["participant", "stimulus_id", "repeat"]
    pd.testing.assert_frame_equal(
        table.rows.sort_values(order, ignore_index=True),
        plain.sort_values(order, ignore_index=True),
    )


def test_the_schema_knows_every_column_that_feel321_writes() -> None:
    assert list(RATINGS) == [name for name in RATING_COLUMNS if name not in FURTHER]
    assert set(describe_manifest()) == {*COLUMN_UNITS, "source", *FURTHER}
    assert {*PARTICIPANT_COLUMNS, *LAST_PARTICIPANT_COLUMNS} == ROSTER | {"participant"}


def test_intervals_draw_sources_with_all_their_recordings(files: Callable[..., object]) -> None:
    study = files(participants=12, recordings=8, scales=("realism",), anchors=False)

    def find(sources: dict[str, str] | None) -> object:
        (part,) = split_tests(read_table(study.ratings, study.manifest, sources=sources))
        return correlate(part.rows, "spectral_match", draws=300, rng=np.random.default_rng(0))

    alone, same = find(None), find({f"rec{number}": f"own{number}" for number in range(8)})
    assert alone == same
    three = find({f"rec{number}": f"of{number % 3}" for number in range(8)})
    one = find({f"rec{number}": "one" for number in range(8)})
    assert alone.value == three.value == one.value
    assert three.n_recordings == 8
    assert "Two-way intervals draw the 3 sources of the 8 recordings." in three.notes
    # Three units know a spread on two degrees of freedom only.
    assert three.high - three.low > 1.5 * (alone.high - alone.low)
    assert np.isnan(one.low)
    assert any(
        note.startswith("All recordings come from one source: no two-way interval")
        for note in one.notes
    )


def test_a_study_tells_which_recordings_are_one_turned(tmp_path: Path) -> None:
    bundled = resources.files("feel321.study.settings") / "bundled" / "park2019.toml"
    (tmp_path / "study.toml").write_text(bundled.read_text(encoding="utf-8"), encoding="utf-8")
    origins = list_origins(read_settings(tmp_path / "study.toml"))
    assert len(origins) == 12
    assert len(set(origins.values())) == 4
    assert origins["texture1-r1"] == origins["texture1-r3"] == "texture_drag 1"


def test_labels_of_participants_are_joined(files: Callable[..., object]) -> None:
    study = files(participants=3, scales=("realism",))
    roster_path = study.ratings.with_name("participants.csv")
    people = pd.DataFrame({
        "participant": ["p00", "p01", "q"], "grip": ["pen", "fist", ""], "number": 1, "level": "x",
    })  # fmt: skip
    people.to_csv(roster_path, index=False)
    table = read_table(study.ratings, study.manifest)
    assert table.rows.groupby("participant")["grip"].first().to_dict() == {
        "p00": "pen",
        "p01": "fist",
        "p02": "",
    }
    assert set(table.rows["level"]) == {"as_is"}
    assert "number" not in table.rows
    told = "Participants differ in 'grip' (participants.csv; participants: unknown 1, 'fist' 1, 'pen' 1): no test"
    assert [note.startswith(told) for note in table.notes] == [True]
    people.assign(grip="").to_csv(roster_path, index=False)  # which once stopped the analysis
    assert read_table(study.ratings, study.manifest).notes == ()
    people.drop(columns="grip").to_csv(roster_path, index=False)
    assert read_table(study.ratings, study.manifest).notes == ()
    pd.concat([people, people]).to_csv(roster_path, index=False)
    with pytest.raises(
        ValueError, match=r"participants.csv, lines 5, 6, 7: participant must be listed once, got"
    ):
        read_table(study.ratings, study.manifest)
