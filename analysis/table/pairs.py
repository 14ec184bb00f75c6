"""What was judged against what: the stimulus that a judgement is about, and the role it had there.

Conventions: `reference_id` names another stimulus, or `surface`, or is empty. A dissimilarity has no direction, so
whichever of the two is not the reference is what the judgement is about.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.table.scales import PAIR, PAIRED
from analysis.table.sheet import refuse_lines
from protocols.trial import SURFACE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pandas import DataFrame, Series


SURFACED, UNLISTED = "the real surface", "what the manifest does not list"
FOREIGN = "a stimulus of another recording"


def turn_pairs(ratings: DataFrame, manifest: DataFrame, *, what: str) -> DataFrame:
    """Let every dissimilarity be about the stimulus that was compared with the reference.

    Parameters
    ----------
    ratings : DataFrame
        Judgements, indexed by line number: stimulus_id, reference_id, scale.
    manifest : DataFrame
        Stimuli, indexed by stimulus_id: role.
    what : str
        The file's name, for the message.

    Returns
    -------
    DataFrame
        The same, both stimuli of a pair exchanged where the one called stimulus_id was the reference.

    Raises
    ------
    ValueError
        If a dissimilarity's reference_id is not empty and the manifest does not know it; names the lines.
    """
    is_paired = (ratings["scale"] == PAIRED) & (ratings["reference_id"] != "")
    others = ratings.loc[is_paired, "reference_id"]
    unknown = f"in column 'reference_id' of a {PAIRED}, which must be empty or a stimulus of the manifest"
    refuse_lines(others[~others.isin(manifest.index)], what, why=unknown)
    backward = is_paired & (ratings["stimulus_id"].map(manifest["role"]) == "reference")
    ids = ["stimulus_id", "reference_id"]
    turned = ratings.copy()
    turned.loc[backward, ids] = ratings.loc[backward, ids[::-1]].to_numpy()
    return turned


def find_roles(rows: DataFrame, manifest: DataFrame) -> Series:
    """Find the role that each stimulus had in its judgement.

    Parameters
    ----------
    rows : DataFrame
        Judgements, pairs turned: stimulus_id, reference_id, scale, role.
    manifest : DataFrame
        Stimuli, indexed by stimulus_id: role.

    Returns
    -------
    Series of str
        ``reference`` for a test stimulus that was judged against itself, the hidden reference there; ``pair`` for
        a dissimilarity of two stimuli of which neither is the reference; otherwise the role of the manifest.
    """
    is_same = rows["stimulus_id"] == rows["reference_id"]
    roles = rows["role"].mask(is_same & (rows["role"] == "test"), "reference")
    is_pair = (rows["scale"] == PAIRED) & (rows["reference_id"] != "") & ~is_same
    return roles.mask(is_pair & (rows["reference_id"].map(manifest["role"]) != "reference"), PAIR)


def find_matched(rows: DataFrame, manifest: DataFrame) -> Series:
    """Tell of which judgements the metrics speak: they say how well a stimulus matches its own recording.

    Parameters
    ----------
    rows : DataFrame
        Judgements, pairs turned: reference_id, recording.
    manifest : DataFrame
        Stimuli, indexed by stimulus_id: recording, reducer, role.

    Returns
    -------
    Series of bool
        False where the reference was what a reducer made, or another recording. The real surface, which the recording
        stands for, and a reference that the manifest does not list are taken for what was recorded.
    """
    whole = {name: _tell_reference(name, manifest) for name in rows["reference_id"].unique()}
    told = rows["reference_id"].map(whole)
    return told.isin(["", SURFACED, UNLISTED]) & ~_is_foreign(rows, manifest)


def note_references(rows: DataFrame, manifest: DataFrame) -> Iterator[str]:
    """Say which judgements had another reference than the metrics have, or none that is known.

    Parameters
    ----------
    rows : DataFrame
        Judgements: reference_id, recording, scale, role.
    manifest : DataFrame
        Stimuli, indexed by stimulus_id: recording, reducer, role.

    Yields
    ------
    str
        One sentence per scale and such reference.
    """
    nameless = int(((rows["scale"] == PAIRED) & (rows["reference_id"] == "")).sum())
    if nameless:
        yield f"{nameless} judgements of scale '{PAIRED}' name no reference_id: they are taken as from the reference."
    whole = {name: _tell_reference(name, manifest) for name in rows["reference_id"].unique()}
    told = rows.assign(reference=rows["reference_id"].map(whole).mask(_is_foreign(rows, manifest), FOREIGN))
    told = told[(told["role"] != PAIR) & (told["reference"] != "")]
    for (scale, reference), part in told.groupby(["scale", "reference"]):
        against = f"{len(part)} judgements were made against {reference}"
        fate = "" if reference in {SURFACED, UNLISTED} else ": none enters an association or a slope"
        yield f"Scale '{scale}': {against}; the metrics compare with the recording{fate}."


def _is_foreign(rows: DataFrame, manifest: DataFrame) -> Series:
    of_reference = rows["reference_id"].map(manifest["recording"])
    return of_reference.notna() & (of_reference != rows["recording"])


def _tell_reference(name: str, manifest: DataFrame) -> str:
    """Name a reference in words, unless it is the recording itself or nothing is said of it."""
    from stimuli.reduce import REDUCERS

    if name in ("", SURFACE):
        return name and SURFACED
    if name not in manifest.index:
        return UNLISTED
    reducer, role = manifest.loc[name, ["reducer", "role"]]
    return "" if role == "reference" and reducer not in REDUCERS else f"what '{reducer}' made of the recording"
