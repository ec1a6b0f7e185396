"""Recognition of files and pictures by their first bytes."""

from __future__ import annotations

_PICTURES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg"}
_FORMATS = {
    b"PK": "a zip archive such as .npz",
    b"\x93NUMPY": "a NumPy .npy array",
    b"glTF": "a binary glTF",
    b"PXR-USDC": "a binary USD",
    b"#usda": "a text USD",
    b"Kaydara FBX": "an FBX file",
    b"Ogawa": "an Alembic file",
    b"ply": "a PLY file",
    b"\x1f\x8b": "gzip data",
    b"\x89PNG": "a PNG picture",
    b"\xff\xd8\xff": "a JPEG picture",
    b"\x80": "a Python pickle",
}


def describe(head: bytes) -> str:
    """Phrase for error messages that says which format the first bytes of a file look like."""
    if not head:
        return "the file is empty"
    for magic, name in _FORMATS.items():
        if head.startswith(magic):
            return f"it looks like {name}"
    text = all(32 <= b < 127 or b in b"\t\r\n" for b in head)
    return "it looks like text" if text else "its first bytes belong to no format known here"


def picture_type(data: bytes) -> str | None:
    """MIME type of PNG or JPEG data, or None for any other data."""
    return next((kind for magic, kind in _PICTURES.items() if data.startswith(magic)), None)
