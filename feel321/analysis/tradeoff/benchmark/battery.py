"""The benchmark's battery: fixed, versioned, the same on every machine.

Its bundled part runs anywhere: synthetic scenes with seeds that nothing in this package was tuned on, turned as if the
sensor had been mounted in other ways, and the scenes of the stress test with seeds of their own. Its second part is
public recordings of real vibrations, under licences that allow it; they are not bundled but read from a folder and
known by their digests.

Whatever changes a signal or how it is scored changes the battery: then `VERSION` must change, because cards of
different batteries cannot be compared. The digest shows that: it covers the parameters and a fingerprint of every
signal, rounded so coarsely that the last bits, which differ between processors, do not show.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.tradeoff.stress.battery import BATTERY, take_excerpt
from feel321.analysis.tradeoff.stress.measures import Takes, make_takes
from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.recording import Recording
from feel321.stimuli.rotation import random_rotations
from feel321.stimuli.synthesis import SCENES, make_scene
from feel321.types import Samples

if TYPE_CHECKING:
    from feel321.types import PathLike

VERSION = "1"
SEEDS = (7321, 8321)
"""Of the scenes; no test, default or example uses them."""

SCENE_S, SCENE_HZ, SEGMENT_S = 2.0, 10_000.0, 0.25
MOUNTINGS, TURN_SEED = 8, 9321
TAKES, STRESS_SEED = 12, 6321
NOISES = 4
QUIET = 0.01
"""Segments with less than this share of the strongest one's energy (20 dB) do not count."""

SHOWN = 3
"""Faults of a folder that a message names."""

PLACES = 5
"""Decimals of a fingerprint, relative to a signal's RMS."""


class PublicRecording(NamedTuple):
    """A real recording: its file, its SHA-256, where it comes from and under which licence."""

    file: str
    sha256: str
    source: str
    licence: str


_ST = ("STMicroelectronics/stdatalog_examples, commit 4ca4e1f", "BSD-3-Clause")
_IDE = ("MideTechnology/endaq-python and idelib, commits d57a8b6 and 5a80a00", "MIT")
PUBLIC = (
    PublicRecording("handheld_26k.csv", "2a86ab76ea9807b7f742ad6eabe5ba85d1387a75f03724ec30ae9ddc511574df", *_ST),
    PublicRecording("handheld_7k.csv", "a0fc75b260c28175b22f41b61417dbad90f2c1d64467be1edcbcf535ec41560f", *_ST),
    PublicRecording("knocks_26k.wav", "5e34694ef83f9f2c1dc20ade6c62ddcb57fc3bb891f1dba8f574bbca426c672a", *_ST),
    PublicRecording("handheld_1600.csv", "c973e0d44300cc2a0e35f16346063bdfdbbce0a6bf00d1f27fde31f0c1825c9c", *_ST),
    PublicRecording("handheld_8k.npz", "f6528cae740036e3399c762172e886c04fde17c043f5b0ffae6d8044283602e6", *_ST),
    PublicRecording("isotropic_noise_20k.wav", "a4bd94afafb48ef6b7b36ffd644ec89d1d1147a233b7b3488bbcfb9858599be5",
                    *_IDE),
    PublicRecording("impacts_20k.wav", "22ff7b39cd8e4f57e77ab0edf9ff487491ce4652f4d59d32a1795138ab0d621f", *_IDE),
    PublicRecording("shaker_y_5k.csv", "bdf677636b4ec89f5e7042eb423d25a5259f60700620ca5629d36a2d7d0a795b", *_IDE),
    PublicRecording("shaker_x_5k.npz", "8b003ddadf7aa31e71ec765f5824e50bd1fba6ad75ca539f948f4398ba6942ea", *_IDE),
    PublicRecording("decay_5k.csv", "a4ffabcad839bbd8316759b1b1cfb83f45e940926d4d0824e768ac256bfd0a44", *_IDE),
    PublicRecording("machine_4k.npz", "34de9e4345e9d09738a23256f05ad9743b6c0c8d82b6b1f6e1ed637b0f8b2d02", *_IDE),
)  # fmt: skip
"""The battery's second part: hand-held sensors, shakers and machines."""


@dataclass(frozen=True, slots=True, eq=False)
class Battery:
    """What every method meets.

    scenes: conditioned, at two seeds each; recordings: conditioned, empty without the folder; turns: mountings of the
    sensor, (MOUNTINGS, 3, 3); takes: of every scene of the stress test, by name.
    """

    scenes: tuple[Recording, ...]
    recordings: tuple[Recording, ...]
    turns: Samples
    takes: dict[str, Takes]

    def describe(self) -> dict[str, object]:
        """Describe it for a card; a card's `battery` says with what it may be compared."""
        own = digest(self.recordings) if self.recordings else None
        return {"version": VERSION, "sha256": bundled_digest(), "recordings_sha256": own}


def make_battery(folder: PathLike | None = None) -> Battery:
    """Make the battery; with a folder that holds the public recordings, its second part too."""
    scenes, turns, takes = _make_bundled()
    return Battery(scenes, _read_public(folder), turns, takes)


@cache
def _make_bundled() -> tuple[tuple[Recording, ...], Samples, dict[str, Takes]]:
    scenes = []
    for name in SCENES:
        for number, seed in enumerate(SEEDS, start=1):
            made = make_scene(name, rng=seed, rate_hz=SCENE_HZ, duration_s=SCENE_S)
            samples = condition(made, Conditioning()).acceleration
            scenes.append(Recording(samples, SCENE_HZ, f"{name}_{number}"))
    turns = random_rotations(MOUNTINGS, np.random.default_rng(TURN_SEED))
    takes = {name: make_takes(name, takes=TAKES, seed=STRESS_SEED) for name in BATTERY}
    for each in takes.values():
        each.samples.flags.writeable = (
            False  # a method that writes to its input must not change the battery
        )
    return tuple(scenes), turns, takes


def _read_public(folder: PathLike | None) -> tuple[Recording, ...]:
    """Read the public recordings of a folder: all of them, as published, or none."""
    if folder is None:
        return ()
    from feel321.stimuli.formats.read import read_recording

    place, faults, found = Path(folder), [], []
    for public in PUBLIC:
        path = place / public.file
        if not path.is_file():
            faults.append(f"{public.file} is missing")
        elif hashlib.sha256(path.read_bytes()).hexdigest() != public.sha256:
            faults.append(f"{public.file} is not the published file")
        else:
            excerpt = take_excerpt(
                condition(read_recording(path), Conditioning()), duration_s=SCENE_S
            )
            found.append(Recording(excerpt.acceleration, excerpt.rate_hz, path.stem))
    if faults:
        more = f" and {len(faults) - SHOWN} more" if len(faults) > SHOWN else ""
        named = "; ".join(faults[:SHOWN])
        raise ValueError(
            f"{place}: must hold the {len(PUBLIC)} public recordings of battery {VERSION}, but {named}{more}; "
            "docs/benchmark.md lists them; or leave the folder out"
        )
    return tuple(found)


@cache
def bundled_digest() -> str:
    """Compute the digest of parameters and bundled signals."""
    scenes, turns, takes = _make_bundled()
    parameters = [VERSION, SEEDS, SCENE_S, SCENE_HZ, SEGMENT_S, MOUNTINGS, TAKES, NOISES, QUIET]
    stressed = [
        Recording(np.concatenate([*made.samples, *made.noise], axis=-1), made.rate_hz, name)
        for name, made in takes.items()
    ]
    turned = Recording(np.concatenate([*turns], axis=-1), 1.0, "mountings")
    return digest([*scenes, *stressed, turned], parameters)


def digest(signals: Iterable[Recording], parameters: object = ()) -> str:
    """Compute a digest that does not depend on the last bits of samples."""
    entries = [[one.name, f"{one.rate_hz:.3f}", *_fingerprint(one.acceleration)] for one in signals]
    text = json.dumps([parameters, entries], separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _fingerprint(samples: Samples) -> list[str]:
    """Write length, RMS and, of every axis, its correlation with three fixed waves, rounded."""
    n, rms = samples.shape[-1], float(np.sqrt(np.mean(np.square(samples))))
    places = np.arange(n)
    waves = [np.cos(0.1 * step * places + step * np.square(places / n)) for step in (1, 3, 10)]
    found = np.ravel(samples @ np.transpose(waves)) / (max(rms, 1e-300) * np.sqrt(n))
    return [str(n), f"{rms:.6e}", *(f"{round(value, PLACES) + 0.0:.{PLACES}f}" for value in found)]
