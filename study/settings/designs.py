"""What the settings of a study mean for its sessions."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from protocols.flow import Flow
from protocols.tasks import make_task
from study.session.chain import digest
from study.session.opening import Stale
from study.session.plan import Design
from study.settings.wording import read_study_texts

if TYPE_CHECKING:
    from pathlib import Path

    from study.settings.tables import Settings


def make_design(settings: Settings) -> Design:
    """Read off what a study decides about the sessions of all its participants.

    Parameters
    ----------
    settings : Settings
        The study's settings.

    Returns
    -------
    Design
        The design.

    Raises
    ------
    ValueError
        If a task is asked for what its protocol does not have.
    """
    session, rehearsal = settings.session, settings.session.rehearsal
    breaks, quality = session.breaks, session.quality
    own = {name: settings.tasks[name].model_dump() if name in settings.tasks else {} for name in session.protocols}
    return Design(
        seed=settings.study.seed,
        order=session.order,
        repeats=session.repeats,
        tasks=tuple(
            make_task(name, training=rehearsal.training, practice=rehearsal.practice, **own[name])
            for name in session.protocols
        ),
        between=dict(settings.between),
        flow=Flow(
            break_trials=breaks.every_trials,
            break_min=breaks.every_min,
            break_s=breaks.break_s,
            rest_s=breaks.rest_s,
            training_pass=rehearsal.pass_share,
            training_rounds=rehearsal.rounds,
            min_response_s=quality.min_response_s,
            max_attempts=quality.max_attempts,
            reject=quality.reject,
            gap_s=quality.gap_s,
        ),
    )


def make_identity(settings: Settings, folder: Path, presenter: dict[str, Any]) -> dict[str, Any]:
    """Say what must not change within a session besides its plan, for the header of its journal.

    Parameters
    ----------
    settings : Settings
        The study's settings.
    folder : Path
        The study's folder.
    presenter : dict
        The kind of presenter and its own settings; `simulated` among them.

    Returns
    -------
    dict
        Language, digest of all texts, the consent in full, rig, calibration and presenter. No rig is calibrated yet,
        and the header says so.
    """
    texts = read_study_texts(settings, folder)
    return {
        "locale": settings.session.language,
        "texts_sha256": digest(json.dumps(texts, sort_keys=True)),
        "consent": texts["pages"]["consent"]["text"],
        "rig": settings.rig.model_dump(),
        "calibration": None,
        "presenter": presenter,
    }


def make_stale(settings: Settings) -> Stale:
    """Read off what becomes of a session that was left for long.

    Parameters
    ----------
    settings : Settings
        The study's settings.

    Returns
    -------
    Stale
        The policy.
    """
    return Stale(**settings.session.stale.model_dump())
