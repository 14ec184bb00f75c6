"""Whatever is wrong with a lab's code, it is one line that says where, and nothing that was built is harmed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from feel321 import stimuli
from feel321.extensions import find_method
from feel321.stimuli.conform import check_method
from feel321.stimuli.sets.recipe import Recipe

SCENE = stimuli.make_scene("bumps", duration_s=0.3)
TAKEN = {"reducer": stimuli.REDUCERS, "metric": stimuli.METRICS}

# Body of f(acceleration, rate_hz) -> what the line says.
REDUCERS = {
    "raises": ("raise RuntimeError('no sensor')", r"RuntimeError: no sensor \(methods/bad.py, line 6\)"),
    "several lines": ("raise ValueError('one\\ntwo')", "ValueError: one two "),
    "endless message": ("raise ValueError('x' * 10000)", r"x{200}\.\.\."),
    "error without words": ("raise KeyError", r"KeyError \(methods/bad.py, line 6\)"),
    "error that cannot be written": ("raise Odd", r"Odd \(methods"),
    "missing import": ("import not_there_at_all", "ModuleNotFoundError: No module named 'not_there_at_all'"),
    "exits": ("sys.exit(3)", r"SystemExit: it called sys.exit\(3\), a method must return"),
    "recursion": ("return f(acceleration, rate_hz)", "RecursionError: maximum recursion depth"),
    "memory": ("raise MemoryError", "MemoryError"),
    "real memory": ("np.empty(10**15)", "(MemoryError|ArrayMemoryError): Unable to allocate"),
    "warning as error": ("warnings.simplefilter('error'); warnings.warn('hot')", "UserWarning: hot"),
    "nothing": ("pass", "must return finite real numbers of shape .3000,., got None"),
    "text": ("return 'loud'", "got <U4 of shape"),
    "list of lists": ("return [[1.0], [1.0, 2.0]]", "got list"),
    "dictionary": ("return {}", "got {}"),
    "three axes": ("return acceleration", r"got float64 of shape \(3, 3000\)"),
    "too short": ("return acceleration[0, 1:]", r"got float64 of shape \(2999,\)"),
    "too long": ("return np.append(acceleration[0], 0)", r"got float64 of shape \(3001,\)"),
    "one number": ("return 1.0", r"got float64 of shape \(\)"),
    "empty": ("return []", r"got float64 of shape \(0,\)"),
    "complex": ("return acceleration[0] * 1j", "got complex128 of shape"),
    "boolean": ("return acceleration[0] > 0", "got bool of shape"),
    "objects": ("return np.array([object()] * 3000)", "got ndarray of shape"),
    "nan": ("return acceleration[0] * np.nan", "got 3000 that are not finite, first at 0"),
    "infinite": ("return acceleration[0] / 0.0", "not finite"),
    "masked": ("return np.ma.masked_less(acceleration[0], 0)", "masked values"),
    "changes its input": ("acceleration *= 2; return acceleration[0]", "changed its input"),
    "generator": ("yield 1", "must return finite real numbers"),
    "hostile array": ("return Hostile()", "got Hostile"),
}  # fmt: skip

# Body of f(acceleration, reduced, rate_hz).
METRICS = {
    "raises": ("raise RuntimeError('no')", r"metric f: RuntimeError: no \(methods/bad.py, line 6\)"),
    "text": ("return '0.5'", "must return a number, got '0.5'"),
    "nothing": ("return None", "must return a number, got None"),
    "array": ("return np.ones(2)", r"must return a number, got ndarray of shape \(2,\)"),
    "complex": ("return 1j", "must return a number, got 1j"),
    "infinite": ("return float('inf')", "got inf"),
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
    "exits at import": ("import sys\nsys.exit()\n", "SystemExit"),
    "no such name": ("def g(): pass\n", "defines no 'f'"),
    "a number": ("f = 3\n", "TypeError: 'int' object is not callable"),
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
    stimuli.reduce(SCENE, stimuli.guard.OwnReducer(find(prebuilt, "reducer")))
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
