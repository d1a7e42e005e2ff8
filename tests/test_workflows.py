"""Workflows that no one runs before a release: what they build is tried, and is what the project promises."""

from __future__ import annotations

import re

import pages

WHEELS, MAKEFILE, PYPROJECT = (
    (pages.ROOT / name).read_text(encoding="utf-8")
    for name in (".github/workflows/wheels.yml", "Makefile", "pyproject.toml")
)


def test_every_wheel_that_is_built_is_tried() -> None:
    built = re.findall(r"- \{ name: ([^,]+),", WHEELS)
    tried = re.findall(r"- \{ wheel: ([^,]+),", WHEELS)
    assert len(built) == len({*built}) > 6 and {*built} == {*tried}


def test_wheels_are_tried_at_the_lowest_and_the_newest_python() -> None:
    (lowest,) = re.findall(r'requires-python = ">=([\d.]+)"', PYPROJECT)
    tried = re.findall(r'wheel: ([^,]+), os: [^,]+, python: "([^"]+)", versions: (\w+)', WHEELS)
    assert ("linux-x86_64", lowest, "lowest") in tried
    newest = max((version for _, version, _ in tried if not version.endswith("t")), key=lambda v: int(v.split(".")[1]))
    for system in ("linux-x86_64", "linux-aarch64", "macos-aarch64", "windows-x86_64"):
        assert (system, newest, "newest") in tried, system
    assert ("linux-x86_64-free-threaded", f"{newest}t", "newest") in tried


def test_make_builds_the_wheels_for_linux() -> None:
    (targets,) = re.findall(r"^WHEEL_TARGETS \?= (.*)$", MAKEFILE, flags=re.M)
    built = re.findall(r"target: ([^,]+linux[^,]+), tag: \w+ \}", WHEELS)
    assert {*targets.split()} == {*built}
