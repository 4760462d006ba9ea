"""Write `docs/protocol.md` from the message schema, or check that it is current.

python tools/tables/protocol.py [--check]
"""

from __future__ import annotations

import sys
from pathlib import Path

from generated import keep

from solenav_core import framing, layout, messages, params

TARGET = Path(__file__).resolve().parents[2] / "docs" / "protocol.md"

OPEN = ", ".join(name for kind, name, *_ in messages.MESSAGES if kind in messages.OPEN)
HEAD = f"""# Protocol

Generated from `shared/solenav_core/messages.py` by `tools/tables/protocol.py`; do not edit.

## Frames

A frame is `type u8, seq u8, tick u32, payload, crc16`, little-endian, stuffed by COBS and ended
by one `0x00`. `seq` counts all frames of a sender modulo 256; `tick` is the number of samples
that the navigator has processed. The CRC is CRC-16/CCITT-FALSE over all before it. Its start
value is the schema's hash, here `0x{messages.SCHEMA:04x}`, so a host with another schema sees bad
frames and no wrong poses; {OPEN} start from `0x{framing.STANDARD_SEED:04X}`, so that any two
versions can still tell each other who they are. A payload has at most {framing.PAYLOAD_MAX} bytes.

A capture file (`.solcap`) is `SOLCAP1\\n`, then records `arrival time f64 (s), length u16, bytes`
of what came over the wire.

## Messages

Types: `b B` 8 bits, `h H` 16 bits, `i I` 32 bits, capitals unsigned; `*` bytes up to the end.
`Qn u` is a value in unit `u` times 2^n.
"""


def render() -> str:
    lines = [HEAD]
    for kind, name, when, fields in messages.MESSAGES:
        lines.append(f"### {name} (0x{kind:02x}): {when}\n")
        if not fields:
            continue
        lines += ["| field | type | format | meaning |", "|---|---|---|---|"]
        for field, code, count, form, meaning in fields:
            many = f"{count} `{code}`" if count > 1 else f"`{code}`"
            lines.append(f"| {field} | {many} | {form} | {meaning} |")
        lines.append("")
    lines += ["## Parameters\n", "| # | name | format | meaning |", "|---|---|---|---|"]
    lines += [f"| {i} | {n} | {q} | {m} |" for i, (n, q, m) in enumerate(params.PARAM_FIELDS)]
    lines += [
        "",
        "## State (SNAPSHOT)\n",
        f"{layout.size(layout.STATE_FIELDS)} words of 32 bits.\n",
        "| word | name | words | stage | format |",
        "|---|---|---|---|---|",
    ]
    at = layout.offsets(layout.STATE_FIELDS)
    lines += [f"| {at[n]} | {n} | {w} | {s} | {f} |" for n, w, s, f in layout.STATE_FIELDS]
    return (
        "\n".join(lines).replace("|a|", "&#124;a&#124;").replace("|rate|", "&#124;rate&#124;")
        + "\n"
    )


if __name__ == "__main__":
    sys.exit(keep(TARGET, render()))
