"""A set that is not the one that the settings ask for is named, never used, and never lost while sessions need it."""

import json
from datetime import UTC, datetime

import pytest

from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.check import build_study, check_study
from feel321.study.folder import StudyFolder
from feel321.study.simulate import simulate_study
from tests.study.conftest import audit_study


@pytest.fixture
def built(study: StudyFolder) -> StudyFolder:
    build_study(study)
    return study


def change(study: StudyFolder, old: str, new: str) -> None:
    text = study.settings.read_text(encoding="utf-8")
    assert old in text
    study.settings.write_text(text.replace(old, new), encoding="utf-8")


def simulate(study: StudyFolder) -> int:
    return simulate_study(
        study, participants=1, seed=None, now=lambda: datetime(2026, 1, 1, tzinfo=UTC)
    )


def use(study: StudyFolder) -> None:
    """Leave what a session leaves: a file that names the set."""
    folder = study.sessions / "p01"
    folder.mkdir(parents=True)
    (folder / "plan.json").write_text(
        json.dumps({"stimuli_sha256": read_stimuli(study.stimuli).sha256})
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "[analysis]",
            "[rig]\nrate_hz = 44100.0\n[analysis]",
            "rate_hz: built with 48000.0; the settings say 44100.0",
        ),
        (
            "[analysis]",
            "[stimuli.conditioning]\nlow_pass_hz = 500.0\n[analysis]",
            "conditioning.low_pass_hz: built with 1000.0; the settings say 500.0",
        ),
        (
            '"hard_taps"',
            '"circular_motion"',
            "recordings: built from bumps, hard_taps; the settings name bumps, circular_motion",
        ),
    ],
)
def test_a_stale_set_is_listed_by_check_and_refused_by_simulate(
    old: str, new: str, message: str, built: StudyFolder
) -> None:
    change(built, old, new)
    assert list(check_study(built).problems) == [f"{built.stimuli}: {message}; run feel321 build"]
    with pytest.raises(ValueError, match=message) as caught:
        simulate(built)
    assert str(caught.value).endswith(f"; run feel321 build {built.path}")
    assert built.participants == []
    build_study(built)
    assert list(check_study(built).problems) == []


@pytest.mark.parametrize(
    ("old", "new"), [("sax321", "say321"), ('scene = "bumps"', 'scene = "bumps"\nseed = 9')]
)
def test_a_set_that_sessions_were_run_with_is_not_replaced(
    old: str, new: str, built: StudyFolder
) -> None:
    use(built)
    before = {path.name: path.read_bytes() for path in built.stimuli.iterdir()}
    change(built, old, new)
    with pytest.raises(
        ValueError,
        match=r"sessions were run with this set; make a new study, or move .*sessions away",
    ):
        build_study(built)
    assert {path.name: path.read_bytes() for path in built.stimuli.iterdir()} == before
    built.sessions.rename(built.path / "earlier")
    build_study(built)


def test_a_set_in_use_may_be_built_again_and_another_one_replaced(built: StudyFolder) -> None:
    use(built)
    sha256 = read_stimuli(built.stimuli).sha256
    (built.stimuli / "bumps__sax321__as_is.wav").unlink()
    assert build_study(built)[1].sha256 == sha256
    (built.sessions / "p01" / "plan.json").write_text("{}", encoding="utf-8")
    change(built, "sax321", "say321")
    assert build_study(built)[1].sha256 != sha256


@pytest.mark.parametrize(
    "content",
    [None, b"", b"null", b"[]", b"{}", b"\xff", b'{"stimuli": [1], "recipe": {}}', b"[" * 99999],
)
def test_a_manifest_json_that_is_none_is_said_and_mended(
    content: bytes | None, built: StudyFolder
) -> None:
    path = built.stimuli / "manifest.json"
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    for problems in (list(check_study(built).problems), audit_study(built)):
        assert len(problems) == 1
        assert problems[0].startswith(f"{path}: is missing or damaged (")
        assert problems[0].endswith(
            "session was planned with this set, write it anew with: feel321 build"
        )
    with pytest.raises(ValueError, match="is missing or damaged"):
        simulate(built)
    build_study(built)
    assert [*check_study(built).problems, *audit_study(built)] == []


@pytest.mark.parametrize("name", ["manifest.json", "manifest.csv"])
@pytest.mark.parametrize("content", [None, b"\xff"])
def test_a_set_of_which_nobody_can_tell_whether_it_is_in_use_is_not_replaced(
    name: str, content: bytes | None, built: StudyFolder
) -> None:
    use(built)
    change(built, "sax321", "say321")
    (built.stimuli / name).unlink()
    if content is not None:
        (built.stimuli / name).write_bytes(content)
    before = {path.name: path.read_bytes() for path in built.stimuli.iterdir()}
    with pytest.raises(ValueError, match="sessions may have been run with this set") as caught:
        build_study(built)
    assert str(caught.value).endswith(f"; restore it from a copy, or move {built.sessions} away")
    assert "\n" not in str(caught.value)
    assert {path.name: path.read_bytes() for path in built.stimuli.iterdir()} == before
    # Where nothing is left, nothing can be replaced.
    built.stimuli.rename(built.path / "elsewhere")
    build_study(built)


def test_a_missing_set_is_a_finding_once_sessions_have_begun(study: StudyFolder) -> None:
    assert [*check_study(study).problems, *audit_study(study)] == []
    use_folder = study.sessions / "p01"
    use_folder.mkdir(parents=True)
    (use_folder / ".lock").touch()
    assert audit_study(study) == []
    (use_folder / "plan.json").write_text("{}", encoding="utf-8")
    assert any("there is no manifest" in finding for finding in audit_study(study))
    assert list(check_study(study).problems) == [
        f"{study.stimuli}: missing, but sessions were run with it; put it back or build it again"
    ]
