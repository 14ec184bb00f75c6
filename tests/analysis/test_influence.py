"""What single stimuli, recordings and reducers do to the slopes: planted, found, named, and what is said of them."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest

import feel321.analysis.report.folder
from feel321.analysis.association.correlate import make_panel
from feel321.analysis.primary import sensitivity
from feel321.analysis.primary.model import fit_primary
from feel321.analysis.primary.plan import make_cells
from feel321.analysis.primary.sensitivity import conclude, find_candidates, measure_influence
from feel321.analysis.report import primary
from feel321.analysis.report.association import reconcile
from feel321.analysis.resampling import Choices
from feel321.analysis.table.reading import Table
from feel321.analysis.words import Claim, name_path
from feel321.stimuli.reducers.registry import DEFAULT_REDUCERS

if TYPE_CHECKING:
    from feel321.analysis.report.section import Section

METRICS = ("spectral_match_bounded", "temporal_match")
SAID = ((METRICS[0], "open", ""), (METRICS[1], "predicts", "higher"))


def plant(
    *,
    seed: int = 1,
    people: int = 6,
    recordings: int = 6,
    spectral: float = 40.0,
    temporal: float = 30.0,
    **odd: Any,
) -> pd.DataFrame:
    """Rate stimuli by two metrics, both drawn evenly from 0 to 1; `odd` changes what one reducer has or is felt as."""
    rng = np.random.default_rng(seed)
    stimuli = pd.MultiIndex.from_product(
        [range(recordings), DEFAULT_REDUCERS], names=["recording", "reducer"]
    )
    items = stimuli.to_frame(index=False).assign(
        recording=lambda frame: "rec" + frame["recording"].astype(str)
    )
    for name in METRICS:
        items[name] = rng.uniform(0, 1, len(items))
    own = items["reducer"] == odd.get("reducer")
    if "metric" in odd:
        items.loc[own, METRICS[0]] = odd["metric"][: own.sum()]
    slope = np.where(own, odd.get("slope", spectral), spectral)
    felt = (
        20 + slope * items[METRICS[0]] + temporal * items[METRICS[1]] + own * odd.get("points", 0.0)
    )
    items["stimulus_id"] = items["recording"] + "_" + items["reducer"]
    rows = [
        items.assign(
            participant=f"p{person}", rating=felt + rng.normal(0, 4) + rng.normal(0, 4, len(items))
        )
        for person in range(people)
    ]
    whole = pd.concat(rows, ignore_index=True)
    common = {
        "scale": "realism",
        "level": "as_is",
        "role": "test",
        "simulated": True,
        "repeat": "1",
    }
    return whole.assign(
        **common, source=whole["recording"], reference_id="", item=whole["stimulus_id"]
    )


def compute(rows: pd.DataFrame, metrics: tuple[str, ...] = METRICS) -> Section:
    return primary.compute(Table(rows, metrics, ()), Choices(draws=2))


def plant_flipping() -> pd.DataFrame:
    # Fewer recordings leave too few degrees of freedom, as their slopes all come from this reducer.
    return plant(
        spectral=0.0, recordings=12, reducer="mag321", metric=np.linspace(-3, 3, 12), slope=8.0
    )


@pytest.fixture(scope="module")
def flipping() -> Section:
    """One reducer alone makes the slope: it is rated by the metric, and all others whatever it is."""
    return compute(plant_flipping())


def test_a_verdict_that_one_reducer_turns_names_it_first(flipping: Section) -> None:
    spectral, temporal = flipping.claims
    assert (spectral.verdict, spectral.direction) == ("predicts", "higher")
    assert "reducer mag321" in spectral.hinges_on
    assert (temporal.verdict, temporal.hinges_on) == ("predicts", ())
    first = str(flipping.verdict[0]).split(". ")[0]
    assert "hinges on the reducer mag321: without it the association is open" in first
    assert "better" not in " ".join(map(str, flipping.verdict)).replace(
        "predicts better is left open", ""
    )


def test_nothing_is_planned_from_a_slope_that_turns(flipping: Section) -> None:
    numbers = {number.name: number.value for number in flipping.numbers}
    planned = [
        numbers[f"precision.realism.as_is.{METRICS[0]}.{what}"]
        for what in ("participants", "recordings")
    ]
    assert all(map(math.isnan, planned))
    assert "sample size" not in " ".join(line.lead for line in flipping.verdict)


def test_every_omission_is_a_refit_of_the_rest(flipping: Section) -> None:
    rows = plant_flipping()
    left = fit_primary(rows[rows["reducer"] != "mag321"], METRICS, explain=False).slopes.loc[
        METRICS[0]
    ]
    table = flipping.tables["influence"].set_index(["kind", "unit", "metric"])
    assert table.loc[("reducer", "mag321", METRICS[0]), "estimate"] == pytest.approx(
        left["estimate"], rel=1e-6
    )
    numbers = {number.name: number.value for number in flipping.numbers}
    name = f"influence.realism.as_is.{METRICS[0]}.reducer.mag321"
    assert numbers[name] == pytest.approx(left["tenth"], rel=1e-6)
    kinds = table.index.get_level_values("kind")
    assert {kind: (kinds == kind).sum() for kind in ("recording", "reducer")} == {
        "recording": 24,
        "reducer": 18,
    }


def test_points_planted_on_a_reducer_are_named_and_the_slopes_hold() -> None:
    section = compute(plant(reducer="mag321", points=45.0))
    (line,) = [line for line in section.verdict if line.lead == "exceptions"]
    assert "mag321 was rated 4" in line.text
    assert "points higher than the metrics predict from the other reducers" in line.text
    odd = section.tables["exceptions"].set_index("reducer")
    assert odd["exceptional"].tolist() == [name == "mag321" for name in odd.index]
    assert odd.loc["mag321", "excess"] == pytest.approx(45, abs=3)
    slopes = section.tables["slopes"].set_index("metric")
    for name, planted in zip(METRICS, (4.0, 3.0), strict=True):
        assert slopes.loc[name, "tenth_low"] < planted < slopes.loc[name, "tenth_high"]
    assert all(claim.verdict == "predicts" and not claim.hinges_on for claim in section.claims)


def test_an_outlying_stimulus_is_found_and_named() -> None:
    rows = plant().rename(columns={METRICS[0]: "spectral_match"})
    rows.loc[rows["item"] == "rec2_mag321", "spectral_match"] = -781.0
    section = compute(rows, ("spectral_match", "temporal_match"))
    spectral, _ = section.claims
    assert (spectral.verdict, spectral.direction) == (
        "predicts",
        "higher",
    )  # planted: 4 points per +0.1
    assert spectral.hinges_on == ()
    assert "the stimulus rec2_mag321" in str(section.verdict[0])
    assert any(line.lead == "unbounded metric" for line in section.verdict)
    assert not any("mag321 was rated" in line.text for line in section.verdict)


@pytest.mark.parametrize("outlying", [None, -50.0])
def test_candidates_are_those_that_move_a_regression_most(outlying: float | None) -> None:
    rows = plant(people=3, recordings=4, seed=5)
    if outlying is not None:
        rows.loc[rows["item"] == "rec1_pca321", METRICS[0]] = outlying
    items = rows.groupby("item", sort=False).agg({
        "recording": "first",
        "rating": "mean",
        METRICS[0]: "first",
        METRICS[1]: "first",
    })

    def regress(table: pd.DataFrame) -> np.ndarray:
        design = np.column_stack([
            table[list(METRICS)],
            pd.get_dummies(table["recording"]).astype(float),
        ])
        return np.linalg.lstsq(design, table["rating"], rcond=None)[0][:2]

    whole = regress(items)
    moved = pd.DataFrame(
        [regress(items.drop(name)) - whole for name in items.index], index=items.index
    ).abs()
    groups = sensitivity._list_dummies(items, ["recording"])
    x, y = (
        sensitivity._centre(groups, items[names].to_numpy())
        for names in (list(METRICS), ["rating"])
    )
    share = np.einsum("ij,ji->i", groups, np.linalg.pinv(groups))
    np.testing.assert_allclose(
        np.abs(sensitivity._measure_changes(x, y[:, 0], share=share)), moved, rtol=1e-6
    )
    for count in (1, 3):
        found = find_candidates(make_cells(rows.drop(columns="reducer"), METRICS), count=count)
        assert set(found) == {*moved[0].nlargest(count).index, *moved[1].nlargest(count).index}


def test_too_much_to_leave_out_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensitivity, "MOST_CELLS", 10)
    rows = plant(people=3, recordings=3)
    found = measure_influence(rows, METRICS, fit_primary(rows, METRICS, explain=False))
    assert found.table.empty
    assert found.notes == (
        "Influence was not measured: more than 10 participant x stimulus cells.",
    )
    assert found.find_turns(METRICS[0]).empty


def test_of_many_recordings_only_reducers_and_stimuli_are_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sensitivity, "MOST_UNITS", 3)
    rows = plant(people=3, recordings=4)
    found = measure_influence(rows, METRICS, fit_primary(rows, METRICS, explain=False))
    assert set(found.table["kind"]) <= {"reducer", "stimulus"}
    assert found.notes == ("Recordings were not left out in turn: more than 3.",)


@pytest.mark.parametrize(
    ("rows", "why"),
    [
        (plant(people=2), "cannot be estimated with 2 participants: at least 3 are needed."),
        (plant(recordings=1), "cannot be estimated with 1 recording: at least 3 are needed."),
        (
            plant(people=1, recordings=2),
            "with 1 participant and 2 recordings: at least 3 are needed of each.",
        ),
        (plant(people=3).assign(rating=50.0), "cannot be estimated: all ratings are the same."),
    ],
)
def test_what_cannot_be_estimated_is_said_and_nothing_else(rows: pd.DataFrame, why: str) -> None:
    section = compute(rows)
    assert [claim.verdict for claim in section.claims] == ["not_estimable"] * 2
    assert not any(claim.direction or claim.hinges_on for claim in section.claims)
    (line,) = section.verdict
    assert str(line).startswith(
        "Realism: Whether bounded spectral match or temporal match predicts realism ratings"
    )
    assert str(line).endswith(why)
    shown = [number for number in section.numbers if number.name.startswith(("precision", "slope"))]
    assert all(math.isnan(number.low) for number in shown)
    assert all(math.isnan(number.value) for number in shown if number.name.startswith("precision"))


@pytest.mark.parametrize(
    ("p", "verdict"), [(0.049, "predicts"), (0.05, "open"), (math.nan, "not_estimable")]
)
def test_verdicts(p: float, verdict: str) -> None:
    assert conclude(p) == verdict


def check(value: object, schema: dict[str, Any], place: str = "$") -> list[str]:
    """Hold a value against the parts of JSON Schema that results.schema.json uses."""
    kinds = {
        "object": dict,
        "array": list,
        "string": str,
        "boolean": bool,
        "integer": int,
        "null": type(None),
        "number": (int, float),
    }
    wanted = schema.get("type", [])
    names = [wanted] if isinstance(wanted, str) else wanted
    if names and not any(isinstance(value, kinds[name]) for name in names):
        return [f"{place}: {value!r} is not {wanted}"]
    if ("const" in schema and value != schema["const"]) or (
        "enum" in schema and value not in schema["enum"]
    ):
        return [f"{place}: {value!r}"]
    if isinstance(value, list):
        return [
            told
            for number, one in enumerate(value)
            for told in check(one, schema["items"], f"{place}[{number}]")
        ]
    if not isinstance(value, dict):
        return []
    known, others = schema.get("properties", {}), schema["additionalProperties"]
    wrong = [f"{place}: lacks {name}" for name in schema.get("required", []) if name not in value]
    for name, one in value.items():
        if name in known or others:
            wrong += check(one, known.get(name, others), f"{place}.{name}")
        else:
            wrong.append(f"{place}: has {name}")
    return wrong


def test_results_follow_their_schema(report: Path) -> None:
    folder = Path(feel321.analysis.report.folder.__file__).parent
    schema = json.loads((folder / "results.schema.json").read_text(encoding="utf-8"))
    results = json.loads((report / "results.json").read_text(encoding="utf-8"))
    assert check(results, schema) == []
    assert len(results["verdicts"]) == 4
    named = {number["name"] for number in results["numbers"]}
    for one in results["numbers"]:  # whatever is in a name is in a field too
        own = [one[key] for key in ("scale", "level", "metric") if one[key] is not None]
        keys = [name_path(key) for key in (*own, *one["keys"].values())]
        rest = [] if one["statistic"] == "value" else one["statistic"].split(".")
        assert sorted([one["family"], *keys, *rest]) == sorted(
            one["name"].replace("order_", "").split(".")
        )
    assert all(claim["number"] in named for claim in results["verdicts"])
    assert check(results | {"schema_version": 0}, schema)
    assert check(results | {"more": 1}, schema)
    results["verdicts"][0]["verdict"] = "undecided"
    assert check(results, schema) == ["$.verdicts[0].verdict: 'undecided'"]


def test_the_pooled_question_is_told_apart_where_it_disagrees() -> None:
    rows = plant(spectral=0.0, people=8, recordings=8)
    # Recordings that score higher are rated higher, stimuli of the same recording are not.
    number = rows["recording"].str.removeprefix("rec").astype(int)
    rows = rows.assign(
        **{METRICS[0]: rows[METRICS[0]] + number}, rating=rows["rating"] + 8 * number
    )
    claims = [Claim("realism", "as_is", name, verdict, way, "") for name, verdict, way in SAID]
    panel = make_panel(rows, METRICS, draws=200, rng=np.random.default_rng(1))
    told = reconcile(panel, claims)
    assert told.startswith(
        "over all stimuli pooled, mean ratings correlate with bounded spectral match at r = 0.9"
    )
    assert "That is another question: it also counts differences between recordings" in told
    agreeing = plant(people=8, recordings=8, temporal=0.0, spectral=60.0)
    panel = make_panel(agreeing, METRICS[:1], draws=200, rng=np.random.default_rng(1))
    assert not reconcile(panel, [Claim("realism", "as_is", METRICS[0], "predicts", "higher", "")])
