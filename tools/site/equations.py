"""A hook of mkdocs: LaTeX between dollars becomes MathML, which browsers draw without a script."""

from __future__ import annotations

import re
from typing import Any

from latex2mathml.converter import convert

_CODE = re.compile(r"(```.*?```|`[^`\n]*`)", re.DOTALL)
_BLOCK = re.compile(r"\$\$(.+?)\$\$", re.DOTALL)
_INLINE = re.compile(r"\$(?=\S)([^$\n]+?)(?<=\S)\$")


def on_page_markdown(markdown: str, **_page: Any) -> str:
    """The page's text with its equations drawn; code stays as it is."""
    parts = _CODE.split(markdown)
    parts[::2] = (_drawn(text) for text in parts[::2])
    return "".join(parts)


def _drawn(text: str) -> str:
    text = _BLOCK.sub(lambda found: convert(found[1].strip(), display="block"), text)
    return _INLINE.sub(lambda found: convert(found[1]), text)
