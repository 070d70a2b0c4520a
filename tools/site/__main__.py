"""Build the site strictly and check it: `python -m tools.site`; exit code 1 and a line for each thing that is wrong."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tools.site.check import of_markdown, of_site

ROOT = Path(__file__).resolve().parents[2]


def main() -> int:
    """Build into site/ and print what is wrong."""
    # Without --clean, pages whose Markdown did not change would keep what the program said before.
    built = subprocess.run([sys.executable, "-m", "zensical", "build", "--strict", "--clean"], cwd=ROOT, check=False)
    if built.returncode:
        return 1
    pages = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
    wrong = [*of_site(ROOT / "site"), *of_markdown(ROOT, pages)]
    print("\n".join(wrong) or f"site/: {len(pages) - 2} pages, links, anchors and files are right")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
