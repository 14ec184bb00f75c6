"""A lab's own methods are found, digested and called like feel321's."""

import pickle
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from feel321 import stimuli
from feel321.extensions import find_method
from feel321.stimuli.conform import check_method
from feel321.stimuli.guard import OwnMetric, OwnReducer

CODE = """\
import numpy as np


def my321(acceleration, rate_hz):
    return acceleration.sum(axis=0)


def crest(acceleration, reduced, rate_hz):
    return float(np.abs(reduced).max() / np.sqrt(np.mean(reduced**2)))


crest.higher, crest.low, crest.unit = "worse", 1.0, "of RMS"
"""

SCENE = stimuli.make_scene("bumps", duration_s=0.3)


@pytest.fixture
def study(tmp_path: Path) -> Path:
    (tmp_path / "methods").mkdir()
    (tmp_path / "methods" / "my321.py").write_text(CODE)
    return tmp_path


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package as pip would have installed it, with entry points."""
    home = tmp_path / "site"
    (home / "mylab").mkdir(parents=True)
    (home / "mylab" / "__init__.py").write_text("")
    (home / "mylab" / "haptics.py").write_text(CODE)
    facts = home / "mylab-1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: mylab\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text(
        "[feel321.reducers]\nsum321 = mylab.haptics:my321\n"
        "[feel321.metrics]\ncrest = mylab.haptics:crest\n"
    )
    monkeypatch.syspath_prepend(home)
    yield home
    for name in [name for name in sys.modules if name.partition(".")[0] == "mylab"]:
        del sys.modules[name]


@pytest.mark.usefixtures("package")
def test_a_file_a_package_an_entry_point_and_a_function_are_one_reducer(study: Path) -> None:
    expected = SCENE.acceleration.sum(axis=0)
    namespace: dict[str, object] = {}
    exec(CODE, namespace)  # noqa: S102 - a function without a file, as in a notebook
    given = ["methods/my321.py:my321", "mylab.haptics:my321", "sum321", namespace["my321"]]
    methods = [find_method("reducer", one, taken=stimuli.REDUCERS, folder=study) for one in given]
    assert [one.name for one in methods] == ["my321", "my321", "sum321", "my321"]
    assert methods[1].sha256 == methods[2].sha256
    for method in methods:
        found = OwnReducer(method)(SCENE.acceleration, SCENE.rate_hz)
        np.testing.assert_array_equal(found, expected)
    turned = np.stack([SCENE.acceleration, -SCENE.acceleration])
    np.testing.assert_array_equal(OwnReducer(methods[0])(turned, 1e4), [expected, -expected])


def test_a_method_survives_the_way_to_another_process(study: Path) -> None:
    method = find_method("metric", "methods/my321.py:crest", folder=study)
    again = pickle.loads(pickle.dumps(method))  # noqa: S301 - what the line itself pickles
    assert again == method
    info = OwnMetric(again).info
    assert (info.label, info.higher, info.low, info.unit) == ("crest", "worse", 1.0, "of RMS")


def test_the_digest_covers_what_is_imported_the_package_and_what_a_command_names(
    study: Path, package: Path
) -> None:
    table = {"run": {"command": "sh methods/run.sh {input} {output}"}}
    (study / "methods" / "run.sh").write_text("cp $1 $2\n")

    def digest() -> list[str]:
        given = ["methods/my321.py:my321", "mylab.haptics:my321", "run"]
        return [find_method("reducer", one, folder=study, declared=table).sha256 for one in given]

    code = study / "methods" / "my321.py"
    code.write_text("from helper import X\n" + code.read_text())
    (study / "methods" / "helper.py").write_text("from parts.deep import X\n")
    (study / "methods" / "parts").mkdir()
    for name in ("__init__", "deep"):
        (study / "methods" / "parts" / f"{name}.py").write_text("X = 1\n")
    before = digest()
    (study / "methods" / "another.py").write_text("X = 1\n")
    (study / "methods" / "notes.txt").write_text("not code\n")
    assert digest() == before
    (study / "methods" / "parts" / "deep.py").write_text("X = 2\n")
    first = digest()
    (package / "mylab" / "other.py").write_text("X = 1\n")
    second = digest()
    (study / "methods" / "run.sh").write_text("cat $1 > $2\n")
    third = digest()
    assert [a != b for a, b in zip(before, first, strict=True)] == [True, False, False]
    assert [a != b for a, b in zip(first, second, strict=True)] == [False, True, False]
    assert [a != b for a, b in zip(second, third, strict=True)] == [False, False, True]


def test_a_set_holds_the_labs_own_reducers_and_metrics_and_is_built_alike_by_two_processes(
    study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(study)
    own = {"reducers": ["dft321", "methods/my321.py:my321"], "metrics": ["methods/my321.py:crest"]}
    scenes = [stimuli.make_scene(name, duration_s=0.3) for name in ("bumps", "hard_taps")]
    built = stimuli.build_stimuli(scenes, study / "two", workers=2, **own)
    alone = stimuli.build_stimuli(scenes, study / "one", **own)
    assert built.sha256 == alone.sha256
    row = built["bumps__my321__as_is"]
    assert row.metrics.keys() == {"crest"}
    assert stimuli.read_stimuli(study / "two") == built
    assert stimuli.check_stimuli(study / "two") == []
    json_files = [(study / name / "manifest.json").read_bytes() for name in ("one", "two")]
    assert json_files[0] == json_files[1]


def test_taken_names_and_places_outside_the_study_are_refused(study: Path) -> None:
    (study / "methods" / "mine.py").write_text("def dft321(a, r):\n    return a[0]\n")
    for given, message in (
        ("methods/mine.py:dft321", "is taken by one of feel321's own; rename it"),
        ("../other.py:my321", "must be a file in the study's folder"),
        ("methods/none.py:my321", "there is no file methods/none.py"),
        ("nolab.haptics:my321", "no module named 'nolab'; install it"),
        ("my321", "reducer must be one of"),
    ):
        with pytest.raises(ValueError, match=message):
            OwnReducer(find_method("reducer", given, taken=stimuli.REDUCERS, folder=study))


MADE = {"made321": {"file": "made/{recording}.wav"}}


def find_made(folder: Path, declared: dict[str, dict[str, object]] | None = None) -> OwnReducer:
    return OwnReducer(find_method("reducer", "made321", folder=folder, declared=declared or MADE))


def test_what_was_made_elsewhere_is_read_for_each_recording(study: Path) -> None:
    scenes = [stimuli.make_scene(name, duration_s=0.3) for name in ("bumps", "hard_taps")]
    (study / "made").mkdir()
    for scene in scenes:
        ready = stimuli.condition(scene, stimuli.Conditioning())
        sums = stimuli.REDUCERS["soc321"](ready.acceleration, ready.rate_hz)
        stimuli.write_wav(study / "made" / f"{scene.name}.wav", sums, int(ready.rate_hz))
    own = find_made(study)
    built = stimuli.build_stimuli(scenes, study / "set", reducers=["soc321", own.method])
    for scene in scenes:
        made, here = (built[f"{scene.name}__{name}__as_is"] for name in ("made321", "soc321"))
        assert made.spectral_match == pytest.approx(here.spectral_match, abs=1e-4)
    stimuli.write_wav(study / "made" / "bumps.wav", np.zeros(3000), 10000)
    assert find_made(study).method.sha256 != own.method.sha256


def test_what_was_made_elsewhere_is_refused_where_it_does_not_fit(study: Path) -> None:
    (study / "made").mkdir()
    with pytest.raises(ValueError, match="for the study's recordings only; leave it out here"):
        find_made(study)(SCENE.acceleration, SCENE.rate_hz)
    with pytest.raises(ValueError, match=r"there is no made/bumps\.wav; put it there"):
        stimuli.build_stimuli(SCENE, study / "set", reducers=[find_made(study).method])
    (study / "made" / "bumps.wav").write_bytes(b"RIFF")
    with pytest.raises(ValueError, match=r"made/bumps\.wav cannot be read as a WAV file"):
        stimuli.build_stimuli(SCENE, study / "set", reducers=[find_made(study).method])
    stimuli.write_wav(study / "made" / "bumps.wav", np.zeros(3000), 8000)
    with pytest.raises(ValueError, match="recording's rate of 10000 Hz, got 8000 Hz; resample it"):
        stimuli.build_stimuli(SCENE, study / "set", reducers=[find_made(study).method])
    stimuli.write_wav(study / "made" / "bumps.wav", np.zeros(2999), 10000)
    with pytest.raises(
        ValueError, match=r"numbers of shape \(3000,\), got float64 of shape \(2999,\)"
    ):
        stimuli.build_stimuli(SCENE, study / "set", reducers=[find_made(study).method])
    (checked,) = check_method(find_made(study).method)
    assert (checked.check, checked.passed) == ("loads", True)
    for file in ("made/{input}.wav", "../{recording}.wav", "/{recording}.wav"):
        with pytest.raises(ValueError, match="must be in the study's folder and name each"):
            find_made(study, {"made321": {"file": file}})
