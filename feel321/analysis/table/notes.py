"""Notes on a table of ratings: what it lacks or may have confused is said, never repaired."""

from __future__ import annotations

import unicodedata
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from feel321.analysis.table import schema
from feel321.analysis.table.items import ROLE, STIMULUS, TEST
from feel321.analysis.table.metrics import describe_explored
from feel321.analysis.table.schema import shorten
from feel321.analysis.words import name_some

if TYPE_CHECKING:
    from pandas import DataFrame

SHORT = 10  # Points below which a scale's highest rating makes one doubt that it went to 100
SPACE = "Where a map of the dissimilarities can be made, see The space of what was felt."


def list_names(names: Sequence[str]) -> str:
    """List names for a note; of more than three, the others are counted."""
    return name_some([shorten(name) for name in names])


def note_ratings(sheet: DataFrame) -> Iterator[str]:
    """Say which scales may have had other ends or were judged in several tasks, and which playbacks were broken."""
    for scale, rows in sheet.groupby("scale"):
        name, low, high = shorten(str(scale)), rows["rating"].min(), rows["rating"].max()
        if low < high <= SHORT:
            do = "if 100 was not its upper end, rescale them to 0 to 100"
            yield f"Ratings of scale {name} run from {low:g} to {high:g}: {do}."
        tasks = sorted(rows["protocol"].unique()) if "protocol" in rows else []
        if len(tasks) > 1:
            listed = list_names(tasks)
            yield f"Scale {name} was judged in {len(tasks)} protocols, which are taken together: {listed}."
    broken = sheet.loc[sheet["underruns"] > 0, "participant"] if "underruns" in sheet else ()
    if len(broken):
        which = f"{len(broken)} judgements of {len(set(broken))} participants"
        how = "they count; mark them as rejected to leave them out"
        yield f"{which} were made on an interrupted playback (underruns): {how}."


def note_sources(rows: DataFrame) -> Iterator[str]:
    """Say how many independent sources the rated recordings come from, where they are fewer."""
    tests = rows[ROLE] == TEST
    recordings, sources = (rows.loc[tests, name].nunique() for name in ("recording", "source"))
    start = f"The {recordings} recordings come from {sources} source{'s' if sources > 1 else ''}, turned, cut or edited"
    if sources == 1 < recordings:
        yield f"{start}: they are not independent, and the results do not extend to other sources."
    elif sources < recordings:
        what = "they are not independent, and what is said of others rests on sources"
        draws = (
            "Two-way intervals draw them; mixed models hold what the recordings of a source share"
        )
        yield f"{start}: {what}. {draws}, as a whole and reducer by reducer."


def note_gaps(rows: DataFrame, manifest: DataFrame, metrics: Sequence[str]) -> Iterator[str]:
    """Say which stimuli nobody rated, and which metrics some of those that were rated lack."""
    apart, tests = rows[rows["scale"].isin(schema.APART)], rows[rows[ROLE] == TEST]
    rated = {*rows[STIMULUS], *apart["reference_id"], *apart["other_id"]}
    if unrated := [str(name) for name in manifest.index if name not in rated]:
        yield f"{len(unrated)} of {len(manifest)} stimuli of the manifest were rated by nobody: {list_names(unrated)}."
    for name in (name for name in describe_explored(metrics) if name in rows):
        lacking = tests.loc[tests[name].isna(), STIMULUS].unique()
        if len(lacking):
            first = shorten(str(lacking[0]))
            yield f"'{name}' is not reported: {len(lacking)} rated test stimuli have none, first {first}."


def note_lookalikes(rows: DataFrame) -> Iterator[str]:
    """Say which names look alike, but for what the eye does not see: capitals, accents' form, kinds of blanks."""

    def look(name: str) -> str:
        letters = unicodedata.normalize("NFKC", name)
        seen = "".join(letter for letter in letters if unicodedata.category(letter) != "Cf")
        return " ".join(seen.split()).casefold()

    for column in ("participant", STIMULUS, "recording", "reducer", "level", "scale"):
        looks = {name: look(name) for name in sorted(rows[column].unique())}
        times = Counter(looks.values())
        if alike := [name for name, seen in looks.items() if times[seen] > 1]:
            how = "that differ in capitals, accents or blanks only are taken as different"
            yield f"Names in column '{column}' {how}: {list_names(alike)}."


def note_apart(rows: DataFrame) -> Iterator[str]:
    """Say which scales enter no association, and why."""
    counts = rows["scale"].value_counts()
    for scale in (scale for scale in schema.APART if scale in counts):
        own, n = rows[rows["scale"] == scale], counts[scale]
        none = f"Scale '{scale}': none of its {n} judgements enters an association, because"
        pairs, turned = (int((own[ROLE] == role).sum()) for role in (schema.PAIR, TEST))
        if scale == schema.ANSWERED:
            what = "they are right (100) or wrong (0). The profile holds the percentage correct"
            yield f"{none} {what}; guessing gives 50."
        elif scale in schema.CHOSEN:
            where = "They are evaluated under Choices between two stimuli"
            yield f"{none} one of two stimuli was chosen. {where}."
        elif not turned:
            why = "a metric describes one stimulus and they compare two"
            held = f"The profile holds the {n - pairs} that compare with the reference"
            yield f"{none} {why}. {held}, and leaves out {pairs}. {SPACE}"
        else:
            yield (
                f"Scale '{scale}': {turned} of its {n} judgements compare a reduction with its original. Those enter "
                f"associations and slopes as a similarity, 100 less the dissimilarity (scale '{schema.RECAST}'): with "
                "the dissimilarity itself every slope and every correlation has the opposite sign. The other "
                f"{n - turned} (two reductions, identical pairs, anchors) enter none of them. {SPACE}"
            )
