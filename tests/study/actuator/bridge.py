"""A simulated rig behind a real audio stack: what one null sink plays moves coils, and their sensor is another sink's.

A private PulseAudio has the sinks `stylus` and `sensor`; the coils of rig.toml stand between them, in a process of
their own (this file as a program). For programs under test, ALSA's devices `stylus` and `sensor` are the first one's
input and the second one's monitor.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from feel321.study.actuator.rig import read_rig
from feel321.study.actuator.simulated import Hardware

if TYPE_CHECKING:
    from collections.abc import Iterator

RATE_HZ = 48000
CHANNELS = 4
"""Of both sinks, of every stream: a sound server mixes a stream onto a sink with other channels."""

CHANNEL_MAP = "front-left,front-right,rear-left,rear-right"
"""ALSA's order."""
BLOCK_FRAMES = 960
HELD_MS = 400
"""What the second sink holds: for so long the bridge may be late."""

PATIENCE_S = 60.0

ALSA_NAMES = """
</usr/share/alsa/alsa.conf>
pcm.stylus {{ type pulse server "unix:{socket}" device "stylus" }}
pcm.sensor {{ type pulse server "unix:{socket}" device "sensor.monitor" }}
"""


def make_env(folder: Path) -> dict[str, str]:
    """What a process needs to play and hear on the private server, and only there."""
    return {
        **os.environ,
        "ALSA_CONFIG_PATH": str(folder / "asound.conf"),
        "PULSE_SERVER": f"unix:{folder / 'native'}",
        "XDG_RUNTIME_DIR": str(folder),
        "PULSE_COOKIE": str(folder / "cookie"),
    }


@contextmanager
def start_server(folder: Path) -> Iterator[dict[str, str]]:
    """Start the server with its sinks; gives the environment for those who play there."""
    socket, env = folder / "native", make_env(folder)
    (folder / "asound.conf").write_text(ALSA_NAMES.format(socket=socket), encoding="utf-8")
    command = [
        "pulseaudio", "-n", "--daemonize=no", "--use-pid-file=no", "--exit-idle-time=-1", "--disable-shm=yes",
        "--realtime=no", "--high-priority=no", "--log-target=stderr",
        f"--load=module-native-protocol-unix socket={socket} auth-anonymous=1",
        *(f"--load=module-null-sink sink_name={name} rate={RATE_HZ} channels={CHANNELS} format=float32le "
          f"channel_map={CHANNEL_MAP}" for name in ("stylus", "sensor")),
    ]  # fmt: skip
    with (folder / "server.log").open("wb") as log:
        server = subprocess.Popen(command, env={**env, "HOME": str(folder)}, stderr=log)
    try:
        wait_for(
            lambda: (
                not subprocess.run(
                    ["pactl", "info"], env=env, capture_output=True, check=False
                ).returncode
            )
        )
        yield env
    finally:
        server.kill()
        server.wait()


@contextmanager
def start_bridge(rig: Path, env: dict[str, str]) -> Iterator[None]:
    """Put the coils of a rig.toml between the sinks."""
    ready = rig.with_suffix(".ready")
    ready.unlink(missing_ok=True)
    process = subprocess.Popen([sys.executable, __file__, str(rig)], env=env)
    try:
        wait_for(ready.exists)
        yield
    finally:
        process.terminate()
        process.wait()


def wait_for(condition: object) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not condition():  # type: ignore[operator]  # a callable without arguments
        if time.monotonic() > end_s:
            raise TimeoutError("the private sound server does not answer")
        time.sleep(0.05)


def main(path: Path) -> None:
    """Carry samples from one sink to the other until this process is ended."""
    rig = read_rig(path)
    hardware = Hardware(rig, rate_hz=RATE_HZ)
    columns = [channel - 1 for channel in rig.sensor.inputs] if rig.sensor else []
    raw = ["--raw", "--format=float32le", f"--rate={RATE_HZ}", f"--channels={CHANNELS}",
           f"--channel-map={CHANNEL_MAP}"]  # fmt: skip
    quiet = {"stderr": subprocess.DEVNULL}
    source = subprocess.Popen(
        ["parec", *raw, "--device=stylus.monitor", "--latency-msec=40"], stdout=subprocess.PIPE, **quiet
    )  # fmt: skip
    sink = subprocess.Popen(
        ["pacat", *raw, "--device=sensor", f"--latency-msec={HELD_MS}"], stdin=subprocess.PIPE, **quiet
    )  # fmt: skip
    assert source.stdout is not None
    assert sink.stdin is not None
    try:
        for number in range(sys.maxsize):
            block = source.stdout.read(BLOCK_FRAMES * CHANNELS * 4)
            frames = np.frombuffer(block, dtype="<f4").reshape(-1, CHANNELS)
            sensed = np.zeros((len(frames), CHANNELS), dtype="<f4")
            sensed[:, columns] = hardware.sense(frames)
            sink.stdin.write(sensed.tobytes())
            sink.stdin.flush()
            if number == RATE_HZ // BLOCK_FRAMES // 2:
                path.with_suffix(".ready").touch()
    finally:
        for process in (source, sink):
            process.kill()
            process.wait()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
