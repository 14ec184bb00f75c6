"""`python -m feel321.stimuli`: golden vectors for a DFT321 in another language, out as WAV files and back."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from feel321.stimuli.conform import check_outputs, golden_vectors, write_vectors

if TYPE_CHECKING:
    from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the vectors as WAV files, or judge a port's answers."""
    parser = argparse.ArgumentParser(
        prog="python -m feel321.stimuli",
        description=__doc__,
        epilog=(
            "Example: python -m feel321.stimuli write-vectors DIR; then your port; then python -m "
            "feel321.stimuli check-vectors DIR"
        ),
    )
    parser.add_argument("verb", choices=("write-vectors", "check-vectors"))
    parser.add_argument("folder", type=Path)
    parser.add_argument(
        "--form",
        choices=("whole", "windowed"),
        default="whole",
        help="which form the port implements",
    )
    chosen = parser.parse_args(arguments)
    try:
        if chosen.verb == "write-vectors":
            count = len(write_vectors(chosen.folder, form=chosen.form))
            print(
                f"{count} inputs in {chosen.folder}; answer each NAME.wav with NAME.out.wav, then: check-vectors"
            )
        else:
            check_outputs(chosen.folder, form=chosen.form)
            print(f"conforms: {len(golden_vectors(chosen.form))} vectors")
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
