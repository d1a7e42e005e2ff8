"""Files written whole or not at all, and checksums that detect damage."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from os import PathLike
from pathlib import Path
from threading import get_ident
from typing import Any

from .errors import DataError, OptionError

__all__ = [
    "CHECKSUM",
    "PAGES",
    "check_folder",
    "check_suffix",
    "checksum",
    "drawn",
    "read_text",
    "sealed",
    "unsealed",
    "write",
]

PAGES = (".html", ".htm")
"""Suffixes of a page."""

CHECKSUM = "checksum"
"""The key of a document's checksum."""


def write(path: str | PathLike[str], content: bytes | str, what: str = "the file") -> None:
    """Write a file whole: what was there before stays until the new one is complete on the disk.

    The content goes to a temporary file beside, which then takes the name (POSIX ``rename``); nothing is left of it
    where that fails. Text is written as UTF-8. A link is followed, the file behind it replaced, its permissions kept.

    Raises DataError, which says ``what`` could not be written and why: a full disk, a folder without permission, ...
    """
    temporary = None
    try:
        data = content.encode("utf-8") if isinstance(content, str) else content
        check_folder(path)
        target = Path(path).resolve()
        if target.exists() and not target.is_file():  # a device or a pipe, such as /dev/stdout, has no old content
            with open(target, "wb") as stream:
                stream.write(data)
            return
        temporary = target.with_name(f".phugoid-{os.getpid()}-{get_ident()}.tmp")
        with open(temporary, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if target.exists():
            temporary.chmod(target.stat().st_mode)
        os.replace(temporary, target)
        temporary = None
    except UnicodeEncodeError as error:
        raise DataError(f"{path}: {what} cannot be written: it holds text that is not Unicode ({error})") from None
    except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a zero byte in the name
        if isinstance(error, DataError):
            raise
        why = getattr(error, "strerror", None) or error
        raise DataError(f"{path}: {what} cannot be written ({why}); nothing was changed there") from error
    finally:
        if temporary is not None:
            with suppress(OSError):  # the first error says why
                temporary.unlink(missing_ok=True)


def check_folder(path: str | PathLike[str]) -> None:
    """Raise DataError where the folder of a file to be written does not exist."""
    folder = Path(path).resolve().parent
    if not folder.is_dir():
        raise DataError(f"{path}: cannot be saved, since there is no folder {folder}")


def check_suffix(path: str | PathLike[str], known: Sequence[str], what: str) -> None:
    """Raise OptionError where a file has none of the suffixes known.

    Folders and devices pass: writing to them says what is wrong, if anything is.
    """
    target = Path(path)
    if target.suffix.lower() not in known and (target.is_file() or not target.exists()):
        such = "" if target.suffix else f", such as {target.name}{known[0]}"
        raise OptionError(f"{path}: {what} is written to a file that ends in {' or '.join(known)}{such}")


def drawn(figure: Any, path: str | PathLike[str], **options: Any) -> bytes:
    """Return a figure of matplotlib as the content of a file with the suffix of ``path``."""
    from io import BytesIO

    content = BytesIO()
    figure.savefig(content, format=Path(path).suffix[1:].lower() or None, **options)
    return content.getvalue()


def checksum(document: Any) -> str:
    """Return the SHA-256 of a JSON document's content; spaces and the order of keys do not matter."""
    from hashlib import sha256  # not at import: it takes its time

    text = json.dumps(document, sort_keys=True, ensure_ascii=True, separators=(",", ":"))
    return f"sha256:{sha256(text.encode()).hexdigest()}"


def sealed(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the document with its checksum as the last entry."""
    content = {key: value for key, value in document.items() if key != CHECKSUM}
    return {**content, CHECKSUM: checksum(content)}


def unsealed(document: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Return the document without its checksum. One without any, of an earlier release, is taken as it is.

    Raises DataError, in the name of ``source``, where the checksum is not that of the content.
    """
    content = {key: value for key, value in document.items() if key != CHECKSUM}
    if CHECKSUM in document and document[CHECKSUM] != checksum(content):
        raise DataError(
            f"{source}: is damaged, or was changed after it was saved (its checksum is not that of its content); save "
            f"it again, or take out the entry '{CHECKSUM}' to have it read as it is"
        )
    return content


def read_text(path: str | PathLike[str]) -> str:
    """Return the text of a file in UTF-8; raise DataError where it cannot be read."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or 'it is not text'})") from error
