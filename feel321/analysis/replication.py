"""Papers replicated: their claims, what this study's ratings say to each of them, and the measures that tell.

A measure is a function `measure_NAME(table, claim, choices) -> ClaimValue`, and one line in `feel321.records.MEASURES`.
It takes a table of one scale and one level, raises ValueError where the claim cannot be estimated, and knows nothing of
the paper's number: `judge` compares. Where a claim names exceptions, it is called a second time without them.

Landin et al. 2010 (doi:10.1007/978-3-642-14075-4_12): metrics of transforms, and how they were rated. Lee et al. 2022
(doi:10.1109/TOH.2022.3174229): one axis against three, and what the axes of maps mean; both take dissimilarities.
Park & Kuchenbecker 2019 (doi:10.1109/WHC.2019.8816148): mean and spread of matches over orientations of the sensor. A
low spread is meant to be good, but a reducer that matches nothing has nothing to lose when the sensor turns: where such
reducers were rated, spread and mean rise together, and alone the spread goes with ratings the wrong way.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

from pandas import DataFrame, Series
from scipy.stats import t as student

from feel321.analysis import space, words
from feel321.analysis.association import correlate
from feel321.analysis.choices import EVERY, compare_with_original, infer_mean
from feel321.analysis.contrasts.compare import fit_reducers
from feel321.analysis.mixed.model import contrast
from feel321.analysis.primary.model import fit_primary, fit_slopes
from feel321.analysis.primary.plan import REDUCER, make_cells
from feel321.analysis.primary.sensitivity import FEWEST_REDUCERS, measure_excess
from feel321.analysis.resampling import Choices
from feel321.analysis.table.columns import ROTATIONS
from feel321.analysis.table.items import Table, recast_pairs, split_tests
from feel321.analysis.table.schema import PAIRED
from feel321.arguments import check_name
from feel321.records import MEASURES, Option, PaperClaim

# Verdicts: the interval lies where the paper says, or elsewhere, or holds both; or there is no number.
AGREES, DIFFERS, OPEN, NOT_ESTIMABLE = "agrees", "differs", "open", "not_estimable"
LIMIT = 0.05  # Where permutations cannot give a p below, nothing is estimated
MEAN, SD = "_rotation_mean", "_rotation_sd"
USUAL_LEVEL = "as_is"  # The level that a claim is about where it names none and there are several
Ends = tuple[float, float, float]  # A value and the ends of its interval


@dataclass(frozen=True, slots=True, eq=False)
class Paper:
    """A paper that is replicated.

    seen: full text or abstract. published: its table of metrics, one row per number: recording, reducer, metric,
    paper, table, source. mountings: recording, reducer, metric, and mean and quantiles over orientations of the sensor.
    """

    citation: str
    doi: str
    seen: str
    claims: tuple[PaperClaim, ...] = ()
    published: DataFrame | None = None
    mountings: DataFrame | None = None


@dataclass(frozen=True, slots=True)
class ClaimValue:
    """What a measure found.

    kind: how the number is rounded, a key of `words.PLACES`. unit: what stands behind it. n: what it rests on. method,
    interval: how value and interval were computed. beside: for the expectations highest and lowest, by the name of each
    other unit, ours minus theirs with its interval. note: a sentence of the measure's own.
    """

    value: float
    low: float = math.nan
    high: float = math.nan
    kind: str = "correlation"
    unit: str = ""
    n: int = 0
    method: str = ""
    interval: str = ""
    beside: Mapping[str, Ends] = field(default_factory=dict)
    note: str = ""

    def describe(self) -> str:
        """Write the number with its unit and interval."""
        value, interval = words.format_estimate(self.value, self.low, self.high, kind=self.kind)
        unit = f" {self.unit}" if self.unit else ""
        return f"{value}{unit}" + (f" ({interval})" if interval != words.ABSENT else "")


Measure = Callable[["Table", PaperClaim, "Choices"], ClaimValue]


@dataclass(frozen=True, slots=True)
class PaperAnswer:
    """What this study says to a claim; found is None where there is no number, and the sentence says why."""

    claim: PaperClaim
    verdict: str
    sentence: str
    found: ClaimValue | None = None
    without: ClaimValue | None = None


def answer_claims(table: Table, paper: Paper, choices: Choices) -> Iterator[PaperAnswer]:
    """Answer every claim of a paper."""
    for claim in paper.claims:
        measure: Measure = globals()[MEASURES[claim.measure]]
        try:
            own = narrow(table, claim)
            found = measure(own, claim, choices)
        except ValueError as error:
            yield PaperAnswer(claim, NOT_ESTIMABLE, f"{str(error).rstrip('.')}.")
            continue
        without, rows = None, own.rows
        # Without the exceptions that the paper names, where they were rated and enough is left.
        if set(claim.exceptions) & set(rows["reducer"]):
            names, stimuli = claim.exceptions, own.stimuli
            rows = rows[~(rows["reducer"].isin(names) | rows["reference_reducer"].isin(names))]
            kept = None if stimuli is None else stimuli[~stimuli["reducer"].isin(names)]
            with suppress(ValueError):
                rest = replace(own, rows=rows.reset_index(drop=True), stimuli=kept)
                without = measure(rest, claim, choices)
        sentence = _describe(claim, found, without)
        yield PaperAnswer(claim, judge(claim, found), sentence, found, without)


def narrow(table: Table, claim: PaperClaim) -> Table:
    """Select the ratings that a claim is about: scale and level of its options, or the first scale, as it is."""
    if claim.options.get("scale") == PAIRED:
        levels = sorted(table.rows.loc[table.rows["scale"] == PAIRED, "level"].unique())
        usual = USUAL_LEVEL if USUAL_LEVEL in levels else next(iter(levels), None)
        return table.select(PAIRED, level=str(claim.options.get("level", usual)))
    table = replace(table, rows=recast_pairs(table.rows))
    arms = [(part.scale, part.level) for part in split_tests(table)]
    if not arms:  # only pairs or choices were judged; a measure finds them in the whole table
        return table
    scale, level = (claim.options.get(name) for name in ("scale", "level"))
    fitting = [one for one in arms if scale in {None, one[0]} and level in {None, one[1]}]
    if not fitting:
        given = {"scale": scale, "level": level}.items()
        wanted = " and ".join(f"{key} {name!r}" for key, name in given if name is not None)
        known = ", ".join(map(" ".join, arms))
        raise ValueError(f"nothing was rated on {wanted}; there are {known}")
    chosen = next((one for one in fitting if one[1] == USUAL_LEVEL), fitting[0])
    return table.select(chosen[0], level=chosen[1])


def judge(claim: PaperClaim, found: ClaimValue) -> str:
    """Compare what was found with what the paper says.

    Of positive and negative, the whole interval must lie on one side of zero; of near, the value must lie within the
    paper's range (low to high), and what differs excludes it; of highest and lowest, the differences from all others
    must exclude zero. A number without an interval is taken as it is; a difference that is written as zero is none.
    """
    if not math.isfinite(found.value):
        return NOT_ESTIMABLE
    ends = _fill_ends((found.value, found.low, found.high))
    if claim.expect == "near":
        _, low, high = _fill_ends(claim.paper)
        if low <= found.value <= high:
            return AGREES
        return DIFFERS if ends[2] < low or ends[1] > high else OPEN
    ranked = claim.expect in {"highest", "lowest"}
    gaps = [_fill_ends(one) for one in found.beside.values()] if ranked else [ends]
    places = words.PLACES[found.kind]
    gaps = [one if one[1] < one[2] else (round(one[0], places),) * 3 for one in gaps]
    if claim.expect in {"negative", "lowest"}:
        gaps = [(-value, -high, -low) for value, low, high in gaps]
    if not gaps:
        return NOT_ESTIMABLE
    if any(high < 0 for _, _, high in gaps):
        return DIFFERS
    return AGREES if all(low > 0 for _, low, _ in gaps) else OPEN


def _fill_ends(ends: Ends) -> Ends:
    """Take a number without an interval as certain."""
    value, low, high = ends
    return ends if math.isfinite(low + high) else (value, value, value)


def _describe(claim: PaperClaim, found: ClaimValue, without: ClaimValue | None) -> str:
    """Say what was found, the paper's number beside it, and what it is without the exceptions."""
    parts = [f"here {found.describe()}"]
    value, low, high = claim.paper
    if math.isfinite(value):
        parts.append(f"the paper {words.format_number(value, kind=found.kind)}")
    elif math.isfinite(low + high):
        parts.append(f"the paper {words.format_interval(low, high, kind=found.kind)}")
    if claim.expect in {"highest", "lowest"} and found.beside:
        upward = claim.expect == "highest"
        parts.append(describe_nearest(found.beside, upward=upward, kind=found.kind))
    if without is not None:
        parts.append(f"without {words.join_words(claim.exceptions)} {without.describe()}")
    return f"{'; '.join(parts)}. {found.note}".rstrip()


def describe_nearest(beside: Mapping[str, Ends], *, upward: bool, kind: str) -> str:
    """Name the unit that comes closest, or is beyond."""
    nearest = min if upward else max
    name, ends = nearest(beside.items(), key=lambda item: item[1][0])
    way = 1 if ends[0] >= 0 else -1
    low, high = sorted(way * end for end in ends[1:])
    value, interval = words.format_estimate(way * ends[0], low, high, kind=kind)
    other = f"that of {words.format_name(name)}"
    if interval == words.ABSENT and value == words.format_number(0.0, kind=kind):
        return f"the same as {other}"
    told = f" ({interval})" if interval != words.ABSENT else ""
    return f"{value} {'higher' if way > 0 else 'lower'} than {other}{told}"


def require_option(claim: PaperClaim, name: Option) -> str:
    """Take an option that a measure cannot do without."""
    if name not in claim.options:
        raise ValueError(f"options must name a {name}; add {name} = ... to the claim {claim.name}")
    return str(claim.options[name])


def tabulate_metric(table: Table, metric: str) -> DataFrame:
    """Tabulate a metric of the test stimuli of one level, rated or not: recordings by reducers."""
    stimuli = table.stimuli
    if stimuli is None or metric not in stimuli:
        raise ValueError(f"the manifest has no column {metric!r}")
    tests = stimuli[stimuli["role"] == "test"]
    rated = [str(level) for level in table.rows["level"].unique()]
    level = rated[0] if len(rated) == 1 else USUAL_LEVEL
    own = tests[tests["level"] == level] if (tests["level"] == level).any() else tests
    return own.pivot_table(metric, "recording", "reducer", observed=True).rename(columns=str)


def measure_metric(table: Table, claim: PaperClaim, choices: Choices) -> ClaimValue:  # noqa: ARG001 - every measure has this form
    """Average a metric of a reducer over recordings; options: metric, reducer, recording (one alone), among."""
    metric, reducer = require_option(claim, "metric"), require_option(claim, "reducer")
    found = tabulate_metric(table, metric)
    if recording := str(claim.options.get("recording", "")):
        check_name(recording, sorted(found.index), "recording")
        found = found.loc[[recording]]
    elif table.stimuli is not None and "source" in table.stimuli:
        # Turned copies of one recording count once.
        sources = table.stimuli.drop_duplicates("recording").set_index("recording")["source"]
        found = found.groupby(sources.astype(str)).mean()
    check_name(reducer, sorted(map(str, found)), "reducer")
    own, (others, note) = found[reducer], choose_others(claim, found, reducer)
    return ClaimValue(
        *_average(own), n=len(own), beside={name: _average(own - found[name]) for name in others},
        interval="95 % t interval over recordings" if len(own) > 1 else "",
        method=f"{metric} of {reducer}, mean over recordings", note=note,
    )  # fmt: skip


def _average(values: "Series[float]") -> Ends:
    """Average with a t interval."""
    mean, error, reach, _ = infer_mean(values.dropna().tolist())
    return mean, mean - reach * error, mean + reach * error


def measure_rating(table: Table, claim: PaperClaim, choices: Choices) -> ClaimValue:  # noqa: ARG001 - every measure has this form
    """Estimate the mean rating of a reducer, and its difference from all others; options: reducer, among."""
    reducer = require_option(claim, "reducer")
    rows = table.rows[table.rows["role"] == "test"].assign(item=lambda part: part["stimulus_id"])
    rated = sorted(rows["reducer"].unique())
    check_name(reducer, rated, "reducer")
    if len(rated) < 2:  # noqa: PLR2004 - nothing to compare with
        raise ValueError("one reducer alone was rated")
    fit, terms, n = fit_reducers(rows, rated)
    mean, (others, note) = contrast(fit, {terms[reducer]: 1}), choose_others(claim, rated, reducer)
    gaps = {name: contrast(fit, {terms[reducer]: 1, terms[name]: -1}) for name in others}
    beside = {name: (gap.estimate, gap.low, gap.high) for name, gap in gaps.items()}
    return ClaimValue(
        mean.estimate, mean.low, mean.high, "rating", "points", n, "mixed model with reducers, mean rating",
        words.INTERVALS["satterthwaite"], beside, note,
    )  # fmt: skip


def measure_slope(table: Table, claim: PaperClaim, choices: Choices) -> ClaimValue:  # noqa: ARG001 - every measure has this form
    """Estimate the slope of ratings on a metric within recordings, all metrics together; option: metric."""
    metric = require_option(claim, "metric")
    fit = fit_primary(table, list(dict.fromkeys([*table.metrics, metric])), explain=False)
    if metric not in fit.slopes.index or not fit.slopes.loc[metric, "estimable"]:
        raise ValueError(f"the slope on {metric} is not estimable")
    slope = fit.slopes.loc[[metric]].to_dict("records")[0]
    return ClaimValue(
        slope["tenth"], slope["tenth_low"], slope["tenth_high"], "slope", "points per +0.1", fit.n_items,
        f"mixed model, {metric} within recordings", words.INTERVALS["satterthwaite"],
    )  # fmt: skip


def choose_others(claim: PaperClaim, names: Iterable[object], own: str) -> tuple[list[str], str]:
    """Choose what a reducer is compared with: those of the option `among`, or all others; note which are missing."""
    known, among = list(map(str, names)), claim.options.get("among")
    chosen = [name for name in known if name != own and (among is None or name in among)]
    if not chosen and claim.expect in {"highest", "lowest"}:
        raise ValueError(f"none of the reducers that {own} is to be compared with is there")
    lacking = ", ".join(name for name in among or () if name not in known)
    return chosen, f"Not compared, because missing here: {lacking}." if lacking else ""


def measure_told_apart(table: Table, claim: PaperClaim, choices: Choices) -> ClaimValue:  # noqa: ARG001 - every measure has this form
    """Take the reducer least clearly told from the original: where it is, all are; option: reducer, for one."""
    found = compare_with_original(table.rows)
    single = found[found["reducer"] != EVERY].set_index("reducer")
    if reducer := claim.options.get("reducer"):
        single = single.loc[[check_name(str(reducer), sorted(single.index), "reducer")]]
    name = str(single["low"].idxmin())
    row = single.loc[name].to_dict()
    more = f"of {len(single)} reducers" if len(single) > 1 else ""
    d_prime = f"d' {row['d_prime']:.1f}" if row["area"] < 1 else "d' unbounded"
    return ClaimValue(
        row["difference"], row["low"], row["high"], "rating", "points", int(row["n_participants"]),
        f"dissimilarity of {name} from the original less that of identical pairs", "95 % t interval over participants",
        note=f"This is {name}, the least clear {more}".rstrip() + f" ({d_prime}).",
    )  # fmt: skip


def measure_attribute(table: Table, claim: PaperClaim, choices: Choices) -> ClaimValue:
    """Take R² of an attribute on the axes of the maps, above that of permuted stimuli; option: attribute."""
    attribute = str(claim.options.get("attribute", space.DIRECTIONS))
    rows = table.rows[table.rows["scale"] == PAIRED]
    if rows.empty:
        raise ValueError(f'no dissimilarity was rated; name options.scale = "{PAIRED}"')
    rng = choices.make_rng("lee", claim.name)
    places, found = space.gather_points(rows, table.stimuli, rng=rng)
    own = {attribute: found[check_name(attribute, sorted(found), "attribute")]}
    (row,) = space.regress_points(places, own, draws=min(choices.draws, 1000), rng=rng)
    if row["p_least"] >= LIMIT:
        none = f"give no p below {row['p_least']:.2f} for {attribute}"
        raise ValueError(f"permutations of {places.shape[1]} stimuli {none}")
    return ClaimValue(
        row["r2"] - row["chance"], row["r2"] - row["chance_high"], row["r2"] - row["chance_low"], "correlation",
        "of the variance above chance", row["n"],
        f"R² of {attribute} on the axes of the maps within recordings, less that of permuted stimuli",
        "90 % of permutations", note=f"R² is {row['r2']:.2f}, permutation p = {row['p']:.3f}.",
    )  # fmt: skip


def explain_spread(rows: DataFrame, metric: str) -> str:
    """Say why a spread may go with ratings the wrong way, where it rises with its mean; else nothing."""
    mean = metric.removesuffix(SD) + MEAN
    if not (metric in ROTATIONS and metric.endswith(SD) and {metric, mean} <= set(rows)):
        return ""
    items = rows.loc[rows["role"] == "test", ["recording", "reducer", mean, metric]]
    items = items.drop_duplicates()
    own = items[[mean, metric]].astype(float)
    within = own - own.groupby(items["recording"].astype(str)).transform("mean")
    varies = bool((within.to_numpy().std(axis=0) > 1e-9).all())  # noqa: PLR2004 - rounding
    # Two points are always on a line.
    enough = varies and len(items) > 2  # noqa: PLR2004
    together = within[mean].corr(within[metric]) if enough else 0.0
    if not together > 0:
        return ""
    means = own.groupby(items["reducer"].astype(str)).mean()
    lowest = str(means[mean].idxmin())
    (text,) = words.render_words(
        "spread", metric=metric, together=together, lowest=lowest, mean=means.loc[lowest, mean],
        spread=means.loc[lowest, metric], smallest=means[metric].min(),
    )  # fmt: skip
    return text


def measure_correlation(table: Table, claim: PaperClaim, choices: Choices) -> ClaimValue:
    """Correlate mean ratings with a metric over stimuli; options: metric, and method (`correlate`)."""
    metric = require_option(claim, "metric")
    method = str(claim.options.get("method", "pearson"))
    rng = choices.make_rng("paper", claim.name)
    found = correlate(table, metric, method=method, draws=choices.draws, rng=rng)
    if not math.isfinite(found.value + found.low + found.high):
        raise ValueError(" ".join(found.notes) or "the correlation has no interval")
    wrong = metric in ROTATIONS and metric.endswith(SD) and found.value > 0
    return ClaimValue(
        found.value, found.low, found.high, n=found.n_items,
        method=f"{words.format_method(method)} of mean ratings with {words.format_name(metric)}",
        interval=words.INTERVALS["two-way"], note=words.capitalise(explain_spread(table.rows, metric)) if wrong else "",
    )  # fmt: skip


def measure_rating_excess(table: Table, claim: PaperClaim, choices: Choices) -> ClaimValue:  # noqa: ARG001 - every measure has this form
    """Estimate how much higher a reducer is rated than metrics predict from all others; options: reducer, metrics."""
    reducer = require_option(claim, "reducer")
    metrics = claim.options.get("metrics", table.metrics)
    cells = make_cells(table.rows, [metrics] if isinstance(metrics, str) else list(metrics))
    rated = list(map(str, cells.items[REDUCER].unique()))
    check_name(reducer, rated, "reducer")
    if len(rated) < FEWEST_REDUCERS:
        raise ValueError(f"{len(rated)} reducers were rated, {FEWEST_REDUCERS} are needed")
    excess, se, df = measure_excess(cells, reducer, fit_slopes(cells.leave_out(REDUCER, reducer)))
    half = float(student.ppf(0.975, df)) * se
    if not half > 0:
        raise ValueError(f"the excess of {reducer} has no interval")
    return ClaimValue(
        excess, excess - half, excess + half, "rating", "points", len(rated),
        f"rating of {reducer} beyond what slopes on the metrics, fitted without it, predict",
        "95 % t interval over reducers, with the uncertainty of the slopes",
    )  # fmt: skip
