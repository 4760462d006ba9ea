"""A hook of mkdocs: LaTeX between dollars becomes MathML, which browsers draw without a script.

Markdown would take an equation's tags apart, so it sees a word in its place.
"""

from __future__ import annotations

import re
from typing import Any

from latex2mathml.converter import convert

_CODE = re.compile(r"(```.*?```|`[^`\n]*`)", re.DOTALL)
_EQUATION = re.compile(r"\$\$(.+?)\$\$|\$(?=\S)([^$\n]+?)(?<=\S)\$", re.DOTALL)
_WORD = re.compile(r"equation-(\d+)-here")
_drawn: list[str] = []


def on_page_markdown(markdown: str, **_page: Any) -> str:
    """The page's text with a word for each equation; code stays as it is."""
    parts = _CODE.split(markdown)
    parts[::2] = (_EQUATION.sub(_kept, text) for text in parts[::2])
    return "".join(parts)


def on_page_content(html: str, **_page: Any) -> str:
    """The page with its equations drawn."""
    return _WORD.sub(lambda found: _drawn[int(found[1])], html)


def _kept(found: re.Match[str]) -> str:
    block = found[1] is not None
    latex = (found[1] or found[2]).strip()
    _drawn.append(convert(latex, display="block" if block else "inline"))
    return f"equation-{len(_drawn) - 1}-here"
