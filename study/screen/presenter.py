"""A presenter with a screen, a keyboard, a mouse and an output for vibrations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from study.screen.views import Hand

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from protocols.flow import Page
    from protocols.trial import Part, Scale, Trial
    from stimuli.manifest import Stimulus
    from study.screen.window import Window
    from study.screen.wording import ScreenTexts
    from study.session.ports import Abort, Act, Confirm, Pause, Place, Playback
    from study.settings.sources import Surface


class ScreenPresenter:
    """Shows, plays, and passes on what the participant does; implements `study.session.ports.Presenter`."""

    def __init__(
        self,
        window: Window,
        output: object,
        texts: ScreenTexts,
        *,
        clock: Callable[[], float],
        surfaces: Mapping[str, Surface],
        hand: Hand | None = None,
    ) -> None:
        raise NotImplementedError

    def show_page(self, page: Page, place: Place) -> Confirm | Pause | Abort:
        """Show a page until it is confirmed."""
        raise NotImplementedError

    def show_trial(self, trial: Trial, scale: Scale, place: Place) -> None:
        """Bring up a trial."""
        raise NotImplementedError

    def play(self, part: Part, stimulus: Stimulus, *, gap_s: float) -> Playback:
        """Play a stimulus."""
        raise NotImplementedError

    def prompt(self, part: Part) -> Playback:
        """Ask for a stroke over the real surface."""
        raise NotImplementedError

    def wait(self) -> Act:
        """Wait for the next act."""
        raise NotImplementedError

    def refuse(self, reason: str, parts: tuple[str, ...]) -> None:
        """Say why an act was not accepted."""
        raise NotImplementedError
