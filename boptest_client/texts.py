"""Text from elsewhere, made safe to show."""

from __future__ import annotations

import unicodedata

# Controls, marks that turn the direction of writing, halves of characters, and separators of lines.
_UNSAFE = ("Cc", "Cf", "Cs", "Zl", "Zp")
_MOST = 500


def safe_text(text: object, most: int = _MOST) -> str:
    """`text` without control characters but line breaks and tabs, so that a terminal shows it and does nothing else.

    Longer text is cut to `most` characters, and how many were left out is said.
    """
    whole = str(text)
    kept = "".join(
        character for character in whole[:most] if character in "\n\t" or unicodedata.category(character) not in _UNSAFE
    )
    return kept if len(whole) <= most else f"{kept} … ({len(whole) - most:,} more characters left out)"
