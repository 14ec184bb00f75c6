"""A lab's own methods are found, digested and called like feel321's."""

import pickle
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from feel321 import stimuli
from feel321.extensions import find_method
from feel321.stimuli.conform import check_method
from feel321.stimuli.own_methods import OwnMetric, OwnReducer
from feel321.stimuli.sets.recipe import Recipe

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
    again = pickle.loads(pickle.dumps(methods[0]))  # noqa: S301 - what the line itself pickles
    assert again == methods[0]
    info = OwnMetric(find_method("metric", "methods/my321.py:crest", folder=study)).info
    assert (info.label, info.higher, info.low, info.unit) == ("crest", "worse", 1.0, "of RMS")
    turned = np.stack([SCENE.acceleration, -SCENE.acceleration])
    np.testing.assert_array_equal(OwnReducer(again)(turned, 1e4), [expected, -expected])


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
    own = {
        "reducers": ["dft321", "methods/my321.py:my321"],
        "metrics": ["spqi", "methods/my321.py:crest"],
    }
    scenes = [stimuli.make_scene(name, duration_s=0.3) for name in ("bumps", "hard_taps")]
    built = stimuli.build_stimuli(scenes, study / "two", workers=2, **own)
    alone = stimuli.build_stimuli(scenes, study / "one", **own)
    again = stimuli.build_stimuli(scenes, study / "one", **own)
    assert built.sha256 == alone.sha256 == again.sha256
    row = built["bumps__my321__as_is"]
    assert list(row.metrics) == ["spqi", "crest"]
    assert stimuli.read_stimuli(study / "two") == built
    assert stimuli.check_stimuli(study / "two") == []
    json_files = [(study / name / "manifest.json").read_bytes() for name in ("one", "two")]
    assert json_files[0] == json_files[1]


def test_taken_names_and_places_outside_the_study_are_refused(study: Path) -> None:
    (study / "methods" / "mine.py").write_text("def dft321(a, r):\n    return a[0]\n")
    for given, message in (
        (
            "methods/mine.py:_321",
            r"\Areducer 'methods/mine.py:_321': its name must be up to 60 letters",
        ),
        ("methods/mine.py:dft321", "is taken by one of feel321's own; rename it"),
        ("../other.py:my321", "must be a file in the study's folder"),
        ("methods/none.py:my321", "there is no file methods/none.py"),
        ("nolab.haptics:my321", "no module named 'nolab'; install it"),
        ("my321", "reducer must be one of"),
    ):
        with pytest.raises(ValueError, match=message):
            OwnReducer(find_method("reducer", given, taken=stimuli.REDUCERS, folder=study))


# Whatever is wrong with a lab's code, it is one line that says where, and nothing that was built is harmed.

TAKEN = {"reducer": stimuli.REDUCERS, "metric": stimuli.METRICS}

# Body of f(acceleration, rate_hz) -> what the line says.
REDUCERS = {
    "raises": ("raise RuntimeError('no sensor')", r"RuntimeError: no sensor \(methods/bad.py, line 6\)"),
    "endless message": ("raise ValueError('x' * 10000)", r"x{200}\.\.\."),
    "error without words": ("raise KeyError", r"KeyError \(methods/bad.py, line 6\)"),
    "error that cannot be written": ("raise Odd", r"Odd \(methods"),
    "missing import": ("import not_there_at_all", "ModuleNotFoundError: No module named 'not_there_at_all'"),
    "exits": ("sys.exit(3)", r"SystemExit: it called sys.exit\(3\), a method must return"),
    "recursion": ("return f(acceleration, rate_hz)", "RecursionError: maximum recursion depth"),
    "real memory": ("np.empty(10**15)", "(MemoryError|ArrayMemoryError): Unable to allocate"),
    "warning as error": ("warnings.simplefilter('error'); warnings.warn('hot')", "UserWarning: hot"),
    "three axes": ("return acceleration", r"got float64 of shape \(3, 3000\)"),
    "too short": ("return acceleration[0, 1:]", r"got float64 of shape \(2999,\)"),
    "nan": ("return acceleration[0] * np.nan", "got 3000 that are not finite, first at 0"),
    "masked": ("return np.ma.masked_less(acceleration[0], 0)", "masked values"),
    "changes its input": ("acceleration *= 2; return acceleration[0]", "changed its input"),
    "generator": ("yield 1", "must return finite real numbers"),
    "hostile array": ("return Hostile()", "got Hostile"),
}  # fmt: skip

# Body of f(acceleration, reduced, rate_hz).
METRICS = {
    "raises": ("raise RuntimeError('no')", r"metric f: RuntimeError: no \(methods/bad.py, line 6\)"),
    "array": ("return np.ones(2)", r"must return a number, got ndarray of shape \(2,\)"),
    "out of bounds": ("return 2.0\nf.high = 1.0", "from -inf to 1, or NaN"),
    "wrong direction": ("return 1.0\nf.higher = 'up'", "higher must be 'better' or 'worse', got 'up'"),
    "wrong bounds": ("return 1.0\nf.low, f.high = 1.0, 0.0", "low must be below high"),
    "changes the recording": ("acceleration[:] = 0; return 1.0", "changed its input"),
    "changes the reduction": ("reduced[:] = 0; return 1.0", "changed its input"),
}  # fmt: skip

# A whole file.
FILES = {
    "syntax": ("def f(:\n", r"SyntaxError: .*\(methods/bad.py, line 1\); cannot be loaded"),
    "fails at import": ("1 / 0\n", r"ZeroDivisionError: .*\(methods/bad.py, line 1\)"),
    "no such name": ("def g(): pass\n", "defines no 'f'"),
    "class without call": ("class f: pass\n", "TypeError: 'f' object is not callable"),
    "class that needs more": ("class f:\n    def __init__(self, x): pass\n", "TypeError: .*cannot be made"),
    "too few parameters": ("def f(acceleration): return acceleration[0]\n", "TypeError: .*takes 1 positional"),
    "bytes": (b"\xff\xfe\x00", "(SyntaxError|ValueError)"),
}  # fmt: skip

COMMANDS = {
    "no such program": ("./nothing {input} {output}", "./nothing: No such file or directory; check its name"),
    "not executable": ("./methods/bad.py {input} {output}", "Permission denied; check its name"),
    "fails": ("sh -c 'echo first >&2; echo bad wire >&2; exit 3' {input} {output}", "exit code 3: bad wire"),
    "fails in silence": ("sh -c 'exit 4' {input} {output}", "exit code 4 and wrote nothing to stderr"),
    "writes nothing": ("true {input} {output}", "wrote no file at {output}"),
    "writes text": ("sh -c 'echo hi > \"$1\"' sh {output} {input}", "{output} cannot be read as a WAV file"),
    "three channels": ("cp {input} {output}", r"got float64 of shape \(3, 3000\)"),
    "sleeps": ("sh -c 'sleep 30' {input} {output}", "took longer than 0.5 s and was stopped; set timeout_s"),
    "no output": ("cat {input}", "must hold {input} and {output}, got 'cat {input}'; add {output}"),
    "open quote": ("cat '{input} {output}", "No closing quotation"),
}  # fmt: skip

HEAD = "import sys, warnings\nimport numpy as np\n"
HELPERS = """
class Odd(Exception):
    def __str__(self): raise RuntimeError
class Hostile:
    def __array__(self, *a, **k): raise RuntimeError('mine')
"""


@pytest.fixture(scope="module")
def prebuilt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study folder with a set that was built."""
    folder = tmp_path_factory.mktemp("study")
    (folder / "methods").mkdir()
    stimuli.build_stimuli(SCENE, folder / "set", reducers=["dft321"], anchors=False)
    return folder


def read_set(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted((folder / "set").iterdir()) if p.is_file()}


def refuse(folder: Path, recipe: dict[str, object], message: str) -> None:
    """Build with a bad method: one line that says so, and the set as it was."""
    before = read_set(folder)
    with pytest.raises(ValueError, match=message) as caught:
        stimuli.build_stimuli(SCENE, folder / "set", Recipe(**{"anchors": False, **recipe}))
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < 700
    assert read_set(folder) == before
    assert len(stimuli.read_stimuli(folder / "set")) == 2


def find(folder: Path, kind: str) -> object:
    return find_method(kind, "methods/bad.py:f", taken=TAKEN[kind], folder=folder)


def write(folder: Path, body: str, parameters: str) -> None:
    text = f"{HEAD}\n\ndef f({parameters}):\n    {body}\n{HELPERS}"
    (folder / "methods" / "bad.py").write_text(text)


@pytest.mark.parametrize("name", REDUCERS)
@pytest.mark.filterwarnings("ignore")
def test_a_bad_reducer_is_one_line_and_harms_nothing(name: str, prebuilt: Path) -> None:
    body, message = REDUCERS[name]
    write(prebuilt, body, "acceleration, rate_hz")
    refuse(
        prebuilt,
        {"reducers": ["dft321", find(prebuilt, "reducer")]},
        f"recording 'bumps': reducer f: .*{message}",
    )


@pytest.mark.parametrize("name", METRICS)
def test_a_bad_metric_is_one_line_and_harms_nothing(name: str, prebuilt: Path) -> None:
    body, message = METRICS[name]
    write(prebuilt, body, "acceleration, reduced, rate_hz")
    refuse(prebuilt, {"reducers": ["dft321"], "metrics": [find(prebuilt, "metric")]}, message)


@pytest.mark.parametrize("name", FILES)
def test_a_bad_file_is_one_line_and_harms_nothing(name: str, prebuilt: Path) -> None:
    text, message = FILES[name]
    path = prebuilt / "methods" / "bad.py"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    refuse(prebuilt, {"reducers": ["dft321", find(prebuilt, "reducer")]}, message)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_bad_command_is_one_line_and_harms_nothing(name: str, prebuilt: Path) -> None:
    command, message = COMMANDS[name]
    table = {"f": {"command": command, "timeout_s": 0.5}}
    (prebuilt / "methods" / "bad.py").write_text("")
    before = read_set(prebuilt)

    def find_and_build() -> None:
        given = find_method("reducer", "f", folder=prebuilt, declared=table)
        stimuli.build_stimuli(SCENE, prebuilt / "set", reducers=["dft321", given], anchors=False)

    with pytest.raises(ValueError, match=message if "\\" in message else re.escape(message)):
        find_and_build()
    assert read_set(prebuilt) == before


def test_what_a_method_prints_or_warns_goes_to_stderr_and_never_to_stdout(
    prebuilt: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(
        prebuilt,
        "print('hello'); warnings.warn('hot'); return acceleration[0]",
        "acceleration, rate_hz",
    )
    stimuli.reduce(SCENE, stimuli.own_methods.OwnReducer(find(prebuilt, "reducer")))
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == ["hello", "feel321: warning: reducer f: UserWarning: hot"]


@pytest.mark.parametrize(
    ("body", "failed"),
    [
        ("return acceleration[0]", []),
        ("return acceleration[0] ** 2", ["scaling"]),
        ("return acceleration[0] + np.random.standard_normal(acceleration.shape[1])",
         ["silence", "repeats", "scaling", "second process"]),
        ("return acceleration[0] + hash('seed') % 99991 * acceleration[1]", ["second process"]),
        ("return acceleration[0] / np.abs(acceleration[0]).max()", ["silence", "scaling"]),
        ("return np.abs(np.fft.irfft(np.fft.rfft(acceleration[0])))", ["shape"]),
    ],
)  # fmt: skip
def test_the_conformance_check_finds_what_is_wrong(
    body: str, failed: list[str], prebuilt: Path
) -> None:
    write(prebuilt, body, "acceleration, rate_hz")
    found = check_method(find(prebuilt, "reducer"))
    assert [one.check for one in found if not one.passed] == failed
