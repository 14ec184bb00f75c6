"""Who made a dataset and how it may be used: `dataset_description.json`, `CITATION.cff`, README, LICENSE."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from feel321 import __version__

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from feel321.study.settings.publication import AuthorTable, PublicationTable
    from feel321.study.settings.schema import Settings

BIDS_VERSION = "1.11.0"
SOFTWARE = {"Name": "feel321", "Version": __version__, "Description": "feel321 export --bids"}


def find_title(settings: Settings) -> str:
    """Find what the dataset is called."""
    return settings.publication.title or settings.study.name


def describe_dataset(
    settings: Settings, variables: Sequence[dict[str, Any]], *, seal: str
) -> dict[str, Any]:
    """Make `dataset_description.json`: what BIDS wants, and what Psych-DS wants in the words of schema.org."""
    own = settings.publication
    bids = {
        "Name": find_title(settings),
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "raw",
        "License": None if own.authors else own.licence,  # else CITATION.cff says it, once
        "Acknowledgements": own.acknowledgements,
        "Funding": own.funding,
        "EthicsApprovals": own.ethics,
        "Keywords": own.keywords,
        "ReferencesAndLinks": () if own.authors else own.references,
        "DatasetDOI": own.doi and f"doi:{own.doi}",
        "GeneratedBy": [SOFTWARE],
        "SourceDatasets": [{"Version": f"study sealed {seal}"}],
    }
    linked = {
        "@context": "https://schema.org/",
        "@type": "Dataset",
        "name": find_title(settings),
        "description": own.description
        or f"Data of the study {find_title(settings)}, exported by feel321.",
        "version": own.version,
        "creator": [describe_author(one) for one in own.authors],
        "license": own.licence and spdx(own.licence),
        "datePublished": own.released,
        "keywords": own.keywords,
        "identifier": own.doi and f"https://doi.org/{own.doi}",
        "variableMeasured": variables,
    }
    return {name: value for name, value in {**bids, **linked}.items() if value}


def describe_author(author: AuthorTable) -> dict[str, Any]:
    """Describe a person in the words of schema.org."""
    entry: dict[str, Any] = {
        "@type": "Person",
        "@id": author.orcid and f"https://orcid.org/{author.orcid}",
        "name": author.name,
        "givenName": author.given,
        "familyName": author.family,
        "affiliation": author.affiliation and {"@type": "Organization", "name": author.affiliation},
    }
    return {name: value for name, value in entry.items() if value}


def spdx(licence: str) -> str:
    """Give the address of a licence."""
    return f"https://spdx.org/licenses/{licence}.html"


def write_citation(settings: Settings) -> str:
    """Write `CITATION.cff` 1.2.0 of the dataset, or nothing where no author is known; JSON's strings are YAML's."""
    own = settings.publication
    if not own.authors:
        return ""
    facts: dict[str, Any] = {
        "cff-version": "1.2.0",
        "message": own.acknowledgements or "If you use this dataset, please cite it as below.",
        "type": "dataset",
        "title": find_title(settings),
        "abstract": own.description,
        "version": own.version,
        "date-released": own.released,
        "license": own.licence,
        "doi": own.doi,
        "keywords": own.keywords,
    }
    lines = [
        f"{name}: {json.dumps(value, ensure_ascii=False)}" for name, value in facts.items() if value
    ]
    return "\n".join([*lines, "authors:", *map(_write_author, own.authors)]) + "\n"


def _write_author(author: AuthorTable) -> str:
    facts = {
        "family-names": author.family,
        "given-names": author.given,
        "orcid": author.orcid and f"https://orcid.org/{author.orcid}",
        "affiliation": author.affiliation,
    }
    known = [
        f"{name}: {json.dumps(value, ensure_ascii=False)}" for name, value in facts.items() if value
    ]
    return "  - " + "\n    ".join(known)


FIRST = "Written by feel321 export --bids."
"""Stands in every README."""


def write_readme(settings: Settings, *, people: int, simulated: int, missing: Sequence[str]) -> str:
    """Write the README: what the folder holds, how people were de-identified, and what is missing."""
    own = settings.publication
    ghosts = f" {simulated} of them are simulated: programs, not people." if simulated else ""
    unsaid = ["", "Missing from [publication] of the study:", *missing] if missing else []
    lines = [
        find_title(settings), "", FIRST, "",
        own.description or "No description was given.", "",
        f"{people} participants felt vibrations on a stylus and judged them.{ghosts}", "",
        "- sub-*/: judgements, one row each, by task (BIDS, modality beh); a sidecar describes every column",
        "- participants.tsv, phenotype/: participants, and answers to question pages where there are any",
        "- stimuli/: the vibrations as WAV files, and stimuli.tsv with their metrics",
        "- data/: the same tables as CSV files (Psych-DS)",
        "- derivatives/feel321/: methods.md, the analysis as it was declared, and the report if it was exported",
        "- ro-crate-metadata.json, CITATION.cff: authors, licence, software, apparatus (RO-Crate)", "",
        "Read it with feel321.analysis.read_bids(folder), or analyse it with: feel321 analyze --bids folder", "",
        "De-identification: participants are numbered in random order; times are relative to the start of a session;",
        "ages are in bands; personal answers, texts that participants typed, experimenters' notes, dates, names of",
        "machines and people, and all data of those who withdrew are left out.",
        *unsaid,
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def write_derived_readme(title: str) -> str:
    """Write the README of what feel321 made of the data."""
    return f"""{title}: analysis by feel321

code/analysis.json holds what an analysis needs besides the tables: seed, metrics, draws, and what was computed from the
recordings. docs/methods.md describes the study for a paper. docs/report/ is there if it was exported too; its
results.json has every number of the report.
"""


def write_changes(own: PublicationTable) -> str:
    """Write CHANGES, as CPAN does; the day stands in it where it is given."""
    return f"{own.version} {own.released or ''}".strip() + "\n  - Exported by feel321\n"


def write_licence(own: PublicationTable, holders: str) -> str:
    """Name the licence and where its text is."""
    by = f"Copyright: {holders}\n" if holders else ""
    return f"{by}This dataset is licensed under {own.licence}. Text: {spdx(own.licence or '')}\n"


def describe_task(
    scale: Mapping[str, Any], page: Mapping[str, str], *, name: str, own: PublicationTable
) -> dict[str, Any]:
    """Describe a task for its sidecar."""
    ends = f" from 0 ({scale.get('low_label', '')}) to 100 ({scale.get('high_label', '')})"
    facts = {
        "TaskName": name,
        "TaskDescription": f"{scale.get('question', name)} The answer is given in points{ends}.",
        "Instructions": " ".join(page.get("text", "").split()),
        "InstitutionName": own.institution,
        "InstitutionalDepartmentName": own.department,
        "InstitutionAddress": own.address,
        "StimulusPresentation": {"SoftwareName": "feel321", "SoftwareVersion": __version__},
    }
    return {name: value for name, value in facts.items() if value}
