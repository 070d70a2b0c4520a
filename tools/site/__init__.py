"""The documentation site: `python -m tools.site` builds it in strict mode into site/ and checks the result."""
