"""Text from elsewhere, as it is shown."""

from __future__ import annotations

import pytest

from boptest_client import safe_text


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain, °C and 中文\n\tof two lines", "plain, °C and 中文\n\tof two lines"),
        ("\x1b]0;title\x07\x1b[2Jgone", "]0;title[2Jgone"),
        ("\x9b31m, \x7f and \x00", "31m,  and "),
        ("over\rwritten", "overwritten"),
        ("\u202eright to left, \u2028 lines", "right to left,  lines"),
        ("half \ud800", "half "),
        (7, "7"),
    ],
)
def test_what_a_terminal_would_act_on_is_left_out(text, shown):
    assert safe_text(text) == shown
    safe_text(text).encode()


def test_long_text_is_cut_and_how_much_is_said():
    assert safe_text("x" * 500) == "x" * 500
    assert safe_text("x" * 1750) == "x" * 500 + " … (1,250 more characters left out)"
