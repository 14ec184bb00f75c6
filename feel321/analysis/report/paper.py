"""Section: a paper's own questions, each answered by this study; it opens the report of a replication."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from feel321.analysis import words
from feel321.analysis.replication import claims as paper_claims
from feel321.analysis.replication.claims import NOT_ESTIMABLE, PaperAnswer
from feel321.analysis.replication.landin import tabulate_metric
from feel321.analysis.report.section import NAME, TEXT, Column, Section, TableForm, read_methods
from feel321.analysis.table.metrics import order_reducers
from feel321.analysis.words import Line, make_interval, make_number

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.replication.claims import Paper
    from feel321.analysis.report.section import PageTable
    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table
    from feel321.analysis.words import Number

KEY, TITLE = "paper", "The paper's questions"
VERDICTS = {
    paper_claims.AGREES: "agrees", paper_claims.DIFFERS: "differs", paper_claims.OPEN: "open",
    NOT_ESTIMABLE: "not estimable",
}  # fmt: skip

CLAIMS = TableForm(
    "Each claim of the paper, its number and this study's with a 95 % interval (of attributes of maps: 90 % of "
    "permutations), and where it was seen. Agrees: the whole interval lies on the paper's side of zero or of all "
    "others, or the value within the paper's range; differs: the interval lies elsewhere; open: neither. Without: "
    "the same without the reducers that the paper names as exceptions.",
    (
        Column("Claim", "name", TEXT), Column("Verdict", "_verdict", NAME), Column("The paper", "_paper", NAME),
        Column("Here", "_here", NAME), Column("Interval", "_interval", NAME), Column("Without", "_without", NAME),
        Column("Seen in", "source", NAME),
    ),
    path="claim.{name}", detail=False,
)  # fmt: skip


def compute(
    table: Table, choices: Choices, paper: Paper, *, sections: Sequence[Section] = ()
) -> Section:
    """Answer the questions of a paper; sections: those that follow it, which found what no metric accounts for."""
    answers = list(paper_claims.answer_claims(table, paper, choices))
    surprises = [*_describe_surprises(paper, sections)] or [*_describe_excess(answers)]
    verdict = [Line(text, TITLE) for text in surprises]
    verdict += [Line(_count_verdicts(answers, paper), TITLE)] if answers else []
    verdict += [Line(_describe(one), TITLE, VERDICTS[one.verdict]) for one in answers]
    rows = [_make_row(one) for one in answers]
    metrics = tabulate_metrics(table, paper)
    return Section(
        KEY, TITLE, answers=tuple(map(str, verdict)), verdict=verdict,
        grids=[CLAIMS.build(rows), *_build_metrics(metrics)], unseen=tuple(_list_numbers(answers)),
        tables={"paper_claims": rows, "paper_metrics": metrics}, how=read_methods(KEY),
    )  # fmt: skip


def _describe(one: PaperAnswer) -> str:
    return f"{one.claim.claim} [{one.claim.source}]. {words.capitalise(one.sentence)}"


def list_claims(sections: Sequence[Section]) -> tuple[dict[str, Any], ...]:
    """List the claims of a report with their verdicts, for a program; none where no paper is replicated."""
    found = [one.tables["paper_claims"] for one in sections if "paper_claims" in one.tables]
    return tuple(row for rows in found for row in rows.to_dict("records"))


def _describe_surprises(paper: Paper, sections: Sequence[Section]) -> Iterator[str]:
    """Name reducers that were rated otherwise than the metrics predict, and whether the paper names them too."""
    found = [one.tables["exceptions"] for one in sections if "exceptions" in one.tables]
    named = _name_exceptions(paper)
    odd = found[0][found[0]["exceptional"]] if found else None
    for reducer, rows in odd.groupby("reducer", sort=False) if odd is not None else ():
        points = [
            words.format_number(abs(one), kind="rating") for one in sorted(rows["excess"], key=abs)
        ]
        span = " to ".join(dict.fromkeys([points[0], points[-1]]))
        ways = {"higher" if one > 0 else "lower" for one in rows["excess"]}
        where = "; ".join(map(str, rows["ratings"].map(words.format_name)))
        also = "the paper names no such exception"
        if reducer in named:
            also = "the paper names it as an exception too"
            if (told := named[reducer]) and not told >= ways:
                also = f"the paper names it too, but as rated {' or '.join(sorted(told))}"
        yield (
            f"the reducer {reducer} was rated {span} points {' or '.join(sorted(ways))} than the metrics predict from "
            f"the other reducers ({where}); {also}."
        )


WAYS = {"positive": "higher", "negative": "lower"}


def _name_exceptions(paper: Paper) -> dict[str, set[str]]:
    """Name the paper's exceptions: reducer -> which way they were rated, as far as claims say so."""
    named: dict[str, set[str]] = {}
    for claim in paper.claims:
        for name in claim.exceptions:
            named.setdefault(name, set())
        if claim.measure == "rating_excess" and claim.expect in WAYS:
            named.setdefault(str(claim.options.get("reducer")), set()).add(WAYS[claim.expect])
    return named


COUNTED = {
    paper_claims.DIFFERS: ("differs from this study", "differ from this study"),
    paper_claims.AGREES: ("agrees", "agree"), paper_claims.OPEN: ("stays open", "stay open"),
    NOT_ESTIMABLE: ("is not estimable", "are not estimable"),
}  # fmt: skip


def _count_verdicts(answers: Sequence[PaperAnswer], paper: Paper) -> str:
    """Count the claims with each verdict, those first that differ, by name."""
    told = []
    for key, forms in COUNTED.items():
        if own := [one.claim.name for one in answers if one.verdict == key]:
            which = f" ({', '.join(map(words.format_name, own))})" * (key == paper_claims.DIFFERS)
            told.append(f"{len(own)} {forms[len(own) > 1]}{which}")
    ours = sum(one.claim.source == "ours" for one in answers)
    added = f"; {ours} of them this study's own" if ours else ""
    what = f"{'question' if ours else 'claim'}{'s' * (len(answers) > 1)}"
    about = f"{what} {'about' if ours else 'of'} the paper ({paper.citation}; {paper.seen}{added})"
    return f"of {len(answers)} {about}, {words.join_words(told)}."


def _make_row(one: PaperAnswer) -> dict[str, Any]:
    """Make a row of the table and of the CSV file."""
    claim, found = one.claim, one.found
    row: dict[str, Any] = {
        "name": claim.name, "claim": claim.claim, "source": claim.source, "measure": claim.measure,
        "expect": claim.expect, **_name_ends("paper", claim.paper),
        **_name_ends("value", (found.value, found.low, found.high) if found else paper_claims.NO_NUMBER),
        "unit": found.unit if found else "", "n": found.n if found else 0,
        "method": found.method if found else "", "interval": found.interval if found else "",
        "verdict": one.verdict, "exceptions": claim.exceptions,
        **_name_ends("without", _take_ends(one.without)), "sentence": one.sentence,
        "_verdict": VERDICTS[one.verdict], "_without": one.without.describe() if one.without else words.ABSENT,
    }  # fmt: skip
    kind = found.kind if found else "correlation"
    here, interval = words.format_estimate(*_take_ends(found), kind=kind)
    unit = f" {found.unit}" if found and found.unit else ""
    paper, _, _ = claim.paper
    told = words.format_number(paper, kind=kind)
    if not math.isfinite(paper):
        told = words.format_interval(*claim.paper[1:], kind=kind)
    return row | {"_paper": told, "_here": f"{here}{unit}", "_interval": interval}


def _describe_excess(answers: Sequence[PaperAnswer]) -> Iterator[str]:
    """Name the reducers of claims about an excess that is not open, where the primary model cannot tell."""
    for one in answers:
        settled = one.claim.expect in WAYS and one.verdict in {
            paper_claims.AGREES, paper_claims.DIFFERS,
        }  # fmt: skip
        if one.claim.measure == "rating_excess" and one.found and settled:
            points = words.format_number(abs(one.found.value), kind="rating")
            way = "higher" if one.found.value > 0 else "lower"
            reducer, metrics = one.claim.options["reducer"], one.claim.options.get("metrics", ())
            metrics = [metrics] if isinstance(metrics, str) else list(metrics)
            predict = "predicts" if len(metrics) == 1 else "predict"
            names = words.join_words([
                words.format_name(str(name)) for name in metrics or ["the metrics"]
            ])
            also = (
                "the paper says so too"
                if one.verdict == paper_claims.AGREES
                else "not as in the paper"
            )
            yield (
                f"the reducer {reducer} was rated {points} points {way} than {names} {predict} "
                f"from the other reducers; {also}."
            )


def _take_ends(found: paper_claims.ClaimValue | None) -> paper_claims.Ends:
    return (found.value, found.low, found.high) if found else paper_claims.NO_NUMBER


def _name_ends(name: str, ends: paper_claims.Ends) -> dict[str, float]:
    return dict(zip((name, f"{name}_low", f"{name}_high"), ends, strict=True))


def _list_numbers(answers: Sequence[PaperAnswer]) -> Iterator[Number]:
    """List the numbers that claims were answered with."""
    for one in answers:
        for end, found in (("", one.found), (".without", one.without)):
            if found is not None:
                path = words.name_path("claim", one.claim.name) + end
                number = make_number(path, found.value, found.method, n=found.n, keys="claim")
                yield make_interval(number, found.low, found.high, uncertainty=found.interval)


# The paper's table: metrics of every recording and transform, with the paper's numbers and other mountings beside.

MATCH_METRICS = ("spectral_match", "temporal_match")
ROW_KEYS = ["recording", "reducer", "metric"]
MOUNTINGS = TableForm(
    "The same with other mountings of the sensor: each recording turned into random orientations, reduced and matched. "
    "Mean, and the quantiles between which 90 % of the orientations lie.",
    (
        Column("Recording", "recording", NAME), Column("Transform", "reducer", NAME), Column("Metric", "metric", TEXT),
        Column("As mounted", "value"), Column("Mean", "mounting_mean", end="mean", method="mean over orientations"),
        Column("5 %", "q05", end="q05", method="5 % quantile over orientations"),
        Column("Median", "q50", end="q50", method="median over orientations"),
        Column("95 %", "q95", end="q95", method="95 % quantile over orientations"),
    ),
    path="mountings.{recording}.{reducer}.{metric}",
)  # fmt: skip


def tabulate_metrics(table: Table, paper: Paper) -> DataFrame:
    """Tabulate the match metrics of every recording and reducer, with the paper's numbers and mountings beside."""
    import pandas as pd

    if paper.published is None or table.stimuli is None:
        return pd.DataFrame()
    known = [name for name in MATCH_METRICS if name in table.stimuli]
    if not known:
        return pd.DataFrame()
    wide = {name: tabulate_metric(table, name).reset_index() for name in known}
    long = (
        own.melt("recording", var_name="reducer", value_name="value").assign(metric=name)
        for name, own in wide.items()
    )
    found = pd.concat(long, ignore_index=True).dropna(subset="value")
    for beside in (paper.published, paper.mountings):
        if beside is not None:
            found = found.merge(beside, how="left", on=ROW_KEYS)
    texts = found.select_dtypes(exclude="number").columns
    found[texts] = found[texts].fillna("")
    later = ~found["recording"].isin(paper.published["recording"])  # first what the paper shows
    found = found.assign(later=later).sort_values(["later", "recording", "metric"], kind="stable")
    return found.drop(columns="later").reset_index(drop=True)


def _build_metrics(found: DataFrame) -> Iterator[PageTable]:
    """Build the table of recordings by transforms, the paper's numbers below each row, and that of mountings."""
    if found.empty:
        return
    reducers = order_reducers(found["reducer"])
    form = TableForm(
        "Spectral match (eq. 1) and temporal match (eq. 2) of every transform, for each recording as its sensor was "
        "mounted; below, the paper's numbers for what the recording stands for.",
        (
            Column("Recording", "recording", NAME), Column("Metric", "metric", TEXT), Column("Of", "_of", NAME),
            *(Column(name, name, end=words.name_path(name), method="{_method}") for name in reducers),
        ),
        path="transforms.{recording}.{metric}.{_source}", detail=False,
    )  # fmt: skip
    rows: list[dict[Any, Any]] = []
    for (recording, metric), part in found.groupby(["recording", "metric"], sort=False):
        names = {"recording": recording, "metric": metric, "n": 1}
        own = part.set_index("reducer").reindex(reducers)
        here = {
            "_of": "this study",
            "_source": "here",
            "_method": f"{metric} of this study's recording",
        }
        rows.append(names | here | own["value"].to_dict())
        if own["paper"].notna().any():
            first = own.dropna(subset="paper").iloc[0]
            told = f"{first['shown']} ({first['table']}, {first['source']})"
            theirs = {"_of": told, "_source": "paper", "_method": f"the paper's number, {told}"}
            rows.append(names | theirs | own["paper"].to_dict())
    yield form.build(rows)
    if "mounting_mean" in found:
        turned = found.dropna(subset="mounting_mean").assign(n=1)
        yield MOUNTINGS.build(turned.to_dict("records"))
