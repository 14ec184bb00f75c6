"""The key of a rig: Ed25519, outside every study, with mode 0600; its public half stands beside the anchors.

A passphrase comes from the environment (`FEEL321_KEY_PASSPHRASE`) or from a prompt, never from an option.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from feel321 import files

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

PASSPHRASE = "FEEL321_KEY_PASSPHRASE"  # noqa: S105 - the variable's name
KEY_FILE = "rig.key"


def make_key(path: Path, *, passphrase: str = "") -> str:
    """Make a rig's key where none is yet, and return its fingerprint; its public half is put beside it."""
    from cryptography.hazmat.primitives import serialization as forms
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    if any((parent / "study.toml").is_file() for parent in path.absolute().parents):
        raise ValueError(f"{path}: must not be in a study's folder, which is copied and shared")
    files.make_folder(path.parent)
    key = Ed25519PrivateKey.generate()
    lock = (
        forms.BestAvailableEncryption(passphrase.encode()) if passphrase else forms.NoEncryption()
    )
    content = key.private_bytes(forms.Encoding.PEM, forms.PrivateFormat.PKCS8, lock)
    try:
        descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
    except FileExistsError:
        raise FileExistsError(f"{path}: already exists; a rig keeps its key") from None
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)
        os.fsync(file.fileno())
    public = export_public(key)
    files.write_text(path.with_suffix(".pub"), f"{public}\n")
    return name_key(public)


def open_key(path: Path, *, passphrase: str = "") -> Ed25519PrivateKey:
    """Open a rig's key."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    given = passphrase or os.environ.get(PASSPHRASE, "")
    try:
        key = load_pem_private_key(path.read_bytes(), given.encode() or None)
    except FileNotFoundError:
        raise FileNotFoundError(
            f"{path}: no key there; make one: feel321 seal --make-key"
        ) from None
    except (TypeError, ValueError) as error:
        reason = "needs another passphrase" if given else f"needs its passphrase ({PASSPHRASE})"
        raise ValueError(f"{path}: {reason}, or is no key") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise TypeError(f"{path}: must be an Ed25519 key; make one: feel321 seal --make-key")
    return key


def export_public(key: Ed25519PrivateKey) -> str:
    """Return the public half of a key, in hexadecimal digits."""
    return key.public_key().public_bytes_raw().hex()


def name_key(public: str) -> str:
    """Return the fingerprint by which people know a key."""
    from feel321.study.session.journal import digest

    return digest(bytes.fromhex(public))[:16]


def is_signed(content: bytes, signature: str, public: str) -> bool:
    """Check a signature."""
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    try:
        Ed25519PublicKey.from_public_bytes(bytes.fromhex(public)).verify(
            bytes.fromhex(signature), content
        )
    except (InvalidSignature, ValueError):
        return False
    return True
