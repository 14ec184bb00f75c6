"""Plays on a rig by orders from stdin, in a process whose ALSA leads to a test's own server.

Orders are JSON, one a line; every order but `start` and `stop` is answered by one line of JSON.
"""

import json
import sys
from dataclasses import asdict
from pathlib import Path
from time import perf_counter, sleep
from typing import Any

import numpy as np

from feel321.study.actuator.output import Output, open_output
from feel321.study.actuator.rig import read_rig
from feel321.study.session.ports import Playback


def main(folder: Path, *, rate_hz: float) -> None:
    with np.load(folder / "sounds.npz") as stored:
        sounds = dict(stored)
    rig = read_rig(folder / "rig.toml")
    try:
        with open_output(
            rig, sounds, rate_hz=rate_hz, folder=folder / "delivered", clock=perf_counter
        ) as output:
            say({"identity": dict(output.identity)})
            for line in sys.stdin:
                obey(output, **json.loads(line))
    except OSError as error:
        say({"refused": str(error)})


def obey(
    output: Output, *, do: str, sound: str = "", gap_s: float = 0.0, after_s: float = 0.0
) -> None:
    if do == "start":
        output.start(sound, gap_s=gap_s)
    elif do == "stop":
        output.stop()
    elif do == "play":  # and stop it after a while, if that is asked
        output.start(sound, gap_s=gap_s)
        if after_s:
            sleep(after_s)
            before_s = perf_counter()
            output.stop()
            say({"stopped_s": (before_s, perf_counter())})
        say(collect(output))
    elif do == "collect":
        say(collect(output))
    elif do == "clock":
        say({"clock_s": perf_counter()})


def collect(output: Output) -> dict[str, Any]:
    while output.is_playing:
        sleep(0.002)
    over_s = perf_counter()
    delivery: Playback = output.collect()
    return {**asdict(delivery), "over_s": over_s}


def say(what: object) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]), rate_hz=float(sys.argv[2]))
