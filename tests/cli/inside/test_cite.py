"""`tf-mpc cite`: BibTeX that names this version and the paper."""

from pathlib import Path

import yaml
from click.testing import CliRunner

from thermoforce_mpc.cli import cli

ROOT = Path(__file__).parents[3]


def test_the_software_and_the_paper_are_cited():
    done = CliRunner().invoke(cli, ["cite"])
    assert done.exit_code == 0, done.output
    version = next(line for line in (ROOT / "pyproject.toml").read_text().splitlines() if line.startswith("version"))
    assert f"version = {{{version.split(chr(34))[1]}}}," in done.output, "of CITATION.cff, as of the package"
    assert "@software{thermoforce-mpc,\n  author = {{The thermoforce-mpc maintainers}}," in done.output
    assert "author = {Wang, Yifan}," in done.output
    assert done.output.count("year = {2026}") == 2


def test_the_citation_file_has_what_services_need():
    content = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors", "version", "license", "date-released"} <= content.keys()
