"""`tf-mpc cite`: the software and the paper, as BibTeX."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import yaml

# In a checkout, and in the wheel.
_PLACES = (Path(__file__).parents[3] / "CITATION.cff", Path(__file__).parents[2] / "configs" / "CITATION.cff")


@click.command()
def cite() -> None:
    """Print BibTeX of this software and of the paper that it implements; CITATION.cff has the same for services.

    Say with results which version you used (tf-mpc --version), and the command: a run's manifest.json has both.
    """
    file = next(path for path in _PLACES if path.exists())
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    papers = [(paper, "unpublished", "thermoforce") for paper in content["references"]]
    for entry, kind, key in ((content, "software", "thermoforce-mpc"), *papers):
        click.echo(bibtex(entry, kind, key))


def bibtex(entry: dict[str, Any], kind: str, key: str) -> str:
    """One entry of CITATION.cff as BibTeX."""
    authors = [
        one["name"] if "name" in one else f"{one['family-names']}, {one['given-names']}" for one in entry["authors"]
    ]
    # An entity's name in braces is no given and family name.
    names = " and ".join(f"{{{name}}}" if "," not in name else name for name in authors)
    fields = {
        "author": names,
        "title": f"{{{entry['title']}}}",
        "year": str(entry["date-released"])[:4] if "date-released" in entry else entry.get("year"),
        "version": entry.get("version"),
        "license": entry.get("license"),
        "note": entry.get("notes"),
    }
    lines = [f"  {name} = {{{value}}}," for name, value in fields.items() if value is not None]
    return "\n".join([f"@{kind}{{{key},", *lines, "}"])
