"""The words of a study: a language of the catalogue or a file of the lab's own, and its own consent."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from protocols.texts import read_texts
from study.settings.session_tables import LANGUAGE_FILE

if TYPE_CHECKING:
    from pathlib import Path

    from study.settings.tables import Settings

CONSENT = "consent"
"""The page whose text a lab can set by itself."""


def find_language(settings: Settings, folder: Path) -> str | Path:
    """Tell where the texts of a study stand.

    Parameters
    ----------
    settings : Settings
        The study's settings.
    folder : Path
        The study's folder; a file of its own is named relative to it.

    Returns
    -------
    str or Path
        A language of the catalogue, or the file.
    """
    language = settings.session.language
    return folder / language if language.endswith(LANGUAGE_FILE) else language


def read_study_texts(settings: Settings, folder: Path) -> dict[str, Any]:
    """Read all texts of a study, the lab's own consent among them.

    Parameters
    ----------
    settings : Settings
        The study's settings.
    folder : Path
        The study's folder.

    Returns
    -------
    dict
        The tables of the catalogue's file.

    Raises
    ------
    ValueError
        If the texts are not complete.
    OSError
        If they cannot be read.
    """
    texts = read_texts(find_language(settings, folder))
    if own := settings.session.consent:
        texts["pages"][CONSENT]["text"] = own
    return texts
