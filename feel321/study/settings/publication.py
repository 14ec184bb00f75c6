"""Table of `study.toml` about who made the study and under which terms its data may be used."""

import re
from typing import Annotated

from pydantic import AfterValidator, Field

from feel321.study.settings import fields as kinds

LICENCES = (
    "CC0-1.0", "CC-BY-4.0", "CC-BY-SA-4.0", "CC-BY-NC-4.0", "CC-BY-NC-SA-4.0", "CC-BY-ND-4.0", "CC-BY-NC-ND-4.0",
    "PDDL-1.0", "ODC-By-1.0", "ODbL-1.0", "CDLA-Permissive-2.0", "CDLA-Sharing-1.0",
)  # fmt: skip
"""SPDX names of the licences that data are published under."""

_ORCID = re.compile(r"(?:https://orcid\.org/)?(\d{4}-\d{4}-\d{4}-\d{3}[\dX])")
_DOI = re.compile(r"10\.\d{4,9}/\S+")
_DAY = re.compile(r"\d{4}-(?:0[1-9]|1[0-2])-(?:0[1-9]|[12]\d|3[01])")


def check_orcid(text: str) -> str:
    """Demand an ORCID iD whose last character is its check digit (ISO 7064, MOD 11-2).

    Examples
    --------
    >>> check_orcid("https://orcid.org/0000-0002-1825-0097")
    '0000-0002-1825-0097'
    """
    if (found := _ORCID.fullmatch(text)) is None:
        raise ValueError("must be an ORCID iD such as '0000-0002-1825-0097'")
    total = 0
    for digit in found[1][:-1].replace("-", ""):
        total = (total + int(digit)) * 2
    check = (12 - total % 11) % 11
    if found[1][-1] != ("X" if check == 10 else str(check)):  # noqa: PLR2004 - X stands for ten
        raise ValueError("must end with its check digit; a digit is wrong, copy it again")
    return found[1]


def _check_doi(text: str) -> str:
    bare = text.removeprefix("https://doi.org/").removeprefix("doi:")
    if not _DOI.fullmatch(bare):
        raise ValueError("must be a DOI such as '10.5281/zenodo.123456'")
    return bare


def _check_day(text: str) -> str:
    if not _DAY.fullmatch(text):
        raise ValueError("must be a day such as '2026-11-23'")
    return text


class AuthorTable(kinds.TomlTable):
    """`[[publication.authors]]`: somebody who made the study."""

    given: kinds.Words
    family: kinds.Words
    orcid: Annotated[str, AfterValidator(check_orcid)] | None = None
    affiliation: kinds.Words | None = None

    @property
    def name(self) -> str:
        """The whole name."""
        return f"{self.given} {self.family}"


class PublicationTable(kinds.TomlTable):
    """`[publication]`: what an export says of the study besides its data."""

    title: kinds.Words | None = None
    description: kinds.Words | None = None
    version: kinds.Words = "1.0.0"
    released: Annotated[str, AfterValidator(_check_day)] | None = None
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
    doi: Annotated[str, AfterValidator(_check_doi)] | None = Field(default=None)

    def list_missing(self) -> list[str]:
        """List what a reader of the data needs and the table lacks, a line each."""
        needs = {
            "title": "what the dataset is called; the study's name is used",
            "description": "what the study was about, in a sentence or two",
            "authors": "who made it; nobody is named",
            "licence": f"how it may be used, one of {', '.join(LICENCES[:4])}, ...; without one nobody may",
            "ethics": "who approved it, and under which number",
            "institution": "where it was made",
            "funding": 'who paid for it; funding = ["none"] if nobody did',
            "released": "day of publication, such as '2026-11-23'",
        }
        return [
            f"publication.{name}: missing: {why}"
            for name, why in needs.items()
            if not getattr(self, name)
        ]
