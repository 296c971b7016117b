"""Writes THIRD_PARTY.md from the metadata of packages: `python -m docs.make_third_party`."""

from __future__ import annotations

import re
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PAGE = Path(__file__).resolve().parent.parent / "THIRD_PARTY.md"
EXTRAS = ("simulate", "report", "city", "gis", "bags", "viewer", "slam")
HEAD = """# Third-party notices

polemap is under the Apache License 2.0 ([LICENSE](LICENSE)). pip installs the packages below beside
it, each under its own licence, whose text is in the package's `*.dist-info`. "base" is always
installed, the rest with the extra that is named. Made by `make docs` from the packages' metadata.

| package | licence | installed with |
|---|---|---|
"""
_SPDX = (
    (r"apache", "Apache-2.0"), (r"mit\b", "MIT"), (r"bsd[ -]?3", "BSD-3-Clause"),
    (r"bsd[ -]?2", "BSD-2-Clause"), (r"mozilla|mpl", "MPL-2.0"), (r"psf", "PSF-2.0"),
    (r"bsd", "BSD"), (r"lgpl", "LGPL"), (r"isc", "ISC"), (r"zlib", "Zlib"),
)  # fmt: skip


def needed(name: str, extras: tuple[str, ...]) -> set[str]:
    """Names of all packages that an installed one needs with these extras, as far as installed."""
    found: set[str] = set()
    todo = [(name, extras)]
    while todo:
        package, wanted = todo.pop()
        try:
            requirements = distribution(package).requires or []
        except PackageNotFoundError:
            continue
        for text in requirements:
            requirement = Requirement(text)
            environment = {**default_environment(), "extra": ""}
            applies = requirement.marker is None or any(
                requirement.marker.evaluate({**environment, "extra": extra})
                for extra in (wanted or ("",))
            )
            key = canonicalize_name(requirement.name)
            if applies and key != "polemap" and key not in found:
                found.add(key)
                todo.append((key, tuple(requirement.extras)))
    return found


def licence_of(package: Distribution) -> str:
    """The licence as the metadata says it, in few words."""
    expression = package.metadata.get("License-Expression")
    if expression:
        return expression
    classified = [
        text.rpartition(" :: ")[2]
        for text in package.metadata.get_all("Classifier") or []
        if text.startswith("License ::") and not text.endswith("OSI Approved")
    ]
    stated = (package.metadata.get("License") or "").strip().partition("\n")[0]
    text = " / ".join(classified) or stated
    if not text or len(text) > 60:
        text = next((spdx for form, spdx in _SPDX if re.search(form, text.lower())), "")
    return text or "see its dist-info"


def page() -> str:
    """The text of the page."""
    groups = {"base": needed("polemap", ())}
    for extra in EXTRAS:
        groups[extra] = needed("polemap", (extra,)) - groups["base"]
    lines = []
    for name in sorted(set().union(*groups.values())):
        try:
            package = distribution(name)
        except PackageNotFoundError:
            continue
        with_ = ", ".join(group for group, names in groups.items() if name in names)
        lines.append(f"| {package.metadata['Name']} | {licence_of(package)} | {with_} |")
    return HEAD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
