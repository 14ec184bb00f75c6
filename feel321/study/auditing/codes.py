"""The end of a chain of checkpoints as a code to print, or to write into a lab book: `0031-7QZK-...`.

Crockford's base 32 (no I, L, O or U) in groups of four, with his check symbol modulo 37 at the end, which detects any
single wrong character and any swap of two. Four characters give the number of lines, sixteen the first 80 bits of the
digest of the last line.
"""

from feel321.study.auditing.checkpoints import Tip

ALPHABET = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"
CHECK = ALPHABET + "*~$=U"
LINES, DIGITS = 4, 16
GROUP = 4


def write_code(tip: Tip) -> str:
    """Write the end of a chain as a code.

    Examples
    --------
    >>> write_code(Tip("", 3, "ff" * 32, ""))
    '0003-ZZZZ-ZZZZ-ZZZZ-ZZZZ-R'
    """
    value = (tip.lines << (5 * DIGITS)) | int(tip.sha256[: DIGITS * 5 // 4], 16)
    count = LINES + DIGITS
    text = "".join(ALPHABET[value >> (5 * place) & 31] for place in reversed(range(count)))
    groups = [text[at : at + GROUP] for at in range(0, count, GROUP)]
    return "-".join([*groups, CHECK[value % len(CHECK)]])


def read_code(code: str) -> tuple[int, str]:
    """Read a code: the number of lines, and the first digits of the digest of the last."""
    text = code.upper().translate(str.maketrans("OIL", "011", "- \t"))
    body, mark = text[:-1], text[-1:]
    if len(text) != LINES + DIGITS + 1 or not set(body) <= set(ALPHABET):
        raise ValueError(
            f"code: got {code!r}, a code has {LINES + DIGITS + 1} letters and digits besides hyphens; copy it again"
        )
    value = 0
    for letter in body:
        value = value * len(ALPHABET) + ALPHABET.index(letter)
    if CHECK[value % len(CHECK)] != mark:
        raise ValueError(f"code: got {code!r}, in which a character is wrong; copy it again")
    lines, digits = divmod(value, 1 << (5 * DIGITS))
    return lines, f"{digits:0{DIGITS * 5 // 4}x}"
