"""Every tuned number of controllers, identification and model says what chose it.

A number counts where it stands at the top of a module, in a class variable, or as the default of a field. What chose it
is said in the comment above it (one comment may speak of the lines below it up to the next comment or empty line),
behind it, or in the string below it. Where that is judgement, it says what the number guards and what it was tried on,
in the comment or by a row of `docs/evidence/constants.csv`, which `python -m benchmarks.constants` measures.
"""

from __future__ import annotations

import ast
import csv
import re
from collections.abc import Iterator, Mapping

import pytest
from places import ROOT

from benchmarks.constants import constants

ROOMS = ("controllers", "thermoforce_mpc/identification", "thermoforce_mpc/model")
# Where something was tried: a day, or a plant, bench, test, page or constant by its name.
TRIED = re.compile(r"20\d\d-\d\d-\d\d|`[^`]+`|\bbench [a-z]|docs/|(drawn|generated|random) (house|machine)|EnergyPlus")
# What somebody else found or laid down.
PUBLISHED = re.compile(r"\b[A-Z][a-z]+( and [A-Z]\w+| et al\.)?,? \(?(19|20)\d\d\b|\b(EN|ISO)\b|\b(eq|fig):\w|paper")
# Numbers of a computer, or of words only: nothing of a building chooses them.
EXACT = re.compile(r"[Rr]ound|[Tt]oleranc|overflow|divided by 0|[Rr]esolution|[Qq]uantile|by definition|[Ww]ords only")
# A reason: what would be else, or what is known of such buildings.
REASON = re.compile(r"[:;] \w|\b(since|because|so that|else|otherwise|would|cannot|must not|usual|twice|thrice|half)\b")
JUDGED = re.compile(r"\b[Bb]y judgement\b")
LEAST_WORDS = 8


def numbers(node: ast.AST) -> list[float]:
    found = (part.value for part in ast.walk(node) if isinstance(part, ast.Constant))
    return [value for value in found if isinstance(value, int | float) and not isinstance(value, bool)]


def default(value: ast.expr) -> ast.AST:
    """What a field begins with: the first argument of pydantic's `Field`, else the value itself."""
    if isinstance(value, ast.Call) and ast.unparse(value.func) == "Field":
        return value.args[0] if value.args else ast.Constant(None)
    return value


def is_start(node: ast.Assign | ast.AnnAssign) -> bool:
    """Whether a field begins at nothing, which no one tunes: 0, 1, or an array of those."""
    text = ast.unparse(node)
    return "ClassVar" not in text and ("default_factory" in text or set(numbers(default(node.value))) <= {0, 1})


def said(lines: list[str], node: ast.stmt) -> str:
    """What comments and the string below say of a statement."""
    found = [line.partition("  # ")[2] for line in lines[node.lineno - 1 : node.end_lineno]]
    row = node.lineno - 2
    while row >= 0 and lines[row].strip() and not lines[row].lstrip().startswith(("#", "class ", "def ", "@", '"""')):
        row -= 1
    while row >= 0 and lines[row].lstrip().startswith("#"):
        found.insert(0, lines[row].strip().lstrip("# "))
        row -= 1
    below = node.end_lineno or node.lineno
    if below < len(lines) and lines[below].lstrip().startswith('"""'):
        found.append("\n".join(lines[below:]).split('"""')[1])
    return re.sub(r"\s+", " ", " ".join(found)).strip()


def numbers_of_code() -> Iterator[tuple[str, list[str], str]]:
    """`file: name`, dotted names, and what is said of them."""
    for file in sorted(file for room in ROOMS for file in (ROOT / room).rglob("*.py")):
        text = file.read_text(encoding="utf-8")
        lines, tree, place = text.splitlines(), ast.parse(text), file.relative_to(ROOT)
        owners = [("", tree), *((node.name + ".", node) for node in tree.body if isinstance(node, ast.ClassDef))]
        for owner, holder in owners:
            for node in holder.body:
                if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None or not numbers(node.value):
                    continue
                if owner and is_start(node):
                    continue
                target = node.targets[0] if isinstance(node, ast.Assign) else node.target
                together = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
                names = [ast.unparse(name) for name in (target.elts if together else [target])]
                module = ".".join(place.with_suffix("").parts)
                dotted = [f"{module}.{owner}{name}" for name in names]
                yield f"{place}: {owner}{', '.join(names)}", dotted, said(lines, node)


def lacks(text: str, measured: bool = False) -> str:
    """What a comment lacks; nothing where it says what chose the number. `measured`: whether the bench ran it."""
    if not text:
        return "no comment"
    rest = JUDGED.sub("", text)
    if rest != text:
        if len(rest.split()) < LEAST_WORDS:
            return "judged, and guards nothing: say against what"
        if measured or TRIED.search(rest) or EXACT.search(rest):
            return ""
        return "judged, and tried on nothing: say on what, or run `python -m benchmarks.constants --only NAME --into …`"
    found = any(source.search(text) for source in (TRIED, PUBLISHED, EXACT, REASON))
    return "" if found else "no source and no reason"


@pytest.fixture(scope="module")
def measured() -> Mapping[str, str]:
    """Values with which the bench ran constants."""
    with (ROOT / "docs" / "evidence" / "constants.csv").open(encoding="utf-8", newline="") as file:
        return {row["constant"]: row["value"] for row in csv.DictReader(file)}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "Share of a step.",
        "By judgement.",
        "Share of it, by judgement.",
        "Longest time, h; by judgement as the others.",
    ],
)
def test_a_phrase_alone_is_no_source(text):
    assert lacks(text)
    assert lacks(text, measured=True)


def test_judgement_names_what_it_guards_and_what_it_was_tried_on():
    text = "Least share of a meter's readings, by judgement: with fewer a night's standby is taken for the law."
    assert lacks(text)
    assert not lacks(text, measured=True)
    assert not lacks(text + " `bench commands` was set up with it.")


def test_every_tuned_number_says_what_chose_it(measured):
    found = list(numbers_of_code())
    assert len(found) > 300
    reasons = {name: lacks(text, measured.keys() >= set(dotted)) for name, dotted, text in found}
    assert {name: why for name, why in reasons.items() if why} == {}


def test_constants_that_were_tried_are_those_of_the_code(measured):
    """Else `python -m benchmarks.constants --only NAME --into docs/evidence/constants.csv` runs one again."""
    now = {constant.place: str(constant.value()) for constant in constants()}
    assert {name: (value, now.get(name, "gone")) for name, value in measured.items() if now.get(name) != value} == {}
