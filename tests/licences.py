"""docs/licences.md: under which licence each package is that `make install` brings.

make sbom        write it anew, from what pip-licenses says of an environment of requirements.lock
"""

import json
import sys
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs/licences.md"
_HEAD = """# Licences of what is installed

Under which licence is each package that `make install` brings, and does any of them ask something
of me?

lbgc is Apache-2.0, and its wheel holds nobody else's code: whoever installs it fetches these
packages from their makers. None is under the GPL or the AGPL.

- **MIT, BSD, Apache-2.0, PSF-2.0, 0BSD and their like** ask that their notices are kept.
- **MPL-2.0** (certifi, hypothesis, pathspec, tqdm) asks that changes to their own files are open.
- **LGPL-3.0-or-later** (AllanTools) asks that it can be replaced by another version. lbgc imports
  it as it is, for the Allan deviations of a log.
- NumPy's, SciPy's and PyTorch's files bring GCC's runtime libraries along: GPL-3.0 with the
  exception that lets any program be linked with them; and `libquadmath`, LGPL-2.1-or-later.
- PyTorch's build with CUDA, for which there is [a lock](../requirements-cuda.lock) of its own,
  asks for NVIDIA's libraries. They are not open source: NVIDIA's own terms hold. They are not in
  the table.

The table is of the build without CUDA, as the packages themselves say; where what they say is no
name of a licence, or not all of it, it was read in their files (marked *). It is written by
`make sbom`, as is [sbom.cdx.json](sbom.cdx.json): the same packages as a software bill of materials
(CycloneDX 1.6), with what needs what.
"""
READ = {
    "AllanTools": "LGPL-3.0-or-later",
    "antlr4-python3-runtime": "BSD-3-Clause",
    "apsw": "Zlib, or any licence that the OSI approves",
    "docutils": "public domain, parts BSD-2-Clause and BSD-3-Clause; its GPL file is not installed",
}
"""What was read in the files of packages, or at their makers', whose metadata do not say it."""


def page(found: list[dict[str, str]]) -> str:
    """The page, of packages as pip-licenses lists them. Raises ValueError where one states no
    licence, or one that nobody has read."""
    rows = []
    for package in sorted(found, key=lambda package: package["Name"].lower()):
        name, licence = package["Name"], package["License"]
        read = READ.get(name)
        if read is None and (licence == "UNKNOWN" or "\n" in licence or "GPL" in licence):
            raise ValueError(f"{name} says of its licence: {licence[:80]!r}; read it, then READ")
        said = licence if read is None else f"{read} *"
        rows.append(f"| {name} | {package['Version']} | {said} |")
    return "\n".join([_HEAD, "| package | version | licence |", "|---|---|---|", *rows, ""])


if __name__ == "__main__":
    sys.stdout.write(page(json.load(sys.stdin)))
