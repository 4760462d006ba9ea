"""The kernels' lint: every rule fires on what breaks on a board, and on nothing else."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SCRIPT = ROOT / "tools" / "lint" / "kernels.py"

sys.path.insert(0, str(SCRIPT.parent))
try:
    import kernels
finally:
    sys.path.pop(0)

HEAD = """
from solenav_core.compat import const, micropython, ptr8, ptr32
from solenav_core.qmath import div
import math

_TOP = const(0x3FFFFFFF)
_HUGE = const(1 << 30)
PLAIN = 7


@micropython.viper
def own(x: int) -> int:
    return x


@micropython.viper
"""


def rules(kernel: str) -> list[str]:
    """The rules that a kernel breaks."""
    return [finding.rule for finding in kernels.lint(HEAD + kernel, "k.py")]


def body(*lines: str) -> str:
    """A kernel of these lines with numbers a, b, words s, bytes d."""
    inner = "".join(f"    {line}\n" for line in lines)
    return f"def kernel(s: ptr32, d: ptr8, a: int, b: int) -> int:\n{inner}"


def returning(expression: str) -> str:
    return body(f"return {expression}")


CASES = [
    ("negation", returning("-a"), returning("0 - a")),
    ("negation", returning("~s[a]"), returning("-1 - s[a]")),
    ("negation", returning("a * -b"), returning("a * -_TOP")),
    ("literal", returning("a + 0x40000000"), returning("a + 0x3FFFFFFF")),
    ("literal", returning("a + (1 << 30)"), returning("a + (1 << b)")),
    ("literal", returning("a & _HUGE"), returning("a & _TOP")),
    ("literal", returning("a + (_TOP + 1)"), returning("a + _TOP + 1")),
    ("shift", returning("a >> 32"), returning("a >> 31")),
    ("shift", returning("a << -1"), returning("a << b")),
    ("operator", returning("a / 2"), returning("a // 2")),
    ("operator", returning("a ** 2"), returning("a * a")),
    ("division", returning("a // b"), body("if b <= 0:", "    return 0", "return a // b")),
    ("division", returning("a % b"), returning("a % (b | 1)")),
    ("division", returning("a // 0"), returning("a // 24")),
    (
        "division",
        body("if b <= 0:", "    return 0", "b = b >> 1", "return a // b"),
        body("if b < 2:", "    return 0", "b = b >> 1", "return a // b"),
    ),
    (
        "division",
        body("if b < 0:", "    b = 1", "return a // b"),
        body("if b < 1:", "    b = 1", "return a // b"),
    ),
    (
        "division",
        body("while b > 0:", "    b = b - 1", "    a = a // b", "return a"),
        body("while b > 0:", "    a = a // b", "    b = b - 1", "return a"),
    ),
    (
        "division",
        body("if b > 0 or a > 0:", "    return a // b", "return 0"),
        body("if a > 3 and not b < 1:", "    return a // b", "return 0"),
    ),
    ("division", returning("a // b  # never 0"), returning("a // b  # > 0: weights sum to 1")),
    ("mask", body("d[0] = a", "return 0"), body("d[0] = a & 255", "return 0")),
    ("mask", body("d[0] = 256", "return 0"), body("d[0] = 255", "return 0")),
    (
        "mask",
        body("c = d[1]", "c = c + 1", "d[0] = c", "return 0"),
        body("c = d[1]", "c = (c >> 4) ^ d[2]", "d[0] = c", "return 0"),
    ),
    ("mask", body("d[0] += 1", "return 0"), body("s[0] += 1", "return 0")),
    ("index", body("s[0:2] = a", "return 0"), body("s[0] = a", "return 0")),
    ("index", returning("s[-1]"), returning("s[b - 1]")),
    ("type", returning("s + 4"), returning("s[4]")),
    ("type", returning("a[4]"), body("c = s", "return c[4]")),
    (
        "type",
        body("c = ptr32(a)", "c = 0", "return int(c == 0)"),
        body("c = ptr32(a)", "return c[0]"),
    ),
    (
        "annotation",
        "def kernel(a) -> int:\n    return a\n",
        "def kernel(a: int) -> int: return a\n",
    ),
    (
        "annotation",
        "def kernel(a: int):\n    return a\n",
        "def kernel(p: ptr8) -> int: return p[0]\n",
    ),
    ("uint", "def kernel(a: uint) -> int:\n    return 0\n", returning("a")),
    ("uint", returning("uint(a)"), returning("int(a)")),
    ("arguments", "def kernel(a: int = 1) -> int:\n    return a\n", returning("a")),
    ("arguments", "def kernel(*a: int) -> int:\n    return 0\n", returning("a")),
    ("arguments", "def kernel(*, a: int) -> int:\n    return 0\n", returning("a")),
    ("arguments", returning("int(own(x=a))"), returning("int(own(a))")),
    (
        "arguments",
        f"def kernel({', '.join(f'a{i}: int' for i in range(11))}) -> int: return 0\n",
        f"def kernel({', '.join(f'a{i}: int' for i in range(10))}) -> int: return 0\n",
    ),
    ("return", body("a = b"), body("a = b", "return a")),
    ("return", body("return"), body("return 0")),
    (
        "return",
        body("if a:", "    return 1"),
        body("if a:", "    return 1", "else:", "    return 0"),
    ),
    (
        "return",
        body("while True:", "    if a:", "        break", "    a = a + 1"),
        body("while True:", "    if a:", "        return a", "    a = a + 1"),
    ),
    ("return", body("while a:", "    return 1"), body("while a:", "    return 1", "return 0")),
    ("unassigned", body("if a:", "    c = 1", "return c"), body("c = 0", "return c")),
    (
        "unassigned",
        body("if a:", "    c = 1", "else:", "    d[0] = 1", "return c"),
        body("if a:", "    c = 1", "else:", "    return 0", "return c"),
    ),
    (
        "unassigned",
        body("for i in range(a):", "    c = i", "return c"),
        body("c = 0", "for i in range(a):", "    c = i", "return c"),
    ),
    (
        "unassigned",
        body("while a > 0:", "    c = 1", "    a = a - 1", "return c"),
        body("while True:", "    c = 1", "    if a:", "        break", "return c"),
    ),
    ("unassigned", body("c += 1", "return c"), body("c = 1", "c += 1", "return c")),
    ("global", returning("PLAIN"), returning("_TOP")),
    ("global", returning("int(max(a, b))"), returning("int(own(a))")),
    ("global", body("own = div", "return 0"), returning("int(div(a, b, 3))")),
    ("global", body("_TOP = a", "return 0"), body("top = a", "return top")),
    ("cast", returning("own(a)"), returning("int(own(a))")),
    ("cast", body("own(a)", "return 0"), body("int(own(a))", "return 0")),
    ("cast", body("if own(a):", "    return 1", "return 0"), returning("int(own(int(own(a))))")),
    ("bool", returning("a < b"), returning("int(a < b)")),
    ("bool", body("c = not a", "return int(c)"), body("c = int(not a)", "return c")),
    ("bool", returning("(a > b) + 1"), returning("int(a > b) + 1")),
    ("bool", body("s[0] = a and b > 1", "return 0"), body("s[0] = a and b", "return 0")),
    ("bool", returning("True"), returning("1")),
    ("construct", body("def f():", "    return 1", "return a"), returning("a")),
    ("construct", body("f = lambda: 1", "return a"), returning("a")),
    ("construct", body("yield a", "return 0"), returning("a")),
    ("construct", body("if a is None:", "    return 0", "return 1"), returning("int(a == 0)")),
    ("construct", body("try:", "    a = 1", "finally:", "    a = 2", "return a"), returning("a")),
    ("construct", body("with a:", "    a = 2", "return a"), returning("a")),
    ("construct", body("a, b = b, a", "return a"), body("c = a", "a = b", "b = c", "return b")),
    ("construct", body("s[0] = s[1] = 0", "return 0"), body("s[0] = 0", "s[1] = 0", "return 0")),
    ("construct", body("for i in s:", "    a = i", "return a"), returning("a")),
    ("construct", returning("1.5"), returning("1")),
    ("construct", returning("a + math.pi"), returning("a + 3")),
]


@pytest.mark.parametrize(("rule", "bad", "good"), CASES)
def test_a_rule_fires_on_the_bad_form_only(rule: str, bad: str, good: str) -> None:
    assert rule in rules(bad)
    assert rules(good) == []


def test_every_rule_has_a_case() -> None:
    fired = re.findall(r'self\.found\(\s*[\w.\[\]-]+,\s*"(\w+)"', SCRIPT.read_text("utf-8"))
    assert set(fired) == {rule for rule, _bad, _good in CASES}


def test_a_finding_says_where_and_what_to_write_instead() -> None:
    line = HEAD.count("\n") + 2
    (finding,) = kernels.lint(HEAD + returning("-a"), "k.py")
    assert str(finding) == f"k.py:{line}: negation: 0 - a"


def test_only_kernels_are_read() -> None:
    assert kernels.lint("def plain(a=1, *b):\n    return -a / 2\n", "k.py") == []


def test_what_is_unreachable_is_read_too() -> None:
    assert rules(body("return 0", "return -a")) == ["negation"]


def test_the_script_lists_findings_and_fails(tmp_path: Path) -> None:
    bad = tmp_path / "bad.py"
    bad.write_text(HEAD + returning("a // b"), encoding="utf-8")
    done = subprocess.run([sys.executable, SCRIPT, bad], capture_output=True, text=True)
    assert done.returncode == 1
    assert "bad.py:" in done.stdout and ": division: " in done.stdout


def test_core_and_firmware_have_no_findings() -> None:
    done = subprocess.run([sys.executable, SCRIPT], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
