"""A lab on a machine without one: a private X server, a private PulseAudio, and short studies."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from feel321.study.check import build_study
from feel321.study.folder import StudyFolder
from feel321.study.session.journal import read_journal
from tests.study.actuator.pulse import Pulse

FEEL321 = Path(sys.executable).with_name("feel321")
PATIENCE_S = 600.0
"""How long anything is waited for: no test takes so long, only a machine under load."""

STUDY = """
[study]
seed = 5
[[recordings]]
scene = "bumps"
duration_s = 0.15
[[recordings]]
scene = "hard_taps"
duration_s = 0.15
[stimuli]
reducers = {reducers}
reference = "{reference}"
anchors = {anchors}
[session]
protocols = {protocols}
[session.rehearsal]
training = {training}
practice = 0
[session.breaks]
every_trials = 3
break_s = 0.2
rest_s = 0.2
[session.quality]
gap_s = 0.05
[session.stale]
policy = "continue"
{threshold}
[observer]
noise_sd = 20.0
[analysis]
draws = 100
"""

RIG = """
[device]
name = "{device}"
[[actuators]]
name = "left coil"
channel = 1
plays = ["reduced"]
[[actuators]]
name = "right coil"
channel = 2
plays = ["reduced"]
[limits]
peak_m_s2 = 100.0
rms_m_s2 = 60.0
duration_s = 30.0
"""

AXES = {"left": ["reduced", "x", "z"], "right": ["reduced", "y"]}
"""What either coil plays where three axes are to be felt on two channels."""


@dataclass
class Process:
    """A `feel321 run` under way."""

    process: subprocess.Popen[str]
    study: StudyFolder
    participant: str
    env: dict[str, str]
    patience_s: float = PATIENCE_S

    @property
    def records(self) -> list[Any]:
        paths = sorted((self.study.sessions / self.participant).glob("session-*.jsonl"))
        return list(read_journal(paths[-1]).records) if paths else []

    def count(self, event: str) -> int:
        return sum(record.event == event for record in self.records)

    def count_done(self) -> int:
        """Count the trials that stand; a busy machine may have spoiled others."""
        return sum(
            record.event == "rated" and not record.data["rejected"] for record in self.records
        )

    def wait_for(self, event: str, number: int = 1) -> None:
        """Wait until something has happened so often."""
        end_s = time.monotonic() + PATIENCE_S
        while self.count(event) < number:
            assert self.process.poll() is None, self.finish()
            assert time.monotonic() < end_s, [record.event for record in self.records]
            time.sleep(0.02)

    def send(self, number: signal.Signals) -> None:
        self.process.send_signal(number)

    def finish(self) -> tuple[int, str, str]:
        """Wait for its end: exit code, what it printed, and what it complained about."""
        out, err = self.process.communicate(timeout=PATIENCE_S)
        # ALSA and PortAudio speak of underruns and of dead servers on their own account; the journal has them too.
        foreign = ("ALSA lib", "Expression '")
        own = [line for line in err.splitlines(keepends=True) if not line.startswith(foreign)]
        return self.process.returncode, out, "".join(own)

    def find_window(self) -> str:
        """Find the number of the window, once it is there."""
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            found = subprocess.run(
                ["xdotool", "search", "--onlyvisible", "--name", "."],
                env=self.env,
                capture_output=True,
                text=True,
                check=False,
            ).stdout.split()
            if found:
                return found[-1]
            time.sleep(0.1)
        pytest.fail("no window came up")

    def click(self, x: float, y: float) -> None:
        """Click by xdotool, for longer than a frame."""
        for words in (
            ["mousemove", str(round(x)), str(round(y))],
            ["mousedown", "1"],
            ["mouseup", "1"],
        ):
            subprocess.run(["xdotool", *words], env=self.env, check=True)
            time.sleep(0.05)

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """Stop the process for a while: all that is pressed meanwhile comes to it at once."""
        self.send(signal.SIGSTOP)
        yield
        self.send(signal.SIGCONT)

    def press(self, *keys: str) -> None:
        """Press keys by xdotool, each for longer than a frame."""
        for key in keys:
            subprocess.run(["xdotool", "keydown", key], env=self.env, check=True)
            time.sleep(0.05)
            subprocess.run(["xdotool", "keyup", key], env=self.env, check=True)
            time.sleep(0.05)


@dataclass
class Lab:
    """Starts sessions on a private screen."""

    env: dict[str, str]
    started: list[subprocess.Popen[str]] = field(default_factory=list)

    def start(self, study: StudyFolder, participant: str, *options: str) -> Process:
        command = [FEEL321, "run", study.path, "--participant", participant, *options]
        process = subprocess.Popen(
            command, env=self.env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.started.append(process)
        return Process(
            process, StudyFolder(study.path, "--rehearse" in options), participant, self.env
        )

    def run(self, study: StudyFolder, participant: str, *options: str) -> tuple[int, str, str]:
        return self.start(study, participant, *options).finish()

    def close(self) -> None:
        for process in self.started:
            if process.poll() is None:
                process.kill()
            process.communicate()


def start_screen() -> tuple[subprocess.Popen[bytes], str]:
    reading, writing = os.pipe()
    command = ["Xvfb", "-displayfd", str(writing), "-nolisten", "tcp", "-noreset"]
    command += ["-screen", "0", "1024x768x24"]
    server = subprocess.Popen(command, pass_fds=[writing], stderr=subprocess.DEVNULL)
    os.close(writing)
    with os.fdopen(reading) as numbers:
        return server, f":{numbers.readline().strip()}"


@pytest.fixture(scope="session")
def screen() -> Iterator[str]:
    """A private X server; gives its DISPLAY."""
    server, name = start_screen()
    yield name
    server.terminate()
    server.wait()


@pytest.fixture
def lab(screen: str) -> Iterator[Lab]:
    """The private screen, and nothing that plays."""
    lab = Lab({**os.environ, "DISPLAY": screen, "LIBGL_ALWAYS_SOFTWARE": "1"})
    yield lab
    lab.close()


@pytest.fixture(scope="session")
def sound() -> Iterator[Pulse]:
    # A socket's path must be short, which a test's own folder is not.
    with tempfile.TemporaryDirectory(prefix="feel321-", ignore_cleanup_errors=True) as folder:
        sound = Pulse(Path(folder), 2)
        sound.start()
        yield sound
        sound.kill()


@pytest.fixture
def rig(lab: Lab, sound: Pulse) -> Lab:
    """The private screen with actuators on the private PulseAudio, should a test have ended it or not."""
    if sound.server is None:
        sound.start()
    lab.env |= sound.own_env
    return lab


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., StudyFolder]:
    """Studies as they are before anybody came, each built once; to be copied, not touched."""
    made: dict[str, StudyFolder] = {}

    def build(**choices: Any) -> StudyFolder:
        text = STUDY.format(**choices)
        if text not in made:
            study = StudyFolder(tmp_path_factory.mktemp("built"))
            study.settings.write_text(text, encoding="utf-8")
            study.rig.write_text(RIG.format(device="file"), encoding="utf-8")
            build_study(study)
            made[text] = study
        return made[text]

    return build


@pytest.fixture
def make_study(built: Callable[..., StudyFolder], tmp_path: Path) -> Callable[..., StudyFolder]:
    """Makes short studies of given protocols, for a given device."""

    def make(
        *protocols: str,
        device: str = "file",
        training: int = 0,
        reducers: tuple[str, ...] = ("sax321",),
        anchors: bool = False,
        reference: str = "dft321",
        threshold: str = "",
    ) -> StudyFolder:
        own = {"training": training, "anchors": str(anchors).lower(), "reference": reference}
        own["threshold"] = threshold
        own["reducers"] = json.dumps(reducers)
        source = built(protocols=json.dumps(protocols), **own)
        study = StudyFolder(tmp_path / "-".join(protocols))
        shutil.copytree(source.path, study.path)
        rig = RIG.format(device=device)
        if reference == "original":
            for plays in AXES.values():
                own_lines = f"full_scale_m_s2 = 200.0\nplays = {json.dumps(plays)}"
                rig = rig.replace('plays = ["reduced"]', own_lines, 1)
            rig = rig.replace("m_s2 = 100.0", "m_s2 = 200.0").replace("m_s2 = 60.0", "m_s2 = 150.0")
        study.rig.write_text(rig, encoding="utf-8")
        return study

    return make
