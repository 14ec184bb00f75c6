"""Sessions on calibrated rigs: whose certificate the header names, what is refused, and what reaches the hand."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest

from feel321.stimuli.sets.manifest import read_stimuli
from feel321.stimuli.wav import read_wav
from feel321.study.actuator.certificate import Certificate, make_manual, write_certificate
from feel321.study.actuator.device import SimulatedCoil
from feel321.study.actuator.render import find_rig_problems, render_stimulus
from feel321.study.actuator.response import Sweep, make_inverse, make_sweep, measure_sweep
from feel321.study.actuator.rig import CoilTable, Rig, read_rig, take_device
from feel321.study.check import check_study
from feel321.study.folder import StudyFolder
from feel321.study.run import run_participant
from feel321.study.session.journal import read_journal
from feel321.study.sessions import read_room
from feel321.study.settings.read import read_settings
from tests.study.actuator.outside import predict
from tests.study.conftest import audit_study

NOW = datetime(2026, 3, 1, 12, tzinfo=UTC)
RATE_HZ = 48000.0
COIL = CoilTable(name="coil", resonance_hz=160, q=4, full_scale_m_s2=2000, direction=(0, 1, 0))
DEVICE = "simulated"


@pytest.fixture
def ready(smallest: StudyFolder, scripted: Any, monkeypatch: pytest.MonkeyPatch) -> StudyFolder:
    """A study that is built, on a machine that has all that is needed and somebody in the place of the screen."""
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setattr("feel321.study.run.find_spec", lambda _: "there")

    @contextmanager
    def open_presenter(*_: object, **__: object) -> Iterator[Any]:
        yield scripted()

    monkeypatch.setattr("feel321.study.run.open_lab", open_presenter)
    return smallest


def make(study: StudyFolder, *, gain: float = 100.0, device: str = DEVICE) -> Certificate:
    """Make a certificate of typed gains for a study's rig on a device."""
    rig = take_device(read_rig(study.rig), device)
    gains = {actuator.name: gain for actuator in rig.actuators}
    return make_manual(rig, gains, directions={}, made=NOW, rate_hz=RATE_HZ)


def visit(study: StudyFolder, *, days: float = 0, **choices: Any) -> list[str]:
    """Run a session some days later, and return what it warns of."""
    warnings: list[str] = []
    now = NOW + timedelta(days=days)
    simulated = choices.pop("simulated", False)
    room = replace(read_room(study, now=lambda: now), **{"device": DEVICE, **choices})
    run_participant(room, "p01", simulated=simulated, warn=warnings.append)
    return warnings


def find_calibration(study: StudyFolder) -> Any:
    header = read_journal(next((study.sessions / "p01").glob("*.jsonl"))).records.find_header()
    assert header is not None
    return header.to_data()["calibration"]


def test_the_header_names_the_certificate(ready: StudyFolder) -> None:
    written = write_certificate(make(ready), ready.path)
    assert visit(ready) == []
    assert find_calibration(ready) == {
        "id": written.id, "sha256": written.sha256, "method": "manual",
    }  # fmt: skip
    assert audit_study(ready) == []


def test_without_a_certificate_a_line_says_so(ready: StudyFolder) -> None:
    assert visit(ready) == [
        "no certificate of calibration; run feel321 calibrate; until then every row is uncalibrated"
    ]
    assert find_calibration(ready) == "uncalibrated"


@pytest.mark.parametrize("choices", [{"device": "file"}, {"simulated": True}])
def test_where_nobody_feels_it_nothing_is_said(ready: StudyFolder, choices: Any) -> None:
    assert visit(ready, **choices) == []
    assert find_calibration(ready) == "uncalibrated"


@pytest.mark.parametrize(
    ("break_it", "reason"),
    [
        (lambda _: None, "is of another rig"),
        (lambda path: path.write_text("{}"), "not a certificate"),
        (lambda path: path.write_text(path.read_text().replace("100.0", "200.0")), "was changed after"),
        (lambda path: path.unlink(), "no certificate of calibration"),
    ],
)  # fmt: skip
def test_a_certificate_can_be_required(ready: StudyFolder, break_it: Any, reason: str) -> None:
    written = write_certificate(make(ready, device="another"), ready.path)
    break_it(ready.calibration / f"{written.id}.json")
    text = ready.settings.read_text(encoding="utf-8")
    assert [
        line for line in check_study(ready).warnings if "certificate" in line
    ] or "no cert" in reason
    ready.settings.write_text(text + '\n[rig]\ncertificate = "require"\n', encoding="utf-8")
    with pytest.raises(ValueError, match=reason):
        visit(ready)
    assert not ready.participants
    assert reason in " ".join(check_study(ready).problems)


def test_one_that_expired_or_has_another_rate_is_refused(ready: StudyFolder) -> None:
    write_certificate(make(ready), ready.path)
    assert "expired on 2026-05-30" in visit(ready, days=91)[0]
    write_certificate(replace(make(ready), id="29990101", rate_hz=44100.0), ready.path)
    rig = ready.rig.read_text(encoding="utf-8")
    ready.rig.write_text(rig.replace('name = "file"', f'name = "{DEVICE}"', 1), encoding="utf-8")
    notes = check_study(ready, now=lambda: NOW).notes
    assert any("(manual), valid until 2026-05-30" in line for line in notes)
    warnings = check_study(ready, now=lambda: NOW + timedelta(days=91)).warnings
    assert any("was measured at 44100 Hz, the study plays at 48000 Hz" in line for line in warnings)


def test_a_certificate_that_comes_in_mid_session_is_another_rig(
    ready: StudyFolder, scripted: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def open_presenter(*_: object, **__: object) -> Iterator[Any]:
        yield scripted(stop_after=1)

    monkeypatch.setattr("feel321.study.run.open_lab", open_presenter)
    with pytest.raises(KeyboardInterrupt):
        visit(ready)
    written = write_certificate(make(ready), ready.path)
    with pytest.raises(ValueError, match=f"begun otherwise.*calibration.*{written.id}"):
        visit(ready)


@pytest.fixture(scope="module")
def filtered() -> tuple[Rig, Certificate]:
    """A rig of one coil, and its certificate by measurement."""
    rig = Rig.model_validate({
        "actuators": ({"name": "coil", "channel": 1, "direction": (0.0, 1.0, 0.0)},),
        "limits": {"peak_m_s2": 5000.0, "rms_m_s2": 3000.0, "duration_s": 60.0},
    })
    sweep = Sweep(rate_hz=RATE_HZ, duration_s=2, n_repeats=2)
    rng = np.random.default_rng(1)
    moved = SimulatedCoil(COIL, rate_hz=RATE_HZ, rng=rng).process(make_sweep(sweep))
    found = measure_sweep(sweep, moved)
    inverse = make_inverse(found, max_gain_db=40, n_taps=24000)
    typed = make_manual(rig, {"coil": 1.0}, directions={}, made=NOW, rate_hz=RATE_HZ)
    grid_hz = np.arange(10, 1250, 0.5)
    coil = replace(
        typed.coils["coil"], target=inverse.target, fir=inverse.fir, delay=inverse.delay, direction=found.direction,
        frequency_hz=grid_hz, response=np.interp(grid_hz, found.frequency_hz, found.response),
    )  # fmt: skip
    return rig, replace(typed, coils={"coil": coil})


def test_what_was_asked_for_reaches_the_hand(
    smallest: StudyFolder, filtered: tuple[Rig, Certificate]
) -> None:
    """Through the certificate, and only through it, the coil moves as the stimulus says."""
    rig, certificate = filtered
    stimuli = read_stimuli(smallest.stimuli)
    for stimulus in stimuli.stimuli:
        asked = 100.0 * read_wav(stimuli.folder / stimulus.file)[0]
        errors = []
        for own in (certificate, None):
            sent = render_stimulus(
                stimulus, stimuli.folder, rig, full_scale_m_s2=100.0, certificate=own
            ).astype(np.float64)
            rng = np.random.default_rng(1)
            felt = SimulatedCoil(COIL, rate_hz=RATE_HZ, rng=rng).process(sent[:, 0])[1]
            delay = certificate.coils["coil"].delay if own else 0
            errors.append(
                np.linalg.norm(felt[delay : delay + len(asked)] - asked) / np.linalg.norm(asked)
            )
            if own is not None:
                predicted = predict(certificate, sent)[1]
                assert np.linalg.norm(predicted - felt) < 0.02 * np.linalg.norm(felt)
        assert errors[0] < 0.2, errors
        assert errors[1] > 1, errors


def test_stimuli_that_no_longer_fit_are_named(
    smallest: StudyFolder, filtered: tuple[Rig, Certificate]
) -> None:
    rig, certificate = filtered
    weak = replace(certificate.coils["coil"], target=certificate.coils["coil"].target / 100)
    stimuli, settings = read_stimuli(smallest.stimuli), read_settings(smallest.settings)
    assert find_rig_problems(rig, stimuli, settings, certificate=certificate)[0] == []
    weakened = replace(certificate, coils={"coil": weak})
    found, _ = find_rig_problems(rig, stimuli, settings, certificate=weakened)
    assert len(found) > 1
    assert any("above the actuator's measured full scale of" in line for line in found)
    assert "lower max_gain_db or narrow band_hz under [calibration] and calibrate again" in found[0]
