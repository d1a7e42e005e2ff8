"""Make the links and pictures of the README absolute, as PyPI needs them: it shows neither relative pictures nor files.
And put the addresses of the project into its metadata, for PyPI and for the crate.

    python tools/pypi_readme.py https://HOST/OWNER/PROJECT REVISION

changes README.md, pyproject.toml and rust/core/Cargo.toml in place. The workflow *Wheels* runs it with its own
repository and revision before it builds; nobody else has to, and the change is not for committing. A picture becomes
.../raw/REVISION/..., a file .../blob/REVISION/...
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

_LINK = re.compile(r"(?P<picture>!?)\[(?P<text>[^\]]*)\]\((?P<target>[^)\s]+)\)")


def absolute(text: str, repository: str, revision: str) -> str:
    """Return a page of Markdown with each relative link and picture made absolute; code blocks are left as they are.

    >>> absolute("![a fit](docs/fit.png), [MIT](LICENSE), [there](https://a.org/)", "https://host/me/phugoid", "v1")
    '![a fit](https://host/me/phugoid/raw/v1/docs/fit.png), [MIT](https://host/me/phugoid/blob/v1/LICENSE), [there](https://a.org/)'
    """

    def changed(link: re.Match[str]) -> str:
        target = link["target"]
        if re.match(r"[a-z]+:|#", target):
            return link[0]
        kind = "raw" if link["picture"] else "blob"
        return f"{link['picture']}[{link['text']}]({repository.rstrip('/')}/{kind}/{revision}/{target})"

    pieces = re.split(r"(^```.*?^```$)", text, flags=re.M | re.S)
    return "".join(piece if piece.startswith("```") else _LINK.sub(changed, piece) for piece in pieces)


def with_addresses(metadata: str, repository: str, revision: str) -> str:
    """Return the text of pyproject.toml with the addresses of the project, in place of those that it has.

    >>> print(with_addresses('[project]\\nname = "phugoid"\\n', "https://host/me/phugoid/", "v1"))
    [project]
    name = "phugoid"
    <BLANKLINE>
    [project.urls]
    Repository = "https://host/me/phugoid"
    Changelog = "https://host/me/phugoid/blob/v1/CHANGELOG.md"
    Issues = "https://host/me/phugoid/issues"
    <BLANKLINE>
    """
    address = repository.rstrip("/")
    urls = {
        "Repository": address,
        "Changelog": f"{address}/blob/{revision}/CHANGELOG.md",
        "Issues": f"{address}/issues",
    }
    others = re.sub(r"^\[project\.urls\]\n(?:[^\[\n].*\n|\n)*", "", metadata, flags=re.M)
    lines = "".join(f'{name} = "{url}"\n' for name, url in urls.items())
    return f"{others.rstrip()}\n\n[project.urls]\n{lines}"


def with_repository(metadata: str, repository: str, _revision: str) -> str:
    """Return the text of the crate's Cargo.toml with the address of the project, beneath its licence.

    >>> with_repository('license.workspace = true', "https://host/me/phugoid/", "v1").splitlines()
    ['license.workspace = true', 'repository = "https://host/me/phugoid"']
    """
    others = re.sub(r"^repository\b.*\n", "", metadata, flags=re.M)
    return re.sub(r"^license\b.*$", rf'\g<0>\nrepository = "{repository.rstrip("/")}"', others, count=1, flags=re.M)


def main(arguments: list[str]) -> int:
    """Change the files, or say how this is called."""
    if len(arguments) != 2 or not re.match(r"https?://[^/]+/.+", arguments[0]):
        print(__doc__, file=sys.stderr)
        return 2
    changes = {"README.md": absolute, "pyproject.toml": with_addresses, "rust/core/Cargo.toml": with_repository}
    for name, change in changes.items():
        file = ROOT / name
        file.write_text(change(file.read_text(encoding="utf-8"), *arguments), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
