"""Small linear solves written out as expressions: sparse elimination without pivoting.

The matrices of a step are near a metric (symmetric positive definite), so the diagonal is a safe
pivot and Cramer's rule a safe shortcut for up to three unknowns; a caller that iterates checks its
residual and a caller that does not guards the pivots. CasADi's own symbolic ``solve`` emits 2 to 15
times more operations.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

_MUL, _SUB, _DIV = ca.OP_MUL, ca.OP_SUB, ca.OP_DIV
_binary = ca.SX.binary

Row = dict[int, Any]


def larger(a: ca.SX, b: ca.SX) -> ca.SX:
    """``a > b ? a : b``, one instruction where ``fmax`` takes three; b where a is not a number."""
    return ca.if_else(a > b, a, b)


def rows_of(matrix: ca.SX) -> list[Row]:
    """The structurally nonzero entries of an SX matrix, one dictionary per row."""
    rows: list[Row] = [{} for _ in range(matrix.size1())]
    row_index, column_index = matrix.sparsity().get_triplet()
    entries: list[Any] = matrix.nonzeros()
    for i, j, value in zip(row_index, column_index, entries, strict=True):
        if not value.is_zero():
            rows[i][j] = value
    return rows


def coupled_groups(matrix: ca.SX) -> list[list[int]]:
    """Connected components of the sparsity pattern of a square matrix."""
    leader = list(range(matrix.size1()))

    def find(i: int) -> int:
        while leader[i] != i:
            leader[i] = leader[leader[i]]
            i = leader[i]
        return i

    for i, j in zip(*matrix.sparsity().get_triplet(), strict=True):
        low, high = sorted((find(i), find(j)))
        leader[high] = low
    groups: dict[int, list[int]] = {}
    for i in range(len(leader)):
        groups.setdefault(find(i), []).append(i)
    return list(groups.values())


def solve_linear(matrix: ca.SX, right_hand_side: ca.SX) -> ca.SX:
    """Solve ``matrix @ solution = right_hand_side`` symbolically.

    matrix : SX, shape (n, n); right_hand_side : SX, shape (n, k). Returns SX, shape (n, k).
    Uncoupled groups of unknowns are solved apart: up to three by Cramer's rule, whose operations
    do not wait for one another and which divides once; more by elimination.
    Raises ``ZeroDivisionError`` when no structurally nonzero diagonal pivot is left.
    """
    matrix = ca.sparsify(matrix)
    groups = coupled_groups(matrix)
    if len(groups) == 1:
        return _solved(matrix, right_hand_side)
    parts, order = [], []
    for group in groups:
        parts.append(_solved(matrix[group, group], right_hand_side[group, :]))
        order += group
    place = sorted(range(len(order)), key=order.__getitem__)
    return ca.vertcat(*parts)[place, :] if parts else ca.SX(*right_hand_side.shape)


def _solved(matrix: ca.SX, right_hand_side: ca.SX) -> ca.SX:
    if matrix.size1() <= 3:
        return _cramer(matrix, right_hand_side)
    return _eliminated(matrix, right_hand_side)


def symmetric_inverse(matrix: ca.SX) -> ca.SX:
    """The inverse of a symmetric matrix, exactly symmetric, (n, n)."""
    inverse = solve_linear(matrix, ca.SX.eye(matrix.size1()))
    above = ca.triu(inverse, False)
    return ca.sparsify(ca.diag(ca.diag(inverse)) + above + above.T)


def _cramer(matrix: ca.SX, right_hand_side: ca.SX) -> ca.SX:
    """Adjugate over determinant for n <= 3."""
    n = matrix.size1()
    if n == 1:
        if not matrix.nnz():
            raise ZeroDivisionError("the matrix has a structurally zero row")
        return right_hand_side / matrix[0, 0]
    if n == 2:
        rows = [[matrix[1, 1], -matrix[0, 1]], [-matrix[1, 0], matrix[0, 0]]]
    else:
        a, b, c = (matrix[:, j] for j in range(3))
        rows = [ca.vertsplit(ca.cross(u, v)) for u, v in ((b, c), (c, a), (a, b))]
    adjugate = ca.vertcat(*[ca.horzcat(*row) for row in rows])
    determinant = ca.mtimes(adjugate[0, :], matrix[:, 0])
    if not ca.sparsify(determinant).nnz():
        raise ZeroDivisionError("the matrix is structurally singular")
    return ca.mtimes(ca.sparsify(adjugate), right_hand_side) / determinant


def _eliminated(matrix: ca.SX, right_hand_side: ca.SX) -> ca.SX:
    """Elimination on the diagonal; the order follows Markowitz, fewest new entries first."""
    n, k = right_hand_side.shape
    rows = rows_of(matrix)
    for i, row in enumerate(rows_of(right_hand_side)):
        rows[i].update({n + j: value for j, value in row.items()})
    order: list[int] = []
    while len(order) < n:
        pivot = _next_pivot(rows, set(order))
        order.append(pivot)
        _eliminate(rows, pivot, set(order))
    return _back_substitute(rows, order, n, k)


def _next_pivot(rows: list[Row], done: set[int]) -> int:
    left = [i for i in range(len(rows)) if i not in done]
    best, best_cost = -1, -1
    for i in left:
        if i not in rows[i]:
            continue
        width = sum(1 for j in rows[i] if j < len(rows)) - 1
        height = sum(1 for r in left if i in rows[r]) - 1
        if best < 0 or width * height < best_cost:
            best, best_cost = i, width * height
    if best < 0:
        raise ZeroDivisionError("the matrix has no structurally nonzero diagonal pivot left")
    return best


def _eliminate(rows: list[Row], pivot: int, done: set[int]) -> None:
    pivot_row = rows[pivot]
    inverse = _binary(_DIV, ca.SX(1), pivot_row[pivot])
    for j in list(pivot_row):
        if j != pivot:
            pivot_row[j] = _binary(_MUL, pivot_row[j], inverse)
    for i, row in enumerate(rows):
        if i in done or pivot not in row:
            continue
        factor = row.pop(pivot)
        for j, value in pivot_row.items():
            if j != pivot:
                product = _binary(_MUL, factor, value)
                new = _binary(_SUB, row[j], product) if j in row else -product
                if new.is_zero():
                    row.pop(j, None)
                else:
                    row[j] = new


def _back_substitute(rows: list[Row], order: list[int], n: int, k: int) -> ca.SX:
    solution: list[Row] = [{} for _ in range(n)]
    for pivot in reversed(order):
        entry: Row = {j - n: v for j, v in rows[pivot].items() if j >= n}
        for j, factor in rows[pivot].items():
            if j >= n or j == pivot:
                continue
            for column, value in solution[j].items():
                product = _binary(_MUL, factor, value)
                entry[column] = (
                    _binary(_SUB, entry[column], product) if column in entry else -product
                )
        solution[pivot] = entry
    return ca.vertcat(
        *[ca.horzcat(*[entry.get(j, ca.SX(0)) for j in range(k)]) for entry in solution]
    )


def cholesky(matrix: ca.SX) -> tuple[ca.SX, list[Any]]:
    """Lower factor L with ``L L^T = matrix``, and its pivots L_ii^2, which need no square root."""
    unit, pivots = unit_triangular_factor(matrix)
    roots = ca.vertcat(*[ca.sqrt(pivot) for pivot in pivots]) if pivots else ca.SX(0, 1)
    return ca.mtimes(unit, ca.diag(roots)), pivots


def unit_triangular_factor(matrix: ca.SX) -> tuple[ca.SX, list[Any]]:
    """L with ones on its diagonal and the pivots D of ``L D L^T = matrix``.

    Row by row over the structurally nonzero entries: uncoupled rows cost nothing.
    """
    n = matrix.size1()
    given = rows_of(ca.sparsify(matrix))
    unit: list[Row] = []
    pivots: list[Any] = []
    for i in range(n):
        row: Row = {}
        scaled: Row = {}
        for j in range(min(given[i], default=i), i):
            rest = given[i].get(j)
            for k, value in unit[j].items():
                if k in scaled:
                    product = scaled[k] * value
                    rest = -product if rest is None else rest - product
            if rest is not None:
                scaled[j], row[j] = rest, rest / pivots[j]
        pivots.append(given[i].get(i, ca.SX(0)) - sum(
            (scaled[k] * row[k] for k in scaled), ca.SX(0)
        ))
        unit.append(row)
    return _matrix_of(unit, n) + ca.SX.eye(n), pivots


def _matrix_of(rows: list[Row], columns: int) -> ca.SX:
    """The sparse matrix of the given rows."""
    entries = [(i, j, value) for i, row in enumerate(rows) for j, value in row.items()]
    if not entries:
        return ca.SX(len(rows), columns)
    matrix = ca.SX(ca.Sparsity.triplet(
        len(rows), columns, [i for i, _, _ in entries], [j for _, j, _ in entries]
    ))
    for i, j, value in entries:
        matrix[i, j] = value
    return matrix


def solve_lower(lower: ca.SX, right_hand_side: ca.SX) -> ca.SX:
    """Forward substitution ``L^{-1} b`` for a column b."""
    solution: list[Any] = []
    for i, row in enumerate(rows_of(lower)):
        value = right_hand_side[i]
        for j in sorted(row):
            if j < i:
                value = value - row[j] * solution[j]
        solution.append(value / row[i])
    return ca.vertcat(*solution) if solution else ca.SX.zeros(0, 1)


def between_factors(left: ca.SX, matrix: ca.SX, right: ca.SX) -> ca.SX:
    """``L^-1 M R^-T`` for lower triangular L and R."""
    half = ca.horzcat(*[solve_lower(left, column) for column in ca.horzsplit(matrix)])
    return ca.horzcat(*[solve_lower(right, row.T) for row in ca.vertsplit(half)]).T


def solve_upper(lower: ca.SX, right_hand_side: ca.SX) -> ca.SX:
    """Back substitution ``L^{-T} b`` for a column b."""
    columns = rows_of(lower.T)
    n = len(columns)
    solution: list[Any] = [None] * n
    for i in reversed(range(n)):
        value = right_hand_side[i]
        for j in sorted(columns[i]):
            if j > i:
                value = value - columns[i][j] * solution[j]
        solution[i] = value / columns[i][i]
    return ca.vertcat(*solution) if solution else ca.SX.zeros(0, 1)
