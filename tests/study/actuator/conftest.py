"""A real audio path on a machine without a sound card: PulseAudio of one's own, and ALSA names that lead there."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from threading import Timer
from typing import Any, TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.study.actuator.pulse import PATIENCE_S, RATE_HZ, Pulse

Measured = TypeVar("Measured")

PLAYER = Path(__file__).with_name("player.py")


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
