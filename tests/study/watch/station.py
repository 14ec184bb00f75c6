"""Runs a simulated session slowly, with an underrun in its first part: station.py STUDY ID SEED SLEEP_S."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.folder import StudyFolder
from feel321.study.observer import Casting, SimulatedObserver, make_model
from feel321.study.session.journal import utc_now
from feel321.study.session.ports import Playback
from feel321.study.sessions import lead_session, open_room, plan_sessions
from feel321.study.settings.read import make_identity, read_settings


class SlowObserver(SimulatedObserver):
    """Takes real time over every part."""

    sleep_s, underruns = 0.0, 1

    def play(self, *given: Any, **options: Any) -> Playback:
        time.sleep(self.sleep_s)
        underruns, self.underruns = self.underruns, 0
        return replace(super().play(*given, **options), underruns=underruns)


def main(path: Path, participant: str, seed: int, sleep_s: float) -> None:
    study = StudyFolder(path)
    settings, stimuli = read_settings(study.settings), read_stimuli(study.stimuli)
    room = open_room(study, settings, stimuli, now=utc_now)
    plan = plan_sessions(room, [participant], simulated=True)[0]
    casting = Casting(make_model(settings), seed)

    @contextmanager
    def seat(_plan: Any, _journal: Any) -> Iterator[SlowObserver]:
        observer = SlowObserver(casting.model, seed=seed, number=1)
        observer.sleep_s = sleep_s
        yield observer

    identity = make_identity(settings, path, casting.identity)
    lead_session(room, plan, identity=identity, make_presenter=seat)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), float(sys.argv[4]))
