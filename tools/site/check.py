"""Checks of the built site and of Markdown pages: links, anchors, files of the repository, nothing from elsewhere."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

_LOADED = {"script": "src", "img": "src", "iframe": "src", "source": "src", "audio": "src", "video": "src"}
_CSS = re.compile(r"""(?:@import\s*|url\()\s*["']?(https?:)?//""")
_LINK = re.compile(r"(?<!!)\[[^\]]*\]\(([^)\s]+)\)|!\[[^\]]*\]\(([^)\s]+)\)")
_CODE = re.compile(r"`([^`\n]+)`")
# Paths of the repository as they stand in code marks.
_FILE = re.compile(r"(?:thermoforce_mpc|controllers|boptest_client|configs|docs|examples|tests|tools)(?:/[\w.-]+)+/?")

_NO_FILE = re.compile(r"\.\.\.|\*|-v\d\b")  # patterns, and Gymnasium's names of environments


class _Page(HTMLParser):
    """Anchors, links and loaded resources of one HTML page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect what this tag refers to."""
        of = {key: value or "" for key, value in attrs}
        self.anchors |= {of[key] for key in ("id", "name") if key in of}
        if tag == "a" and "href" in of:
            self.links.append(of["href"])
        elif tag == "link" and of.get("rel") not in ("canonical", "prev", "next") and "href" in of:
            self.loaded.append(of["href"])
        elif tag in _LOADED and _LOADED[tag] in of:
            self.loaded.append(of[_LOADED[tag]])


def of_site(site: Path) -> Iterator[str]:
    """Yield what is wrong with a built site: dead links and anchors, resources that a browser would fetch elsewhere."""
    site = site.resolve()
    pages = {path: _Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    if not pages:
        yield f"{site}: no page was built"
    for path, page in pages.items():
        here = path.relative_to(site)
        for url in page.loaded:
            if urlsplit(url).netloc:
                yield f"{here}: loads {url}"
            elif not url.startswith("data:") and not _target(site, path, url).is_file():
                yield f"{here}: loads {url}, which is not there"
        if path.name == "404.html":  # its links are absolute, for a place that is not known
            continue
        for url in page.links:
            parts = urlsplit(url)
            if parts.scheme or parts.netloc:
                continue
            target = _target(site, path, url) if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            if not target.is_file():
                yield f"{here}: dead link {url}"
            elif (
                parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors | {"__top"}
            ):
                yield f"{here}: no such anchor {url}"
    for path in sorted(site.rglob("*.css")):
        if _CSS.search(path.read_text(encoding="utf-8")):
            yield f"{path.relative_to(site)}: loads from elsewhere"


def _target(site: Path, page: Path, url: str) -> Path:
    path = unquote(urlsplit(url).path)
    return (site / path.lstrip("/") if path.startswith("/") else page.parent / path).resolve()


def of_markdown(root: Path, pages: list[Path]) -> Iterator[str]:
    """Yield links of Markdown pages to files that are not there, and code marks that name no file of `root`."""
    for page in pages:
        here = page.relative_to(root)
        text = _without_blocks(page.read_text(encoding="utf-8"))
        for found in _LINK.finditer(text):
            url = urlsplit(found[1] or found[2])
            target = (page.parent / unquote(url.path)).resolve() if url.path else page
            if url.scheme or url.netloc:
                continue
            if not target.exists():
                yield f"{here}: dead link {found[1] or found[2]}"
            elif url.fragment and target.suffix == ".md" and url.fragment not in _headings(target):
                yield f"{here}: no such heading {found[1] or found[2]}"
        for code in _CODE.findall(text):
            for name in _FILE.findall(code):
                if not _NO_FILE.search(code) and not (root / name).exists():
                    yield f"{here}: no file {name}"


def _without_blocks(text: str) -> str:
    return re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)


def _headings(page: Path) -> set[str]:
    """Return the anchors of a Markdown page: those that it names, and those that are made of its headings."""
    from markdown.extensions.toc import slugify

    text = page.read_text(encoding="utf-8")
    titles = re.findall(r"^#+ (.+?)(?: \{.*\})?$", text, flags=re.MULTILINE)
    named = re.findall(r"\{ *#([\w:.-]+) *\}|^\$\$ *([\w:.-]+)$", text, flags=re.MULTILINE)
    return {slugify(re.sub(r"[`*]", "", title), "-") for title in titles} | {one or other for one, other in named}
