"""How arguments of verbs are read from a command line: their forms, names and bounds.

The signatures of `Study` name these; to a type checker, and to Python, they are the plain types.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter, Token

from feel321.jobs import Workers
from feel321.study.folder import list_bundled
from feel321.study.session.journal import PARTICIPANT_ID

if TYPE_CHECKING:
    from feel321.stimuli.recording import Recording
    from feel321.types import PathLike, Rng

    Processes = int | Workers
    Several = int | Sequence[int]
    Texts = Sequence[str]
    Slopes = Mapping[str, float] | Sequence[str]
else:  # as a command line gives them
    PathLike, Rng, Processes = Path, int, int
    Several, Texts, Slopes = tuple[int, ...], tuple[str, ...], tuple[str, ...]

MOST = 1e9  # beyond this no option means anything, whatever its unit
MOST_SEED = 2**63 - 1
MOST_OF_ANY = 100_000


def within(low: float, high: float) -> Parameter:
    """Make the rule that a number lies in a range, both ends included; NaN is in none."""
    allowed = f"{low:g} to {high:g}" if high < MOST_SEED else f"{low:g} or more"

    def check(_kind: object, number: float | None) -> None:
        if number is not None and not low <= number <= high:
            raise ValueError(f"Allowed: {allowed}")

    return Parameter(validator=check)


def _read_path(_kind: type, tokens: Sequence[Token]) -> Path:
    if not tokens[0].value:
        raise ValueError("a name must not be empty; '.' is the current folder")
    return Path(tokens[0].value)


def _read_columns(_kind: type, tokens: Sequence[Token]) -> tuple[str | int, ...]:
    names = tokens[0].value.split(",")
    return tuple(int(name) if name.strip().isdigit() else name for name in names)


def _read_numbers(_kind: type, tokens: Sequence[Token]) -> tuple[int, ...]:
    """Read whole numbers with commas between them, in ascending order, each once."""
    text = tokens[0].value
    try:
        numbers = sorted({int(part) for part in text.split(",")})
    except ValueError:
        numbers = [0]
    if numbers[0] < 1 or numbers[-1] > MOST_OF_ANY:
        allowed = f"whole numbers from 1 to {MOST_OF_ANY} with commas between them, such as 8,12,16"
        raise ValueError(f"must be {allowed}; got {text!r}")
    return tuple(numbers)


def _check_code(_kind: object, code: str) -> None:
    if not PARTICIPANT_ID.fullmatch(code):
        raise ValueError(f"must be letters (A-Z), digits, - and _, got {code!r}")


def _check_scheduler(_kind: object, address: str) -> None:
    Workers(1, address)


def called(name: str, metavar: str = "") -> Parameter:
    """Name an option otherwise than its parameter."""
    return Parameter(name=name, metavar=metavar or None)


File = Annotated[PathLike, Parameter(converter=_read_path, metavar="PATH")]
Page = Annotated[File, Parameter(metavar="PAGE")]
Folder = Annotated[PathLike, Parameter(converter=_read_path, name="DIR", metavar="DIR")]
Reduced = Annotated[PathLike, Parameter(converter=_read_path, name="REDUCED.wav")]
Sources = Annotated[PathLike, Parameter(converter=_read_path, name="FROM...", required=True)]
Places = Annotated[PathLike, Parameter(converter=_read_path, name="[STUDY | RECORDING...]")]
Target = Annotated[File, Parameter(name=["--out", "-o"])]
Text = Annotated[str, Parameter(metavar="TEXT")]
Out = Annotated[File | None, Parameter(name=["--out", "-o"])]
Name = Annotated[str | None, Parameter(metavar="NAME")]
Code = Annotated[str, Parameter(metavar="ID")]
NewCode = Annotated[str, Parameter(metavar="ID", validator=_check_code)]
Reducer = Annotated[str, Parameter(metavar="NAME")]
Checkpoint = Code
Remote = Annotated[str, Parameter(metavar="REMOTE")]
Remotes = Annotated[Texts, called("--remote", "REMOTE")]
Metrics = Annotated[Texts, called("--metric", "NAME")]
Effects = Annotated[Slopes, called("--effect", "METRIC=POINTS")]
Gains = Annotated[Texts, Parameter(metavar="NAME=GAIN")]
Pilot = Annotated[str | None, Parameter(metavar="FILE")]
Ready = Annotated[str | None, Parameter(name="--study", choices=list_bundled())]
Kind = Literal["reducer", "metric"] | None
Mounting = Literal["any", "recorded"]
Yes = Annotated[bool, called("--yes")]
ForR = Annotated[bool, called("--r")]

Number = Annotated[float, within(0, MOST)]
Numbers = Annotated[Several, Parameter(converter=_read_numbers, n_tokens=1, metavar="N,...")]
People = Annotated[int, within(1, 10_000)]
Studies = Annotated[int, within(0, 1_000_000)]
Power = Annotated[float, within(0.06, 0.995), called("--power")]
Seconds = Annotated[float, within(0, 3600)]
Screen = Annotated[int, within(0, 99)]
Seed = Annotated[Rng | None, within(0, MOST_SEED), called("--seed")]
WholeSeed = Annotated[int | None, within(0, MOST_SEED)]
Crew = Annotated[Processes, within(1, 1024)]
Scheduler = Annotated[str, Parameter(metavar="ADDRESS", validator=_check_scheduler)]
# An argument that is no option: study.toml declares it.
PythonOnly = Annotated[int | None, Parameter(parse=False)]


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class Reading:
    """How a recording is read.

    Parameters
    ----------
    unit : str, optional
        Unit of the samples.  [default: what the file says]
    rate_hz : float, optional
        Sampling rate in Hz.  [default: what the file says]
    columns : tuple of str or int, optional
        Names or numbers (from 0): time,x,y,z.
    full_scale : float, optional
        Full scale of integer samples, in the unit.
    resample : bool
        Interpolate irregular sampling to an even rate.
    """

    unit: Literal["m/s^2", "g", "mg"] | None = None
    rate_hz: Number | None = None
    columns: Annotated[
        tuple[str | int, ...] | None,
        Parameter(converter=_read_columns, n_tokens=1, metavar="NAME,..."),
    ] = None
    full_scale: Number | None = None
    resample: bool = False

    def read(self, path: PathLike) -> "Recording":
        """Read a recording."""
        from feel321.stimuli.formats.read import read_recording

        choices: dict[str, Any] = {name: getattr(self, name) for name in self.__slots__}
        return read_recording(path, **choices)


AS_IT_SAYS = Reading()
