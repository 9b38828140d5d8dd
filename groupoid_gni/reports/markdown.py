"""Tables as text that is also Markdown."""

from __future__ import annotations

from collections.abc import Sequence


def markdown_table(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Columns padded to their width, the first to the left and the others to the right."""
    lines = [list(heading), *(list(row) for row in rows)]
    widths = [max(3, *(len(line[i]) for line in lines)) for i in range(len(heading))]

    def shown(cells: Sequence[str]) -> str:
        pairs = list(zip(cells, widths, strict=True))
        padded = [cell.ljust(w) if k == 0 else cell.rjust(w) for k, (cell, w) in enumerate(pairs)]
        return "| " + " | ".join(padded) + " |"

    rule = ["-" * widths[0], *("-" * (w - 1) + ":" for w in widths[1:])]
    return "\n".join([shown(lines[0]), shown(rule), *(shown(line) for line in lines[1:])])
