"""A PulseAudio server of one's own on a machine without a sound card, and ALSA names that lead there."""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

RATE_HZ = 48000

# ALSA's order. A sound server mixes a stream onto a sink with other channels, so rig and sink have the same here.
CHANNEL_MAP = ("front-left", "front-right", "rear-left", "rear-right", "front-center", "lfe")

PATIENCE_S = 120.0
"""How long anything is waited for: nothing takes so long, only a machine under load."""

# No sink or source is named: the server has one of each, the null sink and its monitor.
ALSA_NAMES = """
</usr/share/alsa/alsa.conf>
pcm.stylus {{ type pulse server "unix:{socket}" }}
pcm."stylus twin" {{ type pulse server "unix:{socket}" }}
"""


@dataclass
class Pulse:
    """A PulseAudio server with a null sink of so many channels, `stylus`."""

    folder: Path
    channels: int
    server: subprocess.Popen[bytes] | None = None
    was_halted: bool = False

    @property
    def socket(self) -> Path:
        return self.folder / "native"

    @property
    def own_env(self) -> dict[str, str]:
        """What a process needs to hear and play here, and only here."""
        return {
            "ALSA_CONFIG_PATH": str(self.folder / "asound.conf"),
            "PULSE_SERVER": f"unix:{self.socket}",
            "XDG_RUNTIME_DIR": str(self.folder),
            "PULSE_COOKIE": str(self.folder / "cookie"),
        }

    @property
    def env(self) -> dict[str, str]:
        return {**os.environ, **self.own_env}

    def name_devices(self) -> None:
        """Tell ALSA of the server, under two names."""
        names = ALSA_NAMES.format(socket=self.socket)
        (self.folder / "asound.conf").write_text(names, encoding="utf-8")

    def start(self) -> None:
        self.name_devices()
        self.was_halted = False
        self.socket.unlink(missing_ok=True)
        command = [
            "pulseaudio", "-n", "--daemonize=no", "--use-pid-file=no", "--exit-idle-time=-1", "--disable-shm=yes",
            "--realtime=no", "--high-priority=no", "--log-target=stderr",
            f"--load=module-native-protocol-unix socket={self.socket} auth-anonymous=1",
            f"--load=module-null-sink sink_name=stylus rate={RATE_HZ} channels={self.channels} format=float32le "
            f"channel_map={','.join(CHANNEL_MAP[: self.channels])}",
        ]  # fmt: skip
        with (self.folder / "server.log").open("wb") as log:
            self.server = subprocess.Popen(
                command, env={**self.env, "HOME": str(self.folder)}, stderr=log
            )
        until(
            self._answers, f"pulseaudio does not answer: {(self.folder / 'server.log').read_text()}"
        )

    def _answers(self) -> bool:
        return (
            self.socket.exists()
            and not subprocess.run(
                ["pactl", "info"], env=self.env, capture_output=True, check=False
            ).returncode
        )

    def kill(self) -> None:
        """End the server as a crash would."""
        if self.server is not None:
            with suppress(ProcessLookupError):
                self.server.send_signal(signal.SIGCONT)
            self.server.kill()
            self.server.wait()
            self.server = None

    @contextmanager
    def halted(self) -> Iterator[None]:
        """Stop the server's process for a while, as a busy machine would."""
        assert self.server is not None
        self.was_halted = True
        self.server.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self.server.send_signal(signal.SIGCONT)

    @contextmanager
    def captured(self) -> "Iterator[Capture]":
        """Record what the sink plays; the samples are there when the context is left."""
        raw = self.folder / f"capture-{time.monotonic_ns()}.raw"
        command = [
            "parec", "--raw", "--device=stylus.monitor", "--format=float32le", f"--rate={RATE_HZ}",
            f"--channels={self.channels}", "--no-remap", "--no-remix", "--latency-msec=20",
        ]  # fmt: skip
        capture = Capture()
        with raw.open("wb") as file:
            recorder = subprocess.Popen(
                command, env=self.env, stdout=file, stderr=subprocess.DEVNULL
            )
            try:
                until(lambda: raw.stat().st_size > 0, "parec records nothing")
                began_s = time.monotonic()
                yield capture
                # What was played last is on its way, be the recorder ever so late.
                wanted = round((time.monotonic() - began_s + 0.5) * RATE_HZ) * 4 * self.channels
                until(lambda: raw.stat().st_size >= wanted, "parec records no more")
            finally:
                recorder.terminate()
                recorder.wait()
        whole = raw.stat().st_size // (4 * self.channels) * self.channels
        capture.samples = np.fromfile(raw, dtype="<f4", count=whole).reshape(-1, self.channels)
        raw.unlink()


@dataclass
class Capture:
    """What was recorded, shape (n, channels)."""

    samples: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), dtype=np.float32))

    def find(self, sound: NDArray[np.float32], *, after: int = 0) -> int:
        """Find a sound, every sample of it as it is, from a frame on; -1 if it is not there."""
        channel = int(np.argmax(np.abs(sound).max(axis=0)))
        anchor = int(np.argmax(np.abs(sound[:, channel])))
        places = (
            np.flatnonzero(self.samples[after:, channel] == sound[anchor, channel]) + after - anchor
        )
        for place in places[places >= 0]:
            if np.array_equal(self.samples[place : place + len(sound)], sound):
                return int(place)
        return -1


def until(condition: Callable[[], bool], complaint: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > deadline:
            pytest.fail(complaint)
        time.sleep(0.01)
