"""Section: a paper's own questions, each answered by this study; it opens the report of a replication."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from feel321.analysis import words
from feel321.analysis.replication import claims as paper_claims
from feel321.analysis.replication.claims import NOT_ESTIMABLE, PaperAnswer
from feel321.analysis.report.section import NAME, Column, Section, TableForm, read_methods
from feel321.analysis.words import Line, make_interval, make_number

if TYPE_CHECKING:
    from feel321.analysis.replication.claims import Paper
    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table
    from feel321.analysis.words import Number

KEY, TITLE = "paper", "The paper's questions"
VERDICTS = {
    paper_claims.AGREES: "agrees", paper_claims.DIFFERS: "differs", paper_claims.OPEN: "open",
    NOT_ESTIMABLE: "not estimable",
}  # fmt: skip

CLAIMS = TableForm(
    "What the paper says, where that was seen, its number and this study's with a 95 % interval. Agrees or differs: "
    "the whole interval lies where the paper says, or elsewhere; open: it holds both. Without: the same without the "
    "reducers that the paper names as exceptions.",
    (
        Column("Claim", "claim", NAME), Column("Seen in", "source", NAME), Column("The paper", "_paper", NAME),
        Column("Here", "_here", NAME), Column("Interval", "_interval", NAME), Column("Verdict", "_verdict", NAME),
        Column("Without", "_without", NAME),
    ),
    path="claim.{name}", detail=False,
)  # fmt: skip


def compute(
    table: Table, choices: Choices, paper: Paper, *, sections: Sequence[Section] = ()
) -> Section:
    """Answer the questions of a paper; sections: those that follow it, which found what no metric accounts for."""
    answers = list(paper_claims.answer_claims(table, paper, choices))
    lines = [
        *_describe_surprises(paper, sections),
        *([_count_verdicts(answers)] if answers else []),
        *(
            f"{VERDICTS[one.verdict]}: {one.claim.claim} ({one.claim.source}) - {one.sentence}"
            for one in answers
        ),
    ]
    rows = [_make_row(one) for one in answers]
    verdict = [Line(words.capitalise(text), f"{TITLE}: {paper.citation}") for text in lines]
    return Section(
        KEY, TITLE, answers=tuple(map(str, verdict)), verdict=verdict, grids=[CLAIMS.build(rows)],
        unseen=tuple(_list_numbers(answers)), tables={"paper_claims": rows}, how=read_methods(KEY),
    )  # fmt: skip


def _describe_surprises(paper: Paper, sections: Sequence[Section]) -> Iterator[str]:
    """Name reducers that were rated otherwise than the metrics predict, and whether the paper names them too."""
    found = [one.tables["exceptions"] for one in sections if "exceptions" in one.tables]
    named = {name for claim in paper.claims for name in claim.exceptions}
    odd = found[0][found[0]["exceptional"]] if found else None
    for reducer, rows in odd.groupby("reducer", sort=False) if odd is not None else ():
        points = [
            words.format_number(abs(one), kind="rating") for one in sorted(rows["excess"], key=abs)
        ]
        span = " to ".join(dict.fromkeys([points[0], points[-1]]))
        ways = {"higher" if one > 0 else "lower" for one in rows["excess"]}
        where = "; ".join(map(str, rows["ratings"].map(words.format_name)))
        also = (
            "the paper names it as an exception too"
            if reducer in named
            else "the paper names no such exception"
        )
        yield (
            f"{reducer} was rated {span} points {' or '.join(sorted(ways))} than the metrics predict from the other "
            f"reducers ({where}); {also}."
        )


def _count_verdicts(answers: Sequence[PaperAnswer]) -> str:
    """Count the claims with each verdict."""
    counts = {word: sum(one.verdict == key for one in answers) for key, word in VERDICTS.items()}
    told = words.join_words([f"{word} {count}" for word, count in counts.items() if count])
    return f"claims of the paper: {len(answers)}; {told}."


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
                number = make_number(path, found.value, found.method, n=found.n)
                yield make_interval(number, found.low, found.high, uncertainty=found.interval)
