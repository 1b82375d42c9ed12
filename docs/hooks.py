"""Formulas as MathML, which browsers draw themselves: no script, no font, no network."""

import html
import re

from latex2mathml.converter import convert

_FORMULA = re.compile(r'<(div|span) class="arithmatex">\s*\\[\[(](.*?)\\[\])]\s*</\1>', re.S)


def on_page_content(content: str, **_) -> str:
    """Called by MkDocs for each page: replace TeX by MathML."""

    def formula(match: re.Match) -> str:
        display = "block" if match[1] == "div" else "inline"
        return convert(html.unescape(match[2]).strip(), display=display)

    return _FORMULA.sub(formula, content)
