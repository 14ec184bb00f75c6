"""The RO-Crate of a dataset: who made it, with which programs and apparatus, and what was done (RO-Crate 1.1)."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any

from feel321.study.export import credit

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from feel321.study.actuator.certificate import Certificate
    from feel321.study.export.writing import Content
    from feel321.study.settings.schema import Settings

CONTEXT = "https://w3id.org/ro/crate/1.1/context"
FORMATS = {
    ".tsv": "text/tab-separated-values", ".csv": "text/csv", ".json": "application/json", ".md": "text/markdown",
    ".wav": "audio/wav", ".html": "text/html", ".svg": "image/svg+xml", ".png": "image/png", ".cff": "text/yaml",
}  # fmt: skip

Entity = dict[str, Any]


def make_crate(
    settings: Settings, files: Mapping[str, Content], *, seal: str, versions: Mapping[str, str],
    certificates: Iterable[Certificate],
) -> Entity:  # fmt: skip
    """Make `ro-crate-metadata.json` of a folder with these files."""
    listed = [describe_file(name, content) for name, content in sorted(files.items())]
    programs = [
        {
            "@id": f"#{name}",
            "@type": "SoftwareApplication",
            "name": name,
            "softwareVersion": version,
        }
        for name, version in versions.items()
    ]
    rigs = [describe_certificate(one, number) for number, one in enumerate(certificates, start=1)]
    actions = list(describe_actions(files, rigs=rigs))
    people = [
        {"@id": f"#author{number}", **credit.describe_author(author)}
        for number, author in enumerate(settings.publication.authors, start=1)
    ]
    about = {
        "@id": "ro-crate-metadata.json",
        "@type": "CreativeWork",
        "conformsTo": {"@id": "https://w3id.org/ro/crate/1.1"},
        "about": {"@id": "./"},
    }
    sealed = {"@id": "#seal", "@type": "PropertyValue", "name": "seal of the study", "value": seal}
    root = describe_root(settings, hasPart=listed, creator=people, mentions=actions)
    root["identifier"] = [*([root["identifier"]] if "identifier" in root else []), _point(sealed)]
    entities = [about, root, sealed, *people, *programs, *rigs, *actions, *listed]
    return {"@context": CONTEXT, "@graph": [flat for one in entities for flat in flatten(one)]}


def flatten(entity: Entity) -> Iterator[Entity]:
    """List an entity and those within it, which stand beside it in a crate and are pointed to."""
    own: Entity = {}
    for name, value in entity.items():
        several = value if isinstance(value, list) else [value]
        inner = [one for one in several if isinstance(one, dict) and "@type" in one]
        for number, one in enumerate(inner, start=1):
            one.setdefault("@id", f"#{entity['@id'].lstrip('#')}-{name}{number}")
            yield from flatten(one)
        pointed = [_point(one) if one in inner else one for one in several]
        own[name] = pointed if isinstance(value, list) else pointed[0]
    yield own


def _point(entity: Entity) -> Entity:
    return {"@id": entity["@id"]}


def describe_root(settings: Settings, **parts: list[Entity]) -> Entity:
    """Describe the dataset itself; parts: property -> entities that it points to."""
    own = settings.publication
    facts: Entity = {
        "@id": "./",
        "@type": "Dataset",
        "name": credit.find_title(settings),
        "description": own.description or f"Data of the study {credit.find_title(settings)}",
        "version": own.version,
        "datePublished": own.released,
        "license": own.licence and {"@id": credit.spdx(own.licence)},
        "keywords": ", ".join(own.keywords),
        "funding": ", ".join(own.funding),
        "identifier": own.doi and f"https://doi.org/{own.doi}",
    }
    facts |= {name: [_point(entity) for entity in entities] for name, entities in parts.items()}
    return {name: value for name, value in facts.items() if value}


def describe_file(name: str, content: Content) -> Entity:
    """Describe a file of the dataset, with its digest."""
    body = content if isinstance(content, bytes) else content.read_bytes()
    entry = {
        "@id": name,
        "@type": "File",
        "contentSize": str(len(body)),
        "sha256": hashlib.sha256(body).hexdigest(),
    }
    known = FORMATS.get("." + name.rpartition(".")[2])
    return entry | ({"encodingFormat": known} if known else {})


def describe_certificate(certificate: Certificate, number: int) -> Entity:
    """Describe the rig by its certificate: what was corrected, and what is left; without days and names of devices."""
    facts = [
        ("method", certificate.method, None),
        ("rate", certificate.rate_hz, "Hz"),
        ("band from", certificate.band_hz[0], "Hz"),
        ("band to", certificate.band_hz[1], "Hz"),
    ]
    for place, coil in enumerate(certificate.coils.values(), start=1):
        facts += [
            (f"actuator {place}, full scale", coil.target, "m/s^2"),
            (f"actuator {place}, largest deviation", coil.largest_db, "dB"),
            (f"actuator {place}, uncertainty", coil.uncertainty_db, "dB"),
        ]
    values = [
        {
            "@type": "PropertyValue",
            "name": name,
            "value": value,
            **({"unitText": unit} if unit else {}),
        }
        for name, value, unit in facts
        if value == value  # noqa: PLR0124 - a NaN is not known
    ]
    return {
        "@id": f"#rig{number}",
        "@type": "IndividualProduct",
        "name": f"vibration rig {number}",
        "description": "Actuators with the calibration that was valid for them",
        "additionalProperty": values,
    }


def describe_actions(files: Mapping[str, Content], *, rigs: list[Entity]) -> Iterable[Entity]:
    """Describe what was done: stimuli were built, sessions held, ratings analysed."""
    steps = {
        "build": ("Stimuli were built", (), ("stimuli/",)),
        "sessions": ("Participants judged the stimuli", ("stimuli/",), ("sub-",)),
        "analyze": (
            "Judgements were related to the metrics",
            ("sub-", "stimuli/stimuli.tsv"),
            ("derivatives/",),
        ),
    }
    for name, (said, given, made) in steps.items():
        ends = [
            [{"@id": file} for file in sorted(files) if file.startswith(start)]
            for start in (given, made)
        ]
        ends = [own if start else [] for own, start in zip(ends, (given, made), strict=True)]
        tools = [
            {"@id": "#feel321"},
            *([_point(rig) for rig in rigs] if name == "sessions" else []),
        ]
        entry = {"@id": f"#{name}", "@type": "CreateAction", "name": said, "instrument": tools}
        yield entry | {key: own for key, own in zip(("object", "result"), ends, strict=True) if own}
