"""Tables of `study.toml` besides the study itself: `[observer]`, `[paper]` that is replicated, `[publication]`."""

from math import isnan
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from feel321.doors import name_of
from feel321.names import ANCHOR_NAMES, NO_NUMBER, PaperClaim, Provenance
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.study.settings import fields as kinds


def _check_terms(terms: dict[str, float], info: ValidationInfo) -> dict[str, float]:
    """Demand reducers as the manifest names them; without a whole file, a lab's own are not known."""
    if info.context is None:
        return terms
    stimuli, own = (info.context.get(table) for table in ("stimuli", "reducers"))
    felt = stimuli.get("reducers") if isinstance(stimuli, dict) else ()
    known = [*REDUCERS, *ANCHOR_NAMES, *(own if isinstance(own, dict) else ())]
    known += [name_of(name) for name in felt or () if isinstance(name, str)]
    for name in terms:
        kinds.check_one_of(name, known)
    return terms


class ObserverTable(kinds.TomlTable):
    """`[observer]`: how simulated participants feel and differ."""

    intercept: kinds.Finite = 10.0
    spectral: kinds.Finite = 45.0
    temporal: kinds.Finite = 35.0
    reducers: Annotated[dict[str, kinds.Finite], AfterValidator(_check_terms)] = Field(
        default_factory=dict
    )
    bias_sd: kinds.NotNegative = 6.0
    gain_sd: kinds.NotNegative = 0.15
    slope_sd: kinds.NotNegative = 0.0
    noise_sd: kinds.NotNegative = 8.0
    noise_spread: kinds.NotNegative = 0.25
    lapse_rate: kinds.Share = 0.0
    detection_sd: kinds.NotNegative = 4.0
    detection_slope: kinds.Positive = 3.0
    matching_sd: kinds.NotNegative = 1.0
    straight_liners: kinds.Share = 0.0
    random_clickers: kinds.Share = 0.0
    scale_reversers: kinds.Share = 0.0

    @model_validator(mode="after")
    def _check_shares(self) -> Self:
        bad = self.straight_liners + self.random_clickers + self.scale_reversers
        if bad > 1 + 1e-9:
            raise ValueError(
                f"straight_liners, random_clickers, scale_reversers must be at most 1 together, got {bad:g}"
            )
        return self


class PublishedTable(kinds.TomlTable):
    """`[[paper.published]]`: numbers of a metric that the paper gives for one of its recordings."""

    table: kinds.Words
    source: Provenance
    recording: kinds.Words
    shown: kinds.Words = "a recording of the paper"
    metric: kinds.Words
    numbers: Annotated[dict[str, kinds.Finite], Field(min_length=1)]


class PaperTable(kinds.TomlTable):
    """`[paper]`: the paper that is replicated."""

    citation: kinds.Words
    doi: kinds.Words
    seen: Literal["full text", "abstract"]
    claims: tuple[PaperClaim, ...] = ()
    published: tuple[PublishedTable, ...] = ()

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        kinds.check_distinct(tuple(claim.name for claim in self.claims))
        for claim in self.claims:
            if claim.paper is not NO_NUMBER and all(map(isnan, claim.paper)):
                needs = "paper must have a value, or low and high, got none"
                raise ValueError(f"claim {claim.name!r}: {needs}; add them, or leave it out")
        given = [(one, reducer) for one in self.published for reducer in one.numbers]
        kinds.check_distinct(
            tuple(f"{one.recording}, {one.metric}, {reducer}" for one, reducer in given)
        )
        return self


# What an export says of the study besides its data.

LICENCES = (  # SPDX names of the licences that data are published under
    "CC0-1.0", "CC-BY-4.0", "CC-BY-SA-4.0", "CC-BY-NC-4.0", "CC-BY-NC-SA-4.0", "CC-BY-ND-4.0", "CC-BY-NC-ND-4.0",
    "PDDL-1.0", "ODC-By-1.0", "ODbL-1.0", "CDLA-Permissive-2.0", "CDLA-Sharing-1.0",
)  # fmt: skip

_ORCID = kinds.like(
    r"(?:https://orcid\.org/)?(\d{4}-\d{4}-\d{4}-\d{3}[\dX])",
    "an ORCID iD such as '0000-0002-1825-0097'",
)
_DOI = kinds.like(
    r"(?:https://doi\.org/|doi:)?(10\.\d{4,9}/\S+)", "a DOI such as '10.5281/zenodo.123456'"
)
_DAY = kinds.like(
    r"(\d{4}-(?:0[1-9]|1[0-2])-(?:0[1-9]|[12]\d|3[01]))", "a day such as '2026-11-23'"
)


class AuthorTable(kinds.TomlTable):
    """`[[publication.authors]]`: somebody who made the study."""

    given: kinds.Words
    family: kinds.Words
    orcid: Annotated[str, _ORCID] | None = None
    affiliation: kinds.Words | None = None


class PublicationTable(kinds.TomlTable):
    """`[publication]`: what an export says of the study besides its data."""

    title: kinds.Words | None = None
    description: kinds.Words | None = None
    version: kinds.Words = "1.0.0"
    released: Annotated[str, _DAY] | None = None
    licence: Annotated[str, kinds.one_of(LICENCES)] | None = None
    authors: tuple[AuthorTable, ...] = ()
    institution: kinds.Words | None = None
    department: kinds.Words | None = None
    address: kinds.Words | None = None
    ethics: tuple[kinds.Words, ...] = ()
    funding: tuple[kinds.Words, ...] = ()
    acknowledgements: kinds.Words | None = None
    keywords: tuple[kinds.Words, ...] = ()
    references: tuple[kinds.Words, ...] = ()
    doi: Annotated[str, _DOI] | None = None
