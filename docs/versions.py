"""Lead into the folders of a site, one a version: python docs/versions.py SITE.

``SITE/versions.js`` names them for the list on every page. ``SITE/stable/`` and ``SITE/index.html``
lead to the newest that is no pre-release.
"""

import json
import re
import sys
from pathlib import Path

REDIRECT = (
    '<!doctype html><html lang="en"><meta charset="utf-8"><title>truejoint</title>'
    '<meta http-equiv="refresh" content="0; url={0}"><p><a href="{0}">{0}</a></p></html>\n'
)


def order(version: str) -> tuple[bool, list[int]]:
    """Order of versions: releases above pre-releases, then by their numbers."""
    return not re.search("[a-z]", version), [int(number) for number in re.findall(r"\d+", version)]


def write(site: Path) -> None:
    """Write the list of versions, and pages that lead to the stable one."""
    found = (path.parent.name for path in site.glob("[0-9]*/index.html"))
    versions = sorted(found, key=order, reverse=True)
    (site / "versions.js").write_text(f"window.versions = {json.dumps(versions)};\n")
    newest = versions[0]
    (site / "index.html").write_text(REDIRECT.format(f"{newest}/index.html"))
    for page in (site / newest).rglob("*.html"):
        name = page.relative_to(site / newest)
        target = site / "stable" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        up = "../" * len(name.parts)
        target.write_text(REDIRECT.format(f"{up}{newest}/{name.as_posix()}"))


if __name__ == "__main__":
    write(Path(sys.argv[1]))
