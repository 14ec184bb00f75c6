"""`python -m feel321.stimuli`: golden vectors for a DFT321 in another language, out as WAV files and back."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

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
    form = "which form the port implements"
    parser.add_argument("--form", choices=FORMS, default="whole", help=form)
    chosen = parser.parse_args(arguments)
    try:
        if chosen.verb == "write-vectors":
            count = len(write_vectors(chosen.folder, form=chosen.form))
            answer = "answer each NAME.wav with NAME.out.wav, then: check-vectors"
            print(f"{count} inputs in {chosen.folder}; {answer}")
        else:
            check_outputs(chosen.folder, form=chosen.form)
            print(f"conforms: {len(golden_vectors(chosen.form))} vectors")
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
