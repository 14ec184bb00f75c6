"""`python -m feel321.stimuli`: golden vectors for reducers in another language, out as WAV files and back."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from feel321.stimuli import conform_stream as streams
from feel321.stimuli.conform import FORMS, check_outputs, golden_vectors, write_vectors


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the vectors as WAV files, or check a port's answers."""
    example = "DIR; then your port; then python -m feel321.stimuli check-vectors DIR"
    parser = argparse.ArgumentParser(
        prog="python -m feel321.stimuli",
        description=__doc__,
        epilog=f"Example: python -m feel321.stimuli write-vectors {example}",
    )
    parser.add_argument("verb", choices=("write-vectors", "check-vectors"))
    parser.add_argument("folder", type=Path)
    form = "which form the port implements; streaming: block by block, see vectors.json"
    parser.add_argument("--form", choices=(*FORMS, "streaming"), default="whole", help=form)
    reducer = "which streaming reducer the port implements"
    parser.add_argument(
        "--reducer", choices=streams.STREAMING, default="dft321_windowed", help=reducer
    )
    chosen = parser.parse_args(arguments)
    try:
        print(_stream(chosen) if chosen.form == "streaming" else _convert(chosen))
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def _convert(chosen: argparse.Namespace) -> str:
    if chosen.verb == "write-vectors":
        count = len(write_vectors(chosen.folder, form=chosen.form))
        answer = "answer each NAME.wav with NAME.out.wav, then: check-vectors"
        return f"{count} inputs in {chosen.folder}; {answer}"
    check_outputs(chosen.folder, form=chosen.form)
    return f"conforms: {len(golden_vectors(chosen.form))} vectors"


def _stream(chosen: argparse.Namespace) -> str:
    if chosen.verb == "write-vectors":
        count = len(streams.write_stream_vectors(chosen.folder, chosen.reducer))
        answer = f"feed them as {streams.LIST} says, answer with NAME.out.wav, latency included, then: check-vectors"
        return f"{count} inputs in {chosen.folder}; {answer}"
    streams.check_stream_outputs(chosen.folder, chosen.reducer)
    return f"conforms: {len(streams.stream_vectors(chosen.reducer))} vectors"


if __name__ == "__main__":
    sys.exit(main())
