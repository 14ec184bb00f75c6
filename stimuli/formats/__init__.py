"""The only reader of foreign files: a recording of any format in, a `Recording` in m/s² out."""

from stimuli.formats.read import read_recording

__all__ = ["read_recording"]
