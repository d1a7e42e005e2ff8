"""Whether a MATLAB 5 file is whole, before scipy reads it: on some damaged tags its loader ends the process.

Source: MathWorks, MAT-File Format, the level 5 format. Compressed variables need no check: zlib has its own.
"""

from __future__ import annotations

import struct

__all__ = ["is_whole"]

_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13})
_KINDS = _NUMBERS | {_MATRIX, _COMPRESSED, 16, 17, 18}
_CHARACTERS, _FIRST_NUMERIC, _LAST_NUMERIC = 4, 6, 15  # classes of arrays


def is_whole(raw: bytes) -> bool:
    """False where a tag in the file names no known type, or more bytes than there are."""
    if len(raw) < 128 or raw[126:128] not in (b"IM", b"MI") or b"\0" in raw[:4]:
        return True  # of another version: scipy tells
    order = "<" if raw[126:128] == b"IM" else ">"
    return _elements(raw, 128, len(raw), order) is not None


def _elements(raw: bytes, start: int, end: int, order: str) -> list[tuple[int, int, int]] | None:
    """Type, first byte and size of each element; None where one cannot be."""
    found = []
    while start < end:
        if start + 8 > end:
            return None
        kind, size = struct.unpack_from(f"{order}II", raw, start)
        first, following = start + 8, start + 8 + (size if kind == _COMPRESSED else -(-size // 8) * 8)
        if kind >> 16:  # up to 4 bytes within the tag itself
            kind, size, first, following = kind & 0xFFFF, kind >> 16, start + 4, start + 8
            if size > 4:
                return None
        if kind not in _KINDS or first + size > end:
            return None
        if kind == _MATRIX and size and not _matrix(raw, first, first + size, order):
            return None
        found.append((kind, first, size))
        start = following
    return found


def _matrix(raw: bytes, start: int, end: int, order: str) -> bool:
    parts = _elements(raw, start, end, order)
    if parts is None or not parts or parts[0][2] != 8:
        return False
    (flags,) = struct.unpack_from(f"{order}I", raw, parts[0][1])
    kind, is_complex = flags & 0xFF, bool(flags & 0x800)
    if _FIRST_NUMERIC <= kind <= _LAST_NUMERIC:
        return len(parts) == 4 + is_complex and all(part[0] in _NUMBERS for part in parts[1:2] + parts[3:])
    return kind != _CHARACTERS or len(parts) == 4
