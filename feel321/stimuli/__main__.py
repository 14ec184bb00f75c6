"""`python -m feel321.stimuli`: golden vectors for reducers in another language; the same as `feel321 port`."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from feel321.stimuli.conform_stream import OPEN_PHASE, STREAMING
from feel321.stimuli.port import FORMS, READ_ME, check_port, write_port


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the vectors as files, or check a port's answers."""
    chosen = _make_parser().parse_args(arguments)
    given = {"form": chosen.form, "reducer": chosen.reducer}
    try:
        if chosen.verb == "write-vectors":
            count = len(write_port(chosen.folder, **given))
            print(
                f"{count} inputs in {chosen.folder}; answer them as {READ_ME} says, then: check-vectors"
            )
        else:
            found = check_port(chosen.folder, **given)
            print("\n".join([f"conforms: {found.vectors} vectors", *found.notes]))
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def _make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m feel321.stimuli",
        description=__doc__,
        epilog="Example: python -m feel321.stimuli write-vectors DIR; then your port; then check-vectors DIR",
    )
    parser.add_argument("verb", choices=("write-vectors", "check-vectors"))
    parser.add_argument("folder", type=Path)
    form = "which form the port implements; streaming: block by block, see vectors.json"
    parser.add_argument("--form", choices=FORMS, default="whole", help=form)
    reducer = "which streaming reducer the port implements"
    parser.add_argument("--reducer", choices=STREAMING, default=OPEN_PHASE, help=reducer)
    return parser


if __name__ == "__main__":
    sys.exit(main())
