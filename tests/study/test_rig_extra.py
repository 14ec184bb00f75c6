"""The rig extra is really there: PortAudio loads, and PsychoPy imports without opening a window."""

import importlib.metadata
import sys

import pytest

# sounddevice and psychopy are imported within the tests, so that a missing library fails one test, not the collection.


def test_sounddevice_finds_portaudio() -> None:
    import sounddevice

    assert "PortAudio" in sounddevice.get_portaudio_version()[1]
    assert [api["name"] for api in sounddevice.query_hostapis()] != []


@pytest.mark.skipif(
    sys.version_info >= (3, 13), reason="NO PSYCHOPY: it supports Python 3.10 to 3.12 only"
)
def test_psychopy_imports_without_a_window() -> None:
    import psychopy

    assert psychopy.__version__ == importlib.metadata.version("psychopy")
    assert "psychopy.visual" not in sys.modules
