from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.agreement import intraclass, krippendorff_alpha
from feel321.analysis.screening import EXPERTISE, RULES, screen_raters

EXCERPTS, REDUCERS, PEOPLE = 10, 4, 12


def panel(seed: int = 0, *, people: int = PEOPLE, repeats: int = 2) -> pd.DataFrame:
    """Make a study of good raters: reference near 100, mid anchor near 50, low anchor near 10."""
    rng = np.random.default_rng(seed)
    places = {"original": ("reference", 97), "anchor_mid": ("anchor", 50)}
    places |= {"anchor_low": ("anchor", 10)}
    places |= {f"reducer{number}": ("test", 30 + 12 * number) for number in range(REDUCERS)}
    rows = [
        (f"p{person:02d}", f"r{excerpt}", reducer, role, repeat, mean + 2 * (excerpt % 3), rng.uniform(2, 6))
        for person in range(people)
        for repeat in range(1, repeats + 1)
        for excerpt in range(EXCERPTS)
        for reducer, (role, mean) in places.items()
    ]  # fmt: skip
    columns = ["participant", "recording", "reducer", "role", "repeat", "rating", "response_time_s"]
    table = pd.DataFrame(rows, columns=columns).assign(
        scale="mushra", protocol="mushra", level="as_is"
    )
    noise = np.where(table["role"] == "reference", 0.0, rng.normal(0, 5, len(table)))
    return table.assign(rating=(table["rating"] + noise).clip(0, 100))


def alter(
    table: pd.DataFrame, change: Callable[[pd.DataFrame], object], **only: str
) -> pd.DataFrame:
    """Give one participant's rows, of one role or reducer only, other ratings."""
    changed = table.copy()
    mask = changed["participant"] == "p03"
    for name, value in only.items():
        mask &= changed[name] == value
    changed.loc[mask, "rating"] = change(changed[mask])
    return changed


RNG = np.random.default_rng(8)
SPOILED = {
    "hidden_reference": lambda table: alter(table, lambda _: 80.0, role="reference"),
    "mid_anchor": lambda table: alter(table, lambda _: 95.0, reducer="anchor_mid"),
    "low_anchor": lambda table: alter(table, lambda _: 70.0, reducer="anchor_low"),
    "straight_lining": lambda table: alter(table, lambda rows: 60 + RNG.uniform(0, 1.5, len(rows)), role="test"),
    "test_retest": lambda table: alter(table, lambda rows: RNG.uniform(0, 100, len(rows)), role="test"),
    "repeat_sd": lambda table: alter(table, lambda rows: RNG.uniform(0, 100, len(rows)), role="test"),
    "reversed_scale": lambda table: alter(table, lambda rows: 100 - rows["rating"], role="test"),
    "too_fast": lambda table: table.assign(
        response_time_s=table["response_time_s"].where(table["participant"] != "p03", 0.2)
    ),
    "outliers": lambda table: alter(table, lambda rows: (rows["rating"] + 40).clip(0, 100), role="test"),
    EXPERTISE: lambda table: alter(table, lambda rows: RNG.uniform(0, 100, len(rows)), role="test"),
}  # fmt: skip


def test_good_raters_are_left_alone() -> None:
    found = screen_raters(panel(), rng=np.random.default_rng(1))
    assert found.hits == dict.fromkeys(RULES, ())
    assert found.notes == ()
    assert found.table["share"].notna().all()


@pytest.mark.parametrize("rule", RULES)
def test_each_rule_hits_whom_it_is_made_for(rule: str) -> None:
    found = screen_raters(SPOILED[rule](panel()), rng=np.random.default_rng(1))
    assert found.hits[rule] == ("p03",)
    assert found.hit.loc["p03", rule]
    assert found.hit[rule].sum() == 1


def test_table_has_one_row_per_rater_and_rule() -> None:
    found = screen_raters(panel(), rng=np.random.default_rng(1))
    assert list(found.table) == ["participant", "rule", "count", "n", "share", "limit", "hit"]
    assert len(found.table) == PEOPLE * len(RULES)
    for wide in (found.share, found.limit, found.count):
        assert (list(wide), len(wide)) == (list(RULES), PEOPLE)


@pytest.mark.parametrize(("bad", "hit"), [(3, False), (4, True)])
def test_fifteen_per_cent_are_allowed_and_more_are_not(bad: int, hit: bool) -> None:
    table = panel()  # 20 presentations of the reference each
    own = table.index[(table["participant"] == "p05") & (table["role"] == "reference")]
    table.loc[own, "rating"] = 90.0  # not below 90
    table.loc[own[:bad], "rating"] = 89.9
    found = screen_raters(table, rules=["hidden_reference"]).table
    row = found.set_index("participant").loc["p05"]
    assert (row["count"], row["n"], row["share"], row["hit"]) == (bad, 20, bad / 20, hit)


@pytest.mark.parametrize(("people", "counts"), [(3, True), (4, False)])
def test_an_excerpt_that_the_anchor_did_not_degrade_does_not_count(
    people: int, counts: bool
) -> None:
    table = panel()  # of 12 raters 3 are 25 %, not more
    lenient = table["participant"].isin([f"p{number:02d}" for number in range(people)])
    excerpt = (table["reducer"] == "anchor_mid") & (table["recording"] == "r0")
    table.loc[lenient & excerpt, "rating"] = 95.0
    found = screen_raters(table, rules=["mid_anchor", "hidden_reference"])
    assert (found.table["n"] == (20 if counts else 18)).all()


def test_reliability_is_told_with_and_without_those_hit() -> None:
    found = screen_raters(SPOILED["reversed_scale"](panel()))
    everyone, without = found.panel.to_dict("records")
    assert (everyone["panel"], without["panel"]) == ("everyone", "without hits")
    assert (everyone["n_participants"], without["n_participants"]) == (PEOPLE, PEOPLE - 1)
    assert (everyone["n_items"], everyone["n_complete"]) == (40, 40)
    for name in ("icc_a_1", "icc_a_k", "icc_c_1", "icc_c_k", "alpha"):
        assert everyone[name] < without[name] <= 1
    tests = panel().query("role == 'test'")
    means = tests.pivot_table("rating", ["recording", "reducer"], "participant").to_numpy()
    told = screen_raters(panel()).panel.iloc[0]
    icc = intraclass(means)
    for name in ("icc_a_1", "icc_a_k", "icc_c_1", "icc_c_k"):
        assert told[name] == pytest.approx(getattr(icc, name))
    assert told["alpha"] == pytest.approx(krippendorff_alpha(means))


def test_items_tell_two_camps() -> None:
    table = panel(people=30)
    odd = table["participant"].str[-1].astype(int) % 2 == 1
    item = (table["recording"] == "r1") & (table["reducer"] == "reducer0")
    table.loc[odd & item, "rating"] = 90.0
    items = screen_raters(table, rules=["outliers"]).stimuli.set_index("item")
    assert items.index[items["multimodal"]].tolist() == ["mushra/r1/reducer0/as_is"]
    assert (items["n"] == 30).all()


def test_rules_without_data_say_so() -> None:
    bare = panel(repeats=1).query("role == 'test'")
    found = screen_raters(bare[["participant", "recording", "reducer", "rating"]])
    # The first with the two about anchors.
    silent = {"hidden_reference", "test_retest", "repeat_sd", "too_fast"}
    assert {note.split("'")[1] for note in found.notes} == silent
    assert "Rule 'too_fast' not applied: it needs column 'response_time_s'." in found.notes
    assert not found.table["hit"].any()


def test_the_gauge_of_shuffled_ratings_is_uniform() -> None:
    table = panel(people=60).query("role == 'test'")
    random = table.assign(rating=np.random.default_rng(3).uniform(0, 100, len(table)))
    gauge = screen_raters(random, rules=[EXPERTISE], rng=np.random.default_rng(4)).gauge
    for _, part in gauge.groupby("measure"):
        # Binomial limits at 0.1 %: of 60 raters 10 at most fall below 5 %.
        assert (part["p"] <= 0.05).sum() <= 10
        assert 0.35 < part["p"].mean() < 0.65
    assert ((gauge["value"] > gauge["floor"]) == (gauge["p"] <= 0.05)).mean() > 0.98


@pytest.mark.parametrize(
    ("spoil", "rules", "message"),
    [
        (lambda table: table.drop(columns="rating"), None, "column rating is missing.*; got participant"),
        (lambda table: table.drop(columns=["recording", "reducer", "level"]), None, "column stimulus_id is missing"),
        (lambda table: table.iloc[:0], None, "got no row"),
        (lambda table: table.assign(rating=table["rating"] + 1), None, "between 0 and 100, got 12 ratings such as 10"),
        (lambda table: table.assign(rating=np.nan), None, "ratings such as nan"),
        (lambda table: table.assign(participant=None), None, "must name a participant in each row, got 280 without"),
        (lambda table: table, ["mid"], "one of hidden_reference.* got 'mid'"),
        (lambda table: table, [], "got no rule"),
        (lambda table: table, [EXPERTISE], "without 'expertise', or with rng"),
        (lambda table: table, {"mid_anchor": 15}, "from -1 to 1, .* got the limit 15 for 'mid_anchor'"),
    ],
)  # fmt: skip
def test_refusals(
    spoil: Callable[[pd.DataFrame], pd.DataFrame], rules: object, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        screen_raters(spoil(panel(people=2)), rules=rules)


@pytest.mark.parametrize(("excerpts", "expected"), [(10, 0.3), (2, 0.3)])
def test_many_pairs_allow_a_smaller_correlation(excerpts: int, expected: float) -> None:
    few = panel()[lambda table: table["recording"] < f"r{excerpts}"] if excerpts < 10 else panel()
    limits = screen_raters(few, rules=["test_retest"]).limit["test_retest"]
    n = excerpts * REDUCERS
    assert limits.to_numpy() == pytest.approx(min(expected, np.tanh(1.6448536 / np.sqrt(n - 3))))


def test_retest_is_pearsons_r_of_the_pairs() -> None:
    table = SPOILED["test_retest"](panel())
    tests = table[table["role"] == "test"]
    pairs = tests.pivot_table("rating", ["participant", "recording", "reducer"], "repeat")
    expected = [part.corr().iloc[0, 1] for _, part in pairs.groupby("participant")]
    found = screen_raters(table, rules=["test_retest", "repeat_sd"]).share
    assert found["test_retest"].to_numpy() == pytest.approx(np.array(expected))
    squares = ((pairs[1] - pairs[2]) ** 2).groupby("participant").mean()
    assert found["repeat_sd"].to_numpy() == pytest.approx(np.sqrt(squares.to_numpy() / 2) / 100)


def test_gauge_is_an_analysis_of_variance() -> None:
    from scipy.stats import f_oneway

    table = panel()
    gauge = screen_raters(table, rules=[EXPERTISE], rng=np.random.default_rng(0)).gauge
    own = table[(table["participant"] == "p00") & (table["role"] == "test")]
    parts = [part["rating"] for _, part in own.groupby(["recording", "reducer"])]
    expected = f_oneway(*parts).statistic
    whole = gauge.set_index(["participant", "measure"])
    found = whole["value"]
    assert found["p00", "discrimination"] == pytest.approx(expected)
    # A rater whom no shuffle matches: 1 of 500, the rater's own order included.
    assert whole.loc[("p00", "discrimination"), "p"] == pytest.approx(1 / 500)
    ratio = found.xs("discrimination", level="measure") / found.xs("reliability", level="measure")
    assert ratio.mean() == pytest.approx(1)  # each rater's items against the panel's average


def test_repeats_are_counted_not_spelt() -> None:
    """As `read_table` gives them they are text, in which 10 comes before 2."""
    table = panel(people=5, repeats=10).sample(frac=1, random_state=1)
    spelt = table.assign(repeat=table["repeat"].astype(str))
    rules = ["test_retest", "repeat_sd"]
    one, other = (screen_raters(rows, rules).table for rows in (table, spelt))
    pd.testing.assert_frame_equal(one, other)


@pytest.mark.parametrize(
    ("rule", "repeats"),
    [("straight_lining", 1), ("test_retest", 2), ("repeat_sd", 2), ("reversed_scale", 2)],
)
def test_eight_are_enough_and_seven_are_not(rule: str, repeats: int) -> None:
    table = panel(people=5)
    tests = table[(table["role"] == "test") & (table["repeat"] <= repeats)]
    items = tests[["recording", "reducer"]].drop_duplicates()
    for number, known in ((8, True), (7, False)):
        found = screen_raters(tests.merge(items.head(number)), [rule])
        assert found.share[rule].notna().tolist() == [known] * 5
