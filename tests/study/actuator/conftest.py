"""A real audio path on a machine without a sound card: PulseAudio of one's own, and ALSA names that lead there."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Timer
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from numpy.typing import NDArray

Measured = TypeVar("Measured")

RATE_HZ = 48000

# ALSA's order. A sound server mixes a stream onto a sink with other channels, so rig and sink have the same here.
CHANNEL_MAP = ("front-left", "front-right", "rear-left", "rear-right", "front-center", "lfe")
PLAYER = Path(__file__).with_name("player.py")

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
    def env(self) -> dict[str, str]:
        """What a process needs to hear and play here, and only here."""
        own = {
            "ALSA_CONFIG_PATH": str(self.folder / "asound.conf"),
            "PULSE_SERVER": f"unix:{self.socket}",
            "XDG_RUNTIME_DIR": str(self.folder),
            "PULSE_COOKIE": str(self.folder / "cookie"),
        }
        return {**os.environ, **own}

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
    def captured(self) -> Iterator[Capture]:
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


@pytest.fixture
def insist() -> Callable[..., Any]:
    """Measure again as long as the machine had too much to do for the measurement, as what is measured says itself.

    No expectation hangs on this: what may never be is demanded at every measurement, and the last one has to be good.
    """

    def measure_until_calm(
        measure: Callable[[], Measured],
        *,
        is_disturbed: Callable[[Measured], bool],
        times: int = 12,
    ) -> Measured:
        found = measure()
        for _ in range(times - 1):
            if not is_disturbed(found):
                break
            found = measure()
        return found

    return measure_until_calm


@pytest.fixture(scope="session")
def pulses() -> Iterator[Callable[[int], Pulse]]:
    """Gives a server with so many channels, the one of former tests if they left it whole; all end by their own ids."""
    servers: dict[int, Pulse] = {}
    with ExitStack() as stack:

        def give(channels: int) -> Pulse:
            if channels not in servers:
                # A socket's path must be short, which a test's own folder is not.
                folder = stack.enter_context(
                    tempfile.TemporaryDirectory(prefix="feel321-", ignore_cleanup_errors=True)
                )
                servers[channels] = Pulse(Path(folder), channels)
                stack.callback(servers[channels].kill)
            pulse = servers[channels]
            if pulse.was_halted:
                pulse.kill()
            if pulse.server is None:
                pulse.start()
            pulse.name_devices()
            return pulse

        yield give


@pytest.fixture
def pulse(request: pytest.FixtureRequest, pulses: Callable[[int], Pulse]) -> Pulse:
    """A server with a null sink; `parametrize(..., indirect=True)` gives it other than four channels."""
    return pulses(getattr(request, "param", 4))


class Player:
    """A process that plays on a rig; it does what it is told, one line at a time."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process

    def tell(self, **order: Any) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(order) + "\n")
        self.process.stdin.flush()

    def hear(self) -> Any:
        assert self.process.stdout is not None
        guard = Timer(PATIENCE_S, self.process.kill)
        guard.start()
        line = self.process.stdout.readline()
        guard.cancel()
        assert line, f"the player ended: {self.process.wait()}"
        return json.loads(line)

    def ask(self, **order: Any) -> Any:
        self.tell(**order)
        return self.hear()

    def leave(self) -> None:
        end(self.process)


@pytest.fixture
def open_player(tmp_path: Path) -> Iterator[Callable[..., Player]]:
    """Start players: rig.toml's text and the sounds by name; what the player says first is in `opened`."""
    with ExitStack() as stack:

        def start(
            pulse: Pulse,
            rig: str,
            sounds: Mapping[str, NDArray[np.float32]],
            *,
            rate_hz: float = RATE_HZ,
        ) -> Player:
            (tmp_path / "rig.toml").write_text(rig, encoding="utf-8")
            np.savez(tmp_path / "sounds.npz", **sounds)
            command = [sys.executable, str(PLAYER), str(tmp_path), str(rate_hz)]
            process = subprocess.Popen(
                command,
                env=pulse.env,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                encoding="utf-8",
            )
            stack.callback(end, process)
            return Player(process)

        yield start


def end(process: subprocess.Popen[str]) -> None:
    """Let a player leave by itself, so that what it covered is counted; kill it if it does not."""
    assert process.stdin is not None
    assert process.stdout is not None
    with suppress(BrokenPipeError):
        process.stdin.close()
    try:
        process.wait(PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    process.stdout.close()


@pytest.fixture
def make_rig() -> Callable[..., str]:
    """Write a rig: two coils on channels 1 and 2, one that nothing plays on the last, and whatever other tables."""

    def make(
        *tables: str, channels: int = 2, device: str = "stylus", latency_s: float = 0.05
    ) -> str:
        spare = f'[[actuators]]\nname = "spare"\nchannel = {channels}\nplays = ["z"]'
        return "\n".join((
            f'[device]\nname = "{device}"\nlatency_s = {latency_s}',
            '[[actuators]]\nname = "left"\nchannel = 1\n[[actuators]]\nname = "right"\nchannel = 2',
            "[limits]\npeak_m_s2 = 100.0\nrms_m_s2 = 50.0\nduration_s = 60.0",
            spare if channels > 2 else "",
            *tables,
        ))

    return make


@pytest.fixture
def make_sound() -> Callable[..., NDArray[np.float32]]:
    """Make noise that is silent nowhere, and different on the first two channels; the others are silent."""

    def make(seed: int, *, n: int = 4800, channels: int = 2) -> NDArray[np.float32]:
        noise = (
            np.random.default_rng(seed).uniform(0.05, 0.4, size=(n, channels)).astype(np.float32)
        )
        noise[1::2] *= -1
        noise[:, 2:] = 0
        return noise

    return make
