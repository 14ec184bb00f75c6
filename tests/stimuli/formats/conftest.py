from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

MICROSECONDS = {"TimeCodeScale": "1.0/1000000", "TimeCodeModulus": 2**32}


@pytest.fixture
def signal() -> NDArray[np.float64]:
    """Three axes that differ, shape (3, 60)."""
    return np.random.default_rng(7).normal(size=(3, 60))


def _channel(number: int, names: tuple[str, ...], unit: str) -> dict[str, object]:
    axes = [
        {
            "SubChannelID": i,
            "SubChannelName": name,
            "SubChannelLabel": unit,
            "SubChannelUnits": unit,
            "SubChannelCalibrationIDRef": 1,
        }
        for i, name in enumerate(names)
    ]
    layout = {"ChannelFormat": "<" + "h" * len(names), **MICROSECONDS}
    return {"ChannelID": number, "ChannelName": f"channel {number}", "SubChannel": axes, **layout}


@pytest.fixture
def write_ide(tmp_path: Path) -> Callable[..., Path]:
    """A writer of enDAQ files by the maker's own schema: blocks of 50 counts (n, 3), a count being 0.001 g."""
    ebmlite = pytest.importorskip("ebmlite")
    idelib = pytest.importorskip("idelib")
    schema = ebmlite.loadSchema(str(Path(idelib.__file__).parent / "schemata" / "mide_ide.xml"))

    def write(
        counts: NDArray[np.int16], *, period_us: int = 50, lost_us: int = 0, unit: str = "g"
    ) -> Path:
        accelerometer = _channel(8, ("Z (100g)", "Y (100g)", "X (100g)"), unit)
        slow = _channel(80, ("X (40g)", "Y (40g)", "Z (40g)"), unit)
        gyroscope = _channel(47, ("X", "Y", "Z"), "dps")
        linear = {"CalID": 1, "CalReferenceValue": 0.0, "PolynomialCoef": [0.001, 0.0]}
        elements: list[dict[str, object]] = [
            {"EBML": {"DocType": "mide"}},
            {"RecordingProperties": {
                "RecorderInfo": {"RecorderTypeUID": 1, "RecorderSerial": 1},
                "ChannelList": {"Channel": [accelerometer, slow, gyroscope]},
            }},
            {"CalibrationList": {"UnivariatePolynomial": [linear]}},
        ]  # fmt: skip
        for start in range(0, len(counts), 50):
            block = counts[start : start + 50]
            first_us = start * period_us + (lost_us if start else 0)
            for channel, stretch in ((8, 1), (80, 4), (47, 1)):
                stamps = {
                    "StartTimeCodeAbsMod": first_us * stretch,
                    "EndTimeCodeAbsMod": (first_us + (len(block) - 1) * period_us) * stretch,
                }
                # The recorder's order is z, y, x.
                rows = block[:, ::-1] if channel == 8 else 0 * block
                payload = {
                    "ChannelIDRef": channel,
                    **stamps,
                    "ChannelDataPayload": rows.astype("<i2").tobytes(),
                }
                elements.append({"ChannelDataBlock": payload})
        path = tmp_path / "recorder.IDE"
        path.write_bytes(b"".join(schema.encodes(element) for element in elements))
        return path

    return write
