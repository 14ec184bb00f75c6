"""What is allowed in `study.toml` and still worth knowing."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from study.settings.tables import Settings


def list_remarks(settings: Settings) -> list[str]:
    """List what a study lead may not have meant.

    Parameters
    ----------
    settings : Settings
        Settings that are allowed and go together.

    Returns
    -------
    list of str
        One line each; empty if there is nothing to say.
    """
    return [*_remark_on_tasks(settings), *_remark_on_session(settings)]


def _remark_on_tasks(settings: Settings) -> Iterator[str]:
    for name in settings.tasks:
        if name not in settings.session.protocols:
            yield f"tasks.{name}: changes nothing: {name} is not in session.protocols; add it there, or take this out"
    if "mushra" in settings.session.protocols and not settings.stimuli.anchors:
        yield (
            "stimuli.anchors: got false, but mushra is meant to have two anchors on each page (ITU-R BS.1534-3); "
            "set it to true"
        )


def _remark_on_session(settings: Settings) -> Iterator[str]:
    session = settings.session
    if session.stale.policy == "warm_up" and session.stale.after_h is not None and not session.rehearsal.practice:
        yield (
            "session.stale.policy: got 'warm_up', but session.rehearsal.practice is 0: there is nothing to warm up "
            "with; ask for practice, or set the policy to 'continue'"
        )
    if not session.breaks.rest_s:
        yield "session.breaks.rest_s: got 0, so fingertips never rest from vibration; 60 s are usual"
