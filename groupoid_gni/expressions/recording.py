"""Record a user's NumPy function once, as a CasADi function.

Takes a plain function of arrays, gives a frozen RecordedFunction that evaluates it on floats (with
batch axes) and on recorded values, and differentiates it exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import casadi as ca
import numpy as np

from groupoid_gni.array_types import Array, FloatArray
from groupoid_gni.errors import InputError, RecordingError
from groupoid_gni.expressions.array import is_recorded
from groupoid_gni.expressions.conversion import from_sx, symbols, to_sx
from groupoid_gni.expressions.explanation import explain, location

__all__ = ["RecordedFunction", "record", "verify"]

_RTOL: Final = 1e-9
# Sums that cancel to zero differ by round-off between NumPy's order and the recorded one.
_ATOL: Final = 1e-12
# CasADi evaluates a few thousand points at once faster than a million.
_BLOCK: Final = 4096

Shape = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class RecordedFunction:
    """A function as an expression graph.

    Attributes
    ----------
    name : str
        What the function is to the user.
    function : casadi.Function
        One flat SX column per argument, one flat column out, all in C order.
    input_shapes : tuple of shapes
    output_shape : shape
    """

    name: str
    function: ca.Function
    input_shapes: tuple[Shape, ...]
    output_shape: Shape
    _derivatives: dict[int, RecordedFunction] = field(default_factory=dict, init=False, repr=False)

    def __call__(self, *args: Any) -> Any:
        """Evaluate.

        args : one per input, shape (..., *input_shape); leading axes are a batch and broadcast.
            Or recorded values of exactly the input shapes: the graph is then inlined.
        Returns : float ndarray, shape (..., *output_shape); a float for one point and output
            shape (). Recorded values give a RecordedArray (or its element for shape ()).
        Raises InputError if the number or a shape of the arguments does not fit.
        """
        if len(args) != len(self.input_shapes):
            raise InputError(
                f"{self.name} takes {len(self.input_shapes)} arguments; {len(args)} came."
            )
        if is_recorded(*args):
            columns = [self._column(number, value) for number, value in enumerate(args)]
            result = from_sx(self.call_sx(*columns), self.output_shape)
            return result.item() if self.output_shape == () else result
        return self._evaluate([self._floats(number, value) for number, value in enumerate(args)])

    def _column(self, number: int, value: Any) -> ca.SX:
        try:
            return to_sx(value, self.input_shapes[number])
        except InputError as error:
            raise InputError(f"{self.name}: argument {number}: {error}") from error

    def _floats(self, number: int, value: Any) -> FloatArray:
        array = np.asarray(value)
        # A conversion of complex numbers would only warn.
        if array.dtype.kind not in "fiub":
            raise InputError(
                f"{self.name}: argument {number} must hold real numbers; dtype {array.dtype} came."
            )
        return array.astype(np.float64, copy=False)

    def _evaluate(self, args: list[FloatArray]) -> Any:
        leading: list[Shape] = []
        for number, (array, shape) in enumerate(zip(args, self.input_shapes, strict=True)):
            cut = array.ndim - len(shape)
            if cut < 0 or array.shape[cut:] != shape:
                raise InputError(
                    f"{self.name}: argument {number} has shape {array.shape}; "
                    f"(..., {', '.join(map(str, shape))}) is expected."
                )
            leading.append(array.shape[:cut])
        try:
            batch = np.broadcast_shapes(*leading)
        except ValueError as error:
            raise InputError(f"{self.name}: the batch axes {leading} do not fit.") from error
        count = math.prod(batch)
        if count == 0:
            return np.zeros(batch + self.output_shape)
        # One column per point: CasADi then evaluates all points in one call.
        columns = [
            np.broadcast_to(array, batch + shape).reshape(count, math.prod(shape)).T
            for array, shape in zip(args, self.input_shapes, strict=True)
        ]
        blocks = [
            self.function.call([column[:, i : i + _BLOCK] for column in columns])[0].full().T
            for i in range(0, count, _BLOCK)
        ]
        result = np.concatenate(blocks).reshape(batch + self.output_shape)
        return float(result) if result.shape == () else np.ascontiguousarray(result)

    def call_sx(self, *columns: ca.SX) -> ca.SX:
        """Inline the graph: SX columns in C order in, one SX column out."""
        return self.function.call(list(columns))[0]

    def derivative(self, argument_index: int) -> RecordedFunction:
        """Give the derivative with respect to one argument, exact; computed once and kept.

        Its output shape is output_shape + input_shape of that argument.
        """
        if not 0 <= argument_index < len(self.input_shapes):
            raise InputError(
                f"{self.name} has arguments 0 to {len(self.input_shapes) - 1}; "
                f"{argument_index} came."
            )
        found = self._derivatives.get(argument_index)
        if found is None:
            found = self._differentiated(argument_index)
            self._derivatives[argument_index] = found
        return found

    def _differentiated(self, argument_index: int) -> RecordedFunction:
        columns = [
            ca.SX.sym(self.function.name_in(number), math.prod(shape), 1)
            for number, shape in enumerate(self.input_shapes)
        ]
        jacobian = ca.jacobian(self.call_sx(*columns), columns[argument_index])
        name = f"derivative {argument_index} of {self.name}"
        # vec runs down the columns; of the transpose, that is C order.
        flat = ca.vec(jacobian.T)
        return RecordedFunction(
            name=name,
            function=_casadi_function(name, columns, flat),
            input_shapes=self.input_shapes,
            output_shape=self.output_shape + self.input_shapes[argument_index],
        )


def record(
    function: Callable[..., Any],
    inputs: Mapping[str, Shape],
    output_shape: Shape,
    *,
    name: str,
    check_points: Sequence[Sequence[Any]] = (),
) -> RecordedFunction:
    """Call a function once on recorded arrays and keep what it computes.

    Parameters
    ----------
    function : callable
        Takes one array per input (a number for shape ()), gives an array-like of output_shape.
    inputs : mapping, argument name -> shape
    output_shape : shape
    name : str
        What the function is to the user; it opens every error message.
    check_points : sequence of tuples of float arrays
        There the function is also run plainly, and the numbers are compared: this finds random
        numbers, hidden state, branches and changed arguments.

    Raises
    ------
    RecordingError
        The function did something that cannot be recorded, or gave other numbers plainly.
    InputError
        The result has a wrong shape or type, or contains a NaN or Inf constant.
    """
    shapes = tuple(tuple(shape) for shape in inputs.values())
    pairs = [symbols(key, shape) for key, shape in zip(inputs, shapes, strict=True)]
    arguments = []
    for array, _ in pairs:
        # Read-only, so that a change in place is refused where it happens.
        array.flags.writeable = False
        arguments.append(array.item() if array.ndim == 0 else array)
    try:
        result = function(*arguments)
    except InputError as error:
        raise InputError(explain(name, function, error)) from error
    except Exception as error:
        raise RecordingError(explain(name, function, error)) from error
    output_shape = tuple(output_shape)
    column = _output_column(result, output_shape, name, function)
    columns = [symbol for _, symbol in pairs]
    recorded = RecordedFunction(
        name=name,
        function=_casadi_function(name, columns, column),
        input_shapes=shapes,
        output_shape=output_shape,
    )
    _refuse_foreign_symbols(recorded, function)
    _refuse_nonfinite_constants(recorded, function)
    verify(recorded, function, check_points)
    return recorded


def verify(
    recorded: RecordedFunction,
    function: Callable[..., Any],
    points: Sequence[Sequence[Any]],
) -> None:
    """Compare a recording with plain calls of the function it was made from.

    points : sequence of tuples of float arrays, one per input.
    Raises RecordingError when the plain call raises, changes its arguments or gives other numbers.
    """
    for point in points:
        _compare_with_plain_call(recorded, function, point)


def _casadi_function(name: str, columns: list[ca.SX], result: ca.SX) -> ca.Function:
    # Foreign symbols are let in here, to be refused by `record` in words a user understands.
    # Structural zeros are no outputs: a large matrix is mostly made of them.
    return ca.Function(
        ca.Function.fix_name(f"gni {name}"), columns, [result], {"allow_free": True}
    )


def _output_column(result: Any, shape: Shape, name: str, function: Callable[..., Any]) -> ca.SX:
    """Give the result of the user's call as a column; InputError, with the place, if it is none."""
    place = f"{name} ({location(function)})"
    if result is None:
        raise InputError(
            f"{place} returned None; an array of shape {shape} is expected. Is a return missing?"
        )
    try:
        return to_sx(result, shape)
    except InputError as error:
        raise InputError(
            f"{place} returned a {type(result).__name__} where an array of shape {shape} is "
            f"expected: {error}"
        ) from error


def _refuse_foreign_symbols(recorded: RecordedFunction, function: Callable[..., Any]) -> None:
    if recorded.function.has_free():
        foreign = ", ".join(str(symbol) for symbol in recorded.function.free_sx()[:5])
        raise RecordingError(
            f"{recorded.name} ({location(function)}) uses values of another recording: {foreign}. "
            "Compute everything from the arguments of this call."
        )


def _refuse_nonfinite_constants(recorded: RecordedFunction, function: Callable[..., Any]) -> None:
    graph = recorded.function
    for k in range(graph.n_instructions()):
        if graph.instruction_id(k) != ca.OP_CONST:
            continue
        value = graph.instruction_constant(k)
        if not math.isfinite(value):
            raise InputError(
                f"{recorded.name} ({location(function)}) contains the constant {value}: a 0/0, an "
                "overflow or a missing number outside the recorded arguments."
            )


def _compare_with_plain_call(
    recorded: RecordedFunction, function: Callable[..., Any], point: Sequence[Any]
) -> None:
    """Run the function on floats, and refuse if it raises, changes its input or differs."""
    place = f"{recorded.name} ({location(function)})"
    values: list[Array] = [np.array(value, dtype=np.float64) for value in point]
    arguments = [value.copy() if value.ndim else float(value) for value in values]
    try:
        plain_result = function(*arguments)
    except Exception as error:
        raise RecordingError(
            f"{place} could be recorded, but raised when run plainly at {_short(values)}: "
            f"{type(error).__name__}: {error}"
        ) from error
    for number, (before, after) in enumerate(zip(values, arguments, strict=True)):
        if not np.array_equal(before, after, equal_nan=True):
            raise RecordingError(
                f"{place} changed its argument {number} in place. Work on a copy: x = x.copy()."
            )
    try:
        plain_numbers = np.asarray(plain_result, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise RecordingError(f"{place} gave no numbers when run plainly: {error}") from error
    numbers = np.asarray(recorded(*values))
    if plain_numbers.shape != numbers.shape:
        raise RecordingError(
            f"{place} gave shape {plain_numbers.shape} when run plainly and {numbers.shape} when "
            "recorded."
        )
    size = float(np.max(np.abs(plain_numbers), initial=0.0, where=np.isfinite(plain_numbers)))
    if not np.allclose(numbers, plain_numbers, rtol=0, atol=_ATOL + _RTOL * size, equal_nan=True):
        raise RecordingError(
            f"{place} gave different numbers when recorded and when run plainly, at "
            f"{_short(values)}:\n  recorded {_short([numbers])}\n  plainly  "
            f"{_short([plain_numbers])}\n  Usual causes: random numbers, a global that changes, "
            "state kept between calls, a test of the type of x."
        )


def _short(values: Sequence[Array]) -> str:
    text = ", ".join(np.array2string(v, precision=6, threshold=8, separator=", ") for v in values)
    return text.replace("\n", "")
