"""What participants read: one TOML file per language in `catalog/`."""

from __future__ import annotations

import tomllib
from importlib.resources import files

from protocols.trial import Scale

CATALOG = files("protocols") / "catalog"


def list_languages() -> tuple[str, ...]:
    """Name the languages that the catalogue holds.

    Returns
    -------
    tuple of str
        Language codes, sorted.

    Examples
    --------
    >>> list_languages()
    ('en',)
    """
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in CATALOG.iterdir()))


def read_scales(language: str = "en") -> dict[str, Scale]:
    """Read the texts of all scales.

    Parameters
    ----------
    language : str
        Language code of the catalogue.

    Returns
    -------
    dict of str to Scale
        The scales by name.

    Raises
    ------
    ValueError
        If the catalogue has no such language.

    Examples
    --------
    >>> read_scales()["similarity"].high_label
    'Identical'
    """
    if language not in list_languages():
        raise ValueError(f"language: got {language!r}, allowed: {', '.join(list_languages())}")
    texts = tomllib.loads((CATALOG / f"{language}.toml").read_text(encoding="utf-8"))
    return {name: Scale(name=name, **entry) for name, entry in texts["scales"].items()}
